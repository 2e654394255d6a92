"""What the tests of batches share: small clips, batches in this process, and the command with its processes."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers import clip, hit

from motionrecover import Motion, Skeleton
from motionrecover.batch import Settings, plan, run

CHAIN = Skeleton("abcde", [(0, 1), (1, 2), (2, 3), (3, 4)])
FAST = Settings(recovery={"max_steps": 3})
CLIPS = 5
NEEDS_PROC = pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="finds processes in /proc")


def motion(seed, frames=30, share=0.1):
    return Motion(hit(clip(CHAIN, frames, seed), share, seed), CHAIN, fps=60.0)


def here(work, jobs):
    """The plainest executor."""
    for job in jobs:
        yield job, work(job)


def again(sources, folder, settings=FAST):
    """Runs a batch, and gives what of it was done, by name."""
    done = []

    def counting(work, jobs):
        for job, record in here(work, jobs):
            done.append(job.name)
            yield job, record

    run(plan(sources, folder), folder, settings, counting)
    return done


def lines(folder):
    """The records of a manifest, the first hundred; none where there is no manifest yet."""
    path = Path(folder, "manifest.jsonl")
    return [json.loads(line) for line in path.read_bytes().splitlines()[:100]] if path.exists() else []


def answers(folder):
    """Bytes of every file of a batch but those that tell times."""
    files = {path.relative_to(folder).as_posix(): path for path in Path(folder).rglob("*") if path.is_file()}
    return {name: path.read_bytes() for name, path in files.items() if name not in ("manifest.jsonl", "index.html")}


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
    """What a command printed, when it has ended with this code."""
    out, error = process.communicate(timeout=120)
    assert process.returncode == code, error
    return out, error


def proc(path):
    """A file of /proc; empty where its process or thread has ended, be it between the opening and the reading."""
    try:
        return Path("/proc", path).read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""


def alive(pid):
    stat = proc(f"{pid}/stat")
    # A zombie is dead; nobody waits for it where its parent is gone and the first process of a container does not.
    return bool(stat) and b") Z " not in stat


def within(seconds, happened):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := happened():
            return found
        time.sleep(0.005)
    raise AssertionError(f"did not happen within {seconds} s")
