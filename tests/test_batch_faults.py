"""Batches on real processes, some of which are killed: the answers are those of a batch that nothing happened to."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest
from helpers import clip, hit

from motionrecover import Motion, Skeleton, save
from motionrecover.batch import Processes, WorkerLost
from motionrecover.batch.workers import ONE_THREAD

CHAIN = Skeleton("abcde", [(0, 1), (1, 2), (2, 3), (3, 4)])
CLIPS = 5
NEEDS_PROC = pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds processes in /proc")


# What workers do here. They import this module.


def outcome_of(job):
    what, mark = job
    if what == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "die once" and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "raise":
        raise ValueError("this one is bad")
    if what == "sleep":
        Path(mark).write_text(str(os.getpid()))
        time.sleep(600)
    return what, os.getpid(), {name: os.environ.get(name) for name in ONE_THREAD}


def alive(pid):
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return False
    # A zombie is dead; nobody waits for it where its parent is gone and the first process of a container does not.
    return ") Z " not in Path(f"/proc/{pid}/stat").read_text()


def within(seconds, happened):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := happened():
            return found
        time.sleep(0.005)
    raise AssertionError(f"did not happen within {seconds} s")


def test_a_job_whose_process_dies_is_given_to_another_and_fails_the_second_time(tmp_path):
    taken = []

    asked = [("fine", 0), ("die once", tmp_path / "mark"), ("die", 0), ("raise", 0), *[("fine", k) for k in range(6)]]

    def jobs():
        for job in asked:
            taken.append(job)
            yield job

    environment, left = dict(os.environ), []
    for job, answer in Processes(2)(outcome_of, jobs()):
        left.append((job, answer))
        assert len(taken) <= len(left) + 2  # as many as there are workers are at hand
    assert environment == dict(os.environ)
    assert sorted(map(str, asked)) == sorted(str(job) for job, _ in left)
    answers = dict(left)
    assert isinstance(answers["die", 0], WorkerLost)
    assert "2 processes died over it, the last one was killed by SIGKILL (out of memory" in str(answers["die", 0])
    assert str(answers["raise", 0]) == "this one is bad"
    good = [answer for (what, _), answer in left if what in ("fine", "die once")]
    assert len(good) == 8
    assert all(environment == ONE_THREAD for _, _, environment in good)
    assert os.getpid() not in {pid for _, pid, _ in good}


@NEEDS_PROC
def test_closing_it_and_killing_its_process_end_the_workers(tmp_path):
    outcomes = Processes(2)(outcome_of, [("fine", 0), ("sleep", tmp_path / "first")])
    next(outcomes)
    first = within(30, lambda: (tmp_path / "first").exists() and (tmp_path / "first").read_text())
    outcomes.close()
    assert not alive(first)
    program = (
        "from test_batch_faults import *\n"
        "if __name__ == '__main__':\n"
        f"    list(Processes(1)(outcome_of, [('sleep', {os.fspath(tmp_path / 'second')!r})]))\n"
    )
    (tmp_path / "program.py").write_text(program)
    path = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1])])
    process = subprocess.Popen([sys.executable, tmp_path / "program.py"], env=os.environ | {"PYTHONPATH": path})
    second = within(60, lambda: (tmp_path / "second").exists() and (tmp_path / "second").read_text())
    process.kill()
    process.wait()
    within(10, lambda: not alive(second))


# The command.


def command(folder, out, *more, source="in", workers=2):
    where = ["--workers", str(workers)] if isinstance(workers, int) else ["--scheduler", workers]
    arguments = ["batch", source, "-o", out, "--max-steps", "3", *where, *more]
    return subprocess.Popen(
        [sys.executable, "-m", "motionrecover", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def done(process, code=0):
    out, error = process.communicate(timeout=120)
    assert process.returncode == code, error
    return out, error


def answers(folder):
    """Bytes of every file of a batch but those that tell times."""
    files = {path.relative_to(folder).as_posix(): path for path in Path(folder).rglob("*") if path.is_file()}
    return {name: path.read_bytes() for name, path in files.items() if name not in ("manifest.jsonl", "index.html")}


def lines(folder):
    path = Path(folder, "manifest.jsonl")
    return [json.loads(line) for line in path.read_bytes().splitlines()[:100]] if path.exists() else []


def children(pid):
    """Worker processes of a batch."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        found += (task / "children").read_text().split()
    return [int(child) for child in found if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """A folder with clips in `in` and what an undisturbed batch made of them in `undisturbed`."""
    folder = tmp_path_factory.mktemp("archive")
    (folder / "in" / "sub").mkdir(parents=True)
    for seed in range(CLIPS):
        motion = Motion(hit(clip(CHAIN, 30 + seed, seed), 0.1, seed), CHAIN, fps=60.0)
        save(motion, folder / "in" / ("sub" if seed % 2 else "") / f"{seed}.npz")
    out, error = done(command(folder, "undisturbed", workers=1))
    assert f"{CLIPS} clips" in out
    assert error == ""
    assert {line["process"]["programs"] for line in lines(folder / "undisturbed")} == {2}
    return folder


@NEEDS_PROC
def test_a_batch_killed_again_and_again_ends_like_one_that_was_not(archive):
    counts = []
    for moment in (0, 1, 3):
        process = command(archive, "killed", workers=1)

        def reached(moment=moment, pid=process.pid):
            """When its worker starts, and later in the middle of a clip."""
            return len(lines(archive / "killed")) >= moment and children(pid)

        workers = within(60, reached)
        process.kill()
        process.communicate()
        within(10, lambda pids=workers: not any(map(alive, pids)))
        counts.append(len(lines(archive / "killed")))
    assert (archive / "killed" / "batch.lock").exists()
    (archive / "killed" / ".0123456789abcdef.npz").write_text("half")
    out, _ = done(command(archive, "killed", workers=1))
    assert re.search(rf"^done before +{counts[-1]} clips", out, re.MULTILINE)
    assert answers(archive / "killed") == answers(archive / "undisturbed")
    written = [line["output"] for line in lines(archive / "killed")]
    assert len(written) == len(set(written)) == CLIPS


@NEEDS_PROC
def test_inputs_that_cannot_be_read_or_change_between_runs_cost_themselves_alone(archive, tmp_path):
    shutil.copytree(archive / "in", tmp_path / "in")
    changed, gone = tmp_path / "in/0.npz", tmp_path / "in/sub/1.npz"
    right = changed.read_bytes()
    changed.write_bytes((archive / "in/2.npz").read_bytes())
    gone.unlink()
    gone.symlink_to("nowhere")
    done(command(tmp_path, "out"), 1)
    process = command(tmp_path, "out")
    within(60, lambda: children(process.pid))
    process.kill()
    process.communicate()
    changed.write_bytes(right)
    gone.unlink()
    shutil.copy(archive / "in/sub/1.npz", gone)
    done(command(tmp_path, "out"))
    assert answers(tmp_path / "out") == answers(archive / "undisturbed")
    times = Counter(line["output"] for line in lines(tmp_path / "out") if line["status"] == "done")
    assert times == {"0.npz": 2, "2.npz": 1, "4.npz": 1, "sub/1.npz": 1, "sub/3.npz": 1}


@NEEDS_PROC
def test_workers_killed_in_a_batch_cost_time_and_nothing_else(archive):
    process = command(archive, "robbed", "--json")
    killed = within(60, lambda: len(children(process.pid)) == 2 and children(process.pid))
    for worker in killed:
        os.kill(worker, signal.SIGKILL)
    out, error = done(process)
    found = json.loads(out)
    assert (found["done"], found["failed"], error) == (CLIPS, 0, "")
    assert not {line["process"]["pid"] for line in lines(archive / "robbed")} & set(killed)
    assert answers(archive / "robbed") == answers(archive / "undisturbed")


@NEEDS_PROC
def test_ctrl_c_ends_it_soon_and_a_second_batch_is_refused_meanwhile(archive):
    process = command(archive, "interrupted")
    within(60, lambda: children(process.pid))
    _, error = done(command(archive, "interrupted"), 2)
    assert f"error: interrupted is in use by the batch of process {process.pid} on " in error
    workers = children(process.pid)
    process.send_signal(signal.SIGINT)
    done(process, 130)
    within(10, lambda: not any(map(alive, workers)))
    names = {path.name for path in (archive / "interrupted").iterdir()}
    assert "manifest.jsonl" in names
    assert "batch.lock" not in names


def test_a_disk_without_room(archive, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=24k", "none", str(disk)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("a small disk can be mounted by root only")
    try:
        _, error = done(command(archive, str(disk / "out")), 2)
        assert error.startswith(f"error: the disk of {disk / 'out'} is full, ")
        assert error.count("\n") == 1
        there = answers(disk / "out")
        assert there.items() <= answers(archive / "undisturbed").items()
        # The other worker may have written its answer after the batch had ended: whole, and without a record.
        assert {line["output"] for line in lines(disk / "out")} <= set(there)
        subprocess.run(["mount", "-o", "remount,size=1m", str(disk)], check=True)
        done(command(archive, str(disk / "out")))
        assert answers(disk / "out") == answers(archive / "undisturbed")
    finally:
        subprocess.run(["umount", str(disk)], check=True)
