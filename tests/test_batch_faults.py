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

import numpy as np
import pytest
from batches import CLIPS, NEEDS_PROC, alive, answers, command, done, lines, proc, within

from motionrecover.batch import Processes, WorkerLost
from motionrecover.batch.workers import ONE_THREAD

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


def children(pid):
    """Worker processes of a batch."""
    threads = [task.name for task in Path(f"/proc/{pid}/task").iterdir()]
    found = [child for thread in threads for child in proc(f"{pid}/task/{thread}/children").split()]
    return [int(child) for child in found if b"spawn_main" in proc(f"{int(child)}/cmdline")]


@NEEDS_PROC
def test_a_batch_killed_at_ten_random_moments_ends_like_one_that_was_not(recovered_archive):
    killed, unfinished = recovered_archive / "killed", 0
    for k, delay in enumerate(np.random.default_rng(0).uniform(0, 1, 10)):
        inside = k % 3 == 2  # in the middle of the clips; else while processes start, most times
        enough = len(lines(killed)) + inside
        process = command(recovered_archive, "killed", workers=1)

        def reached(enough=enough, process=process):
            return process.poll() is not None or (len(lines(killed)) >= enough and children(process.pid))

        workers = within(60, reached)
        time.sleep(0.05 * delay if inside else delay)
        process.kill()
        process.communicate()
        within(10, lambda pids=workers: pids is True or not any(map(alive, pids)))
        if len(lines(killed)) < CLIPS:
            unfinished += 1
            assert (killed / "batch.lock").exists()
    assert unfinished
    count = len(lines(killed))
    (killed / ".0123456789abcdef.npz").write_text("half")
    out, _ = done(command(recovered_archive, "killed", workers=1))
    assert re.search(rf"^done before +{count} clips", out, re.MULTILINE)
    assert answers(killed) == answers(recovered_archive / "undisturbed")
    written = [line["output"] for line in lines(killed)]
    assert len(written) == len(set(written)) == CLIPS


@NEEDS_PROC
def test_inputs_that_cannot_be_read_or_change_between_runs_cost_themselves_alone(recovered_archive, tmp_path):
    shutil.copytree(recovered_archive / "in", tmp_path / "in")
    changed, gone = tmp_path / "in/0.npz", tmp_path / "in/sub/1.npz"
    right = changed.read_bytes()
    changed.write_bytes((recovered_archive / "in/2.npz").read_bytes())
    gone.unlink()
    gone.symlink_to("nowhere")
    done(command(tmp_path, "out"), 1)
    process = command(tmp_path, "out")
    within(60, lambda: children(process.pid))
    process.kill()
    process.communicate()
    changed.write_bytes(right)
    gone.unlink()
    shutil.copy(recovered_archive / "in/sub/1.npz", gone)
    done(command(tmp_path, "out"))
    assert answers(tmp_path / "out") == answers(recovered_archive / "undisturbed")
    times = Counter(line["output"] for line in lines(tmp_path / "out") if line["status"] == "done")
    assert times == {"0.npz": 2, "2.npz": 1, "4.npz": 1, "sub/1.npz": 1, "sub/3.npz": 1}


@NEEDS_PROC
def test_workers_killed_in_a_batch_cost_time_and_nothing_else(recovered_archive):
    process = command(recovered_archive, "robbed", "--json")
    killed = within(60, lambda: len(children(process.pid)) == 2 and children(process.pid))
    for worker in killed:
        os.kill(worker, signal.SIGKILL)
    out, error = done(process)
    found = json.loads(out)
    assert (found["done"], found["failed"], error) == (CLIPS, 0, "")
    assert not {line["process"]["pid"] for line in lines(recovered_archive / "robbed")} & set(killed)
    assert answers(recovered_archive / "robbed") == answers(recovered_archive / "undisturbed")


@NEEDS_PROC
def test_ctrl_c_ends_it_soon_and_a_second_batch_is_refused_meanwhile(recovered_archive):
    process = command(recovered_archive, "interrupted")
    within(60, lambda: children(process.pid))
    _, error = done(command(recovered_archive, "interrupted"), 2)
    assert f"error: interrupted is in use by the batch of process {process.pid} on " in error
    workers = children(process.pid)
    process.send_signal(signal.SIGINT)
    done(process, 130)
    within(10, lambda: not any(map(alive, workers)))
    names = {path.name for path in (recovered_archive / "interrupted").iterdir()}
    assert "manifest.jsonl" in names
    assert "batch.lock" not in names


def test_a_disk_without_room(recovered_archive, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=24k", "none", str(disk)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("a small disk can be mounted by root only")
    try:
        _, error = done(command(recovered_archive, str(disk / "out")), 2)
        assert error.startswith(f"error: the disk of {disk / 'out'} is full, ")
        assert error.count("\n") == 1
        there = answers(disk / "out")
        assert there.items() <= answers(recovered_archive / "undisturbed").items()
        recorded = {line["output"] for line in lines(disk / "out")}
        assert recorded <= set(there)
        # The other worker may have written its answer after the batch had ended: whole, and without a record.
        assert len(set(there) - recorded) <= 1
        subprocess.run(["mount", "-o", "remount,size=1m", str(disk)], check=True)
        done(command(recovered_archive, str(disk / "out")))
        assert answers(disk / "out") == answers(recovered_archive / "undisturbed")
    finally:
        subprocess.run(["umount", str(disk)], check=True)
