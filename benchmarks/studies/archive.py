"""Whole archives through `motionrecover.batch`: the CMU recordings on some workers against one process.

    python -m benchmarks.studies.archive [--part speed growth driver kills] [--workers N] [--clips N] [--growth N ...]

Parts can be run one by one: each replaces its own results. `speed` wants a machine with nobody else on it; the others
hold on a busy one.

speed: the recordings are all of `cmu/npz`, `cmu/bvh` and `cmu/amc`, each as it is, or `--clips` of each folder.

    warm-up    one clip of each kind (skeleton and stored length) is recovered first, so that every program is in the
               folder that all processes share, as for any batch but a user's first
    alone      one worker recovers clip after clip
    batch      the same on all workers; `speed` is alone over batch, start of the processes included in both
    load       of the machine before each, since both are wall-clock times
    failed     clips without an answer, with the reason
    equal      answers of the same bytes as alone
    programs   of the worker that needed most, compiled or taken from the folder
    bytes      of an answer and of its line in the manifest, on average

growth: batches of so many synthetic clips of `TINY` frames: milliseconds a clip from the first to the last, the same
when nothing is to do in a second run, growth of the driver's resident memory, and size of the manifest. Milliseconds of
processor time of the driver, and of the workers over those that they need for a batch of `LEAST` clips, hold on a busy
machine too.

driver: the driver alone, with an executor that answers `--pretended` clips at once: milliseconds a clip, and of
processor time, seconds to write the index, growth of its resident memory, size of the manifest.

kills: a batch of `KILLED` synthetic clips is killed at so many random moments and run again: how many answers have the
bytes of a batch that was not, and how many clips were done more often than once.

Results: `results/archive.json`.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks.recordings import data_folder
from motionrecover import __version__, corrupt, load, programs, save, synthesize
from motionrecover.batch import Job, Processes, Settings, plan, run
from motionrecover.batch.jobs import MANIFEST
from motionrecover.io import write_beside
from motionrecover.many import processors
from motionrecover.presets import Robust

FOLDERS = "npz", "bvh", "amc"
TINY = 16
"""Frames of a synthetic clip."""
STEPS = 2
"""Of the solver on it: what grows is what is around the solver."""
KILLED = 40
"""Synthetic clips of the batch that is killed."""
LEAST = 10
"""Clips of a batch of which nearly all processor time is the start of the workers."""
PARTS = "speed", "growth", "driver", "kills"


def recordings(clips: int | None) -> list[Job]:
    """All recordings, or so many of each folder, with the folder kept in the answer's name."""
    found = []
    for name in FOLDERS:
        jobs = plan([data_folder() / "cmu" / name / "**" / f"*.{name}"], "answers")
        found += [Job(job.source, f"{name}/{job.name}", job.format) for job in jobs[:clips]]
    return found


def one_of_each_kind(jobs: Iterable[Job]) -> list[Job]:
    """The first clip of each skeleton and stored length."""
    window, kinds = Robust().window, {}
    for job in jobs:
        try:
            clip = load(job.source)
        except ValueError:
            continue
        kinds.setdefault((clip.skeleton.edges, programs.bucket(min(len(clip), window or len(clip)), window)), job)
    return list(kinds.values())


def here(work: Callable, jobs: Iterable) -> Generator:
    """The executor that is this process."""
    for job in jobs:
        yield job, work(job)


def records(folder: Path) -> list[dict]:
    """Of a batch."""
    return [json.loads(line) for line in (folder / MANIFEST).read_text(encoding="utf-8").splitlines()]


def lines(folder: Path) -> int:
    """Of the manifest of a batch that may have died."""
    path = folder / MANIFEST
    return path.read_bytes().count(b"\n") if path.exists() else 0


