"""Batches on the workers of a Dask scheduler: real processes on this machine, some of which are killed."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from batches import NEEDS_PROC, answers, command, done, lines, within

from motionrecover.batch import Dask, WorkerLost
from motionrecover.batch.clip import Settings, recover_clip
from motionrecover.batch.jobs import Job
from motionrecover.batch.lock import Lock, Locked

pytest.importorskip("distributed")


# What workers do here. They import this module.


def outcome_of(job):
    what, mark = job
    if what == "die" or (what == "die once" and not Path(mark).exists()):
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "raise":
        raise ValueError("this one is bad")
    return what, os.getpid(), os.environ["NPROC"]


def at_once(job):
    """A job, and whether another one ran beside it in the same process."""
    with Path(f"{job}.{os.getpid()}").open("x") as file:
        beside = [path for path in Path(job).parent.glob(f"*.{os.getpid()}") if path.name != Path(file.name).name]
        time.sleep(0.05)
    Path(file.name).unlink()
    return beside


class Cluster:
    """A scheduler, and workers that can be started and killed."""

    def __init__(self, folder):
        self._folder, self._started = folder, []
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self._port}"

    def _start(self, program, *arguments):
        path = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1])])
        settings = {"PYTHONPATH": path, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{program}", *arguments, "--no-dashboard"],
            cwd=self._folder,
            env=os.environ | settings,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._started.append(process)
        return process

    def scheduler(self):
        return self._start("scheduler", "--host", "127.0.0.1", "--port", str(self._port))

    def listens(self):
        with socket.socket() as tried:
            return tried.connect_ex(("127.0.0.1", self._port)) == 0

    def worker(self, *more):
        where = ["--host", "127.0.0.1", "--local-directory", str(self._folder)]
        return self._start("worker", self.address, *where, "--nthreads", "1", *more)

    def end(self):
        for process in self._started:
            kill(process)


def kill(process):
    """A process with all that it started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@pytest.fixture
def cluster(tmp_path):
    cluster = Cluster(tmp_path)
    yield cluster
    cluster.end()


def test_jobs_of_workers_that_die_are_done_by_others_and_few_are_at_hand(cluster, tmp_path):
    taken, left = [], []
    asked = [
        ("fine", "0"),
        ("die once", str(tmp_path / "mark")),
        ("raise", ""),
        *(("fine", f"{k}") for k in range(1, 9)),
    ]

    def jobs():
        for job in asked:
            taken.append(job)
            yield job

    cluster.scheduler()
    cluster.worker()
    cluster.worker()
    for job, answer in Dask(cluster.address, patience=120)(outcome_of, jobs()):
        left.append((job, answer))
        assert len(taken) - len(left) <= 2 * 2
    assert sorted(asked) == sorted(job for job, _ in left)
    found = dict(left)
    assert str(found.pop(("raise", ""))) == "this one is bad"
    assert all(answer[0] in ("fine", "die once") and answer[2] == "1" for answer in found.values())
    assert os.getpid() not in {answer[1] for answer in found.values()}
    ((_, lost),) = Dask(cluster.address, patience=120)(outcome_of, [("die", str(tmp_path / "mark"))])
    assert isinstance(lost, WorkerLost)
    assert "workers died over it" in str(lost)


def test_threads_of_a_worker_take_turns_and_gpus_are_asked_for(cluster, tmp_path):
    cluster.scheduler()
    cluster.worker("--nthreads", "3", "--no-nanny", "--resources", "GPU=1", "--name", "gpu")
    within(60, lambda: len(list(Dask(cluster.address)(outcome_of, [("fine", "")]))))
    gpu = next(iter(Dask(cluster.address)(outcome_of, [("fine", "")])))[1][1]
    cluster.worker("--no-nanny")
    from distributed import Client

    with Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    jobs = [str(tmp_path / f"{k}") for k in range(6)]
    assert [beside for _, beside in Dask(cluster.address)(at_once, jobs)] == [[]] * 6
    assert {answer[1] for _, answer in Dask(cluster.address)(outcome_of, [("fine", str(k)) for k in range(6)])} == {gpu}


def test_what_is_not_there_is_said_in_one_sentence(cluster, refused, run):
    executor = Dask(cluster.address, patience=0.2)
    refused(lambda: list(executor(outcome_of, [0])), cluster.address, "no Dask scheduler", error=ConnectionError)
    refused(lambda: list(Dask("nonsense")(outcome_of, [0])), "'nonsense'", "tcp://", error=ValueError)
    cluster.scheduler()
    within(60, cluster.listens)
    refused(lambda: list(executor(outcome_of, [0])), cluster.address, "no Dask worker", error=ConnectionError)


def test_a_worker_whose_batch_is_gone_writes_nothing(tmp_path, refused):
    job = Job(str(tmp_path / "a.npz"), "a.npz", "npz")
    with Lock(tmp_path / "batch.lock") as lock:
        claim = lock.claim
        assert recover_clip(Settings(), str(tmp_path), claim, job)["status"] == "failed"  # there is no such file
    refused(lambda: recover_clip(Settings(), str(tmp_path), claim, job), "batch has ended", error=Locked)
    with Lock(tmp_path / "batch.lock"):
        refused(lambda: recover_clip(Settings(), str(tmp_path), claim, job), "taken over", error=Locked)
    assert list(tmp_path.iterdir()) == []


@NEEDS_PROC
def test_a_batch_outlives_its_scheduler(recovered_archive, cluster):
    cluster.scheduler()
    first = cluster.worker()
    process = command(recovered_archive, "clustered", workers=cluster.address)
    within(120, lambda: lines(recovered_archive / "clustered"))
    kill(cluster._started[0])
    within(60, lambda: first.poll() is not None)  # a worker ends with its scheduler
    cluster.scheduler()
    cluster.worker()
    out, error = done(process)
    assert error == ""
    assert answers(recovered_archive / "clustered") == answers(recovered_archive / "undisturbed")
    written = [line["output"] for line in lines(recovered_archive / "clustered")]
    assert len(written) == len(set(written)) == 5
    out, _ = done(command(recovered_archive, "clustered"))  # here again, where nothing is left to do
    assert "done before" in out
    assert len(lines(recovered_archive / "clustered")) == 5