def compare(jobs: list[Job], workers: int, place: Path) -> dict:
    """One process against workers."""
    settings = Settings(programs=str(place / "programs"))
    run(one_of_each_kind(jobs), place / "warm", settings, here)
    seconds, load_before = {}, {}
    for name, executor in (("alone", Processes(1)), ("batch", Processes(workers))):
        load_before[name] = os.getloadavg()[0]
        start = time.perf_counter()
        run(jobs, place / name, settings, executor)
        seconds[name] = time.perf_counter() - start
    found = records(place / "batch")
    done = [record for record in found if record["status"] == "done"]
    same = [(place / "alone" / r["output"]).read_bytes() == (place / "batch" / r["output"]).read_bytes() for r in done]
    needed = Counter()
    for record in found:
        needed[record["process"]["pid"]] = max(needed[record["process"]["pid"]], record["process"]["programs"])
    return {
        "workers": workers,
        "clips": len(jobs),
        "answers": len(done),
        "frames": sum(record["frames"] for record in done),
        "failed": {record["input"].rsplit("/", 1)[-1]: record["reason"] for record in found if record not in done},
        "equal": sum(same),
        "seconds": seconds,
        "load": load_before,
        "speed": seconds["alone"] / seconds["batch"],
        "programs": max(needed.values()),
        "answer bytes": sum(record["bytes"] for record in done) // len(done),
        "record bytes": (place / "batch" / MANIFEST).stat().st_size // len(found),
    }


def synthetic(place: Path, clips: int) -> Path:
    """A folder of so many tiny clips, a hundred in a folder."""
    truth = synthesize(1.0, seed=0)
    positions, _ = corrupt.apply("iid-20", truth.positions[:TINY], 0)
    place.mkdir(parents=True)
    one = place / "one.npz"
    save(truth.with_positions(positions, "corrupted"), one)
    for k in range(clips):
        path = place / "in" / f"{k // 100:03}" / f"{k:05}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(one.read_bytes())
    return place / "in"


class Watch:
    """Times of the first and the last clip, and the most resident memory meanwhile; called after each clip."""

    def __init__(self):
        self.first, self.last, self.peak = 0.0, 0.0, 0

    def __call__(self, _: object) -> None:
        """Look at the clock and the memory."""
        self.last = time.perf_counter()
        self.first = self.first or self.last
        self.peak = max(self.peak, resident())


def of_workers() -> float:
    """Seconds of processor time of the processes that this one started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def resident() -> int:
    """Bytes of this process that are in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def grown(clips: int, workers: int, place: Path) -> dict:
    """Time and memory of a batch of so many clips; to be called in a fresh process."""
    folder = synthetic(place, clips)
    settings = Settings(recovery={"max_steps": STEPS}, programs=str(place.parent / "programs"))
    few = plan([folder], place / "few")[:LEAST]
    run(few, place / "few", settings, Processes(workers))
    start = of_workers()
    run(few, place / "few again", settings, Processes(workers))
    start = of_workers() - start
    before, driver, others, found = resident(), time.process_time(), of_workers(), []
    for _ in range(2):
        watch = Watch()
        tally = run(plan([folder], place / "out"), place / "out", settings, Processes(workers), seen=watch)
        found.append((1000 * (watch.last - watch.first) / (clips - 1), watch.peak, tally))
        if len(found) == 1:
            driver, others = time.process_time() - driver, of_workers() - others
    (first, peak, tally), (again, peak_again, kept) = found
    grew = max(peak, peak_again) - before
    return {
        "done": tally.done,
        "kept again": kept.kept,
        "ms a clip": first,
        "ms a clip again": again,
        "processor ms a clip, driver": 1000 * driver / clips,
        "processor ms a clip, workers": 1000 * (others - start) / (clips - LEAST),
        "driver grew MB": grew / 1e6,
        "driver grew bytes a clip": grew / clips,
        "manifest bytes a clip": (place / "out" / MANIFEST).stat().st_size / clips,
    }


def pretended(clips: int, place: Path) -> dict:
    """Time and memory of a driver whose executor answers at once; to be called in a fresh process."""
    samples = {"untouched": 9000, "denoised": 0, "repaired": 900, "filled": 90, "unknown": 9}
    told = {"status": "done", "frames": 300, "joints": 31, "samples": samples, "moved_mm": 1.234, "report": None}
    told |= {"bytes": 50_000, "sha256": 64 * "0", "version": __version__, "converged": True, "message": "Fine."}
    told |= {"bone_length_deviation_mm": {"before": 1.234, "after": 0.5678}, "seconds": {"run": 1.234}, "notes": []}

    def at_once(_: Callable, jobs: Iterable[Job]) -> Generator:
        for job in jobs:
            yield job, told | {"output": job.name, "input": job.source}

    before, watch = resident(), Watch()
    names = (f"{k // 1000:04}/{k % 1000:03}.npz" for k in range(clips))
    jobs = [Job(f"archive/takes/{name}", name, "npz") for name in names]
    start, processor = time.perf_counter(), time.process_time()
    run(jobs, place, Settings(), at_once, seen=watch)
    index = time.perf_counter() - watch.last
    return {
        "clips": clips,
        "ms a clip": 1000 * (watch.last - start) / clips,
        "processor ms a clip": 1000 * (time.process_time() - processor) / clips,
        "seconds for the index": index,
        "driver grew MB": (watch.peak - before) / 1e6,
        "driver grew bytes a clip": (watch.peak - before) / clips,
        "manifest bytes a clip": (place / MANIFEST).stat().st_size / clips,
    }


def killed(moments: int, workers: int, place: Path) -> dict:
    """Whether a batch that is killed at random moments ends like one that is not."""
    folder, chance = synthetic(place, KILLED), random.Random(0)
    settings = Settings(recovery={"max_steps": STEPS}, programs=str(place.parent / "programs"))
    run(plan([folder], place / "undisturbed"), place / "undisturbed", settings, Processes(workers))
    command = [sys.executable, "-m", "motionrecover", "batch", str(folder), "-o", str(place / "killed")]
    command += ["--max-steps", str(STEPS), "--workers", str(workers), "--quiet"]
    own_cache = os.environ | {"XDG_CACHE_HOME": str(place)}
    there = []
    for _ in range(moments):
        process = subprocess.Popen(command, env=own_cache)
        least = lines(place / "killed") + chance.randint(0, KILLED // moments)
        while lines(place / "killed") < least and process.poll() is None:
            time.sleep(0.01)
        time.sleep(chance.uniform(0, 0.5))
        process.kill()
        process.wait()
        there.append(lines(place / "killed"))
    subprocess.run(command, env=own_cache, check=True)
    done = Counter(record["output"] for record in records(place / "killed"))
    names = [job.name for job in plan([folder], place / "killed")]
    files = {path.name for path in (place / "killed").rglob("*.npz")}
    return {
        "clips done at each": there,
        "equal": sum((place / "killed" / n).read_bytes() == (place / "undisturbed" / n).read_bytes() for n in names),
        "clips": KILLED,
        "other files": len(files) - KILLED,
        "done again": sum(done.values()) - KILLED,
    }


def main() -> None:
    """Measure, print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", nargs="+", choices=PARTS, default=PARTS, help="what to measure (all)")
    parser.add_argument("--workers", type=int, default=processors(), help="processes (one for each processor)")
    parser.add_argument("--clips", type=int, help="recordings of each folder (all)")
    parser.add_argument(
        "--growth", type=int, nargs="*", default=[100, 1000, 5000], help="synthetic clips (100 1000 5000)"
    )
    parser.add_argument("--pretended", type=int, default=1_000_000, help="clips of the driver alone (1000000)")
    parser.add_argument("--kills", type=int, default=10, help="moments (10)")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "archive.json")
    asked = parser.parse_args()
    results = json.loads(asked.output.read_text(encoding="utf-8")) if asked.output.exists() else {}
    for part in asked.part:
        with tempfile.TemporaryDirectory() as folder:
            results[part] = measured(part, asked, Path(folder))
        with write_beside(asked.output, overwrite=True) as temporary:
            temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        print(part, json.dumps(results[part], indent=1), flush=True)


def measured(part: str, asked: argparse.Namespace, place: Path) -> dict:
    """Results of a part."""
    if part == "speed":
        return compare(recordings(asked.clips), asked.workers, place)
    if part == "kills":
        return killed(asked.kills, asked.workers, place / "kills")
    if part == "driver":
        return in_fresh_process(pretended, asked.pretended, place)
    return {str(n): in_fresh_process(grown, n, asked.workers, place / f"growth-{n}") for n in asked.growth}


def in_fresh_process(function: Callable, *arguments: Any) -> dict:
    """What a function returns in a process that did nothing before."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as fresh:
        return fresh.submit(function, *arguments).result()


if __name__ == "__main__":
    main()
