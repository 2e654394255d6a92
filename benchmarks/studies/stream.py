"""What live recovery costs in accuracy and in time, beside `recover` on the whole clip.

    python -m benchmarks.studies.stream [--clips N] [--frames N] [--output FILE]
    taskset -c 0 python -m benchmarks.studies.stream --time MINUTES [--rates 120] [--corrupt mixed]

`errors`: mean error in mm of streams of several delays, of `recover`, and of what is simple, on cmu25, from the second
second on; over all samples, over those of the second half (`later`), and in rows that make gaps over missing ones.
Poses of the clip's own person are left out. `recover up to 1 s` is `recover` with all that has come a second after each
frame: what can be known by then.
`--time` feeds joined recordings at their rate and measures how long `push` takes; what it finds joins the results.
Results: `results/stream.json`.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np

from benchmarks.people import left_out
from benchmarks.recordings import data_folder
from benchmarks.suite import clips
from motionrecover import Skeleton, Stream, corrupt, recover
from motionrecover.io import load
from motionrecover.io.atomic import write_beside

RESULTS = Path(__file__).parent / "results" / "stream.json"
PROTOCOLS = ("iid-5", "iid-20", "mixed")
DELAYS = (0.25, 1.0, 0.0)
MEDIAN = 2
"""Frames on either side in the running median."""
CUTOFF, BETA, SPEED_CUTOFF = 1.0, 30.0, 1.0
"""Of the one-euro filter, in Hz, per metre and in Hz (Casiez, Roussel & Vogel, CHI 2012)."""


def errors(folder: Path, fps: int, protocol: str, count: int, frames: int) -> dict[str, dict[str, float]]:
    """Mean errors over `count` clips of `frames` frames by method."""
    found: dict[str, list] = {}
    for name in clips.pick(folder, "cmu25", fps, count, frames=frames)[0]:
        clip = load(folder / "cmu" / "npz" / f"{name}.npz").select(Skeleton.standard("cmu25").names)
        truth = clip.positions[:: 120 // fps][:frames].astype(float)
        data = corrupt.apply(protocol, truth, np.random.default_rng(int(name.replace("_", ""))), clip.skeleton)[0]
        answers = {"hold last": held(data), "running median": median(data), "one-euro": one_euro(data, fps)}
        with left_out(name):
            answers["recover"] = recover(data, clip.skeleton, fps=fps, dtype=np.float64).positions
            answers["recover up to 1 s"] = up_to(data, clip.skeleton, fps)
            for delay in DELAYS:
                answers[f"{delay:g} s"] = streamed(Stream(clip.skeleton, fps, delay), data)
        missing = np.isnan(data).any(-1)
        for method, answer in answers.items():
            off = 1e3 * np.linalg.norm(answer - truth, axis=-1)[fps:]
            hidden = off[missing[fps:]]
            later = np.nanmean(off[len(off) // 2 :])
            scores = [np.nanmean(off), later, np.nanmean(hidden) if len(hidden) else 0, np.isnan(off).mean()]
            found.setdefault(method, []).append(scores)
    table = {}
    for method, scores in found.items():
        every, later, hidden, unknown = np.mean(scores, 0).tolist()
        table[method] = {"all": round(every, 4), "later": round(later, 4), "unknown": round(unknown, 5)}
        if missing.any():
            table[method]["missing"] = round(hidden, 3)
    return table


def streamed(stream: Stream, data: np.ndarray) -> np.ndarray:
    """All answers to a clip."""
    answers = [answer for answer in map(stream.push, data) if answer is not None]
    return np.concatenate([np.array(answers), stream.flush()])


def up_to(data: np.ndarray, skeleton: Skeleton, fps: int) -> np.ndarray:
    """What `recover` says of each frame when it has seen two thirds of a second to a second more."""
    answer, third = np.full_like(data, np.nan), fps // 3
    for end in range(2 * fps, len(data) + fps, third):
        seen = recover(data[:end], skeleton, fps=fps, dtype=np.float64, throw=False).positions
        answer[end - fps : end - fps + third] = seen[end - fps : end - fps + third]
    return answer


def held(data: np.ndarray) -> np.ndarray:
    """Missing samples at the last one seen."""
    seen = np.isfinite(data).all(-1)
    last = np.maximum.accumulate(np.where(seen, np.arange(len(data))[:, None], 0), 0)
    return data[last, np.arange(data.shape[1])]


def median(data: np.ndarray) -> np.ndarray:
    """The running median, held over gaps."""
    padded = np.pad(data, ((MEDIAN, MEDIAN), (0, 0), (0, 0)), constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * MEDIAN + 1, axis=0)
    return held(np.ma.median(np.ma.masked_invalid(around), axis=-1).filled(np.nan))


def one_euro(data: np.ndarray, fps: float) -> np.ndarray:
    """The one-euro filter of held samples."""

    def share(cutoff):
        return 1 / (1 + fps / (2 * np.pi * cutoff))

    held_data = held(data)
    out, speed = held_data.copy(), np.zeros(data.shape[1:])
    for k in range(1, len(data)):
        new = (held_data[k] - held_data[k - 1]) * fps
        speed = np.where(np.isfinite(speed), speed, 0) + share(SPEED_CUTOFF) * (new - np.nan_to_num(speed))
        alpha = share(CUTOFF + BETA * np.linalg.norm(speed, axis=-1, keepdims=True))
        before = np.where(np.isfinite(out[k - 1]), out[k - 1], held_data[k])
        out[k] = before + alpha * (held_data[k] - before)
    return out


def timed(folder: Path, fps: int, minutes: float, protocol: str) -> dict[str, float]:
    """Frames at their rate for some minutes: `push` as a share of a frame's time, load and memory."""
    names = clips.pick(folder, "cmu25", fps, 40)[0]
    skeleton = Skeleton.standard("cmu25")
    parts = [load(folder / "cmu" / "npz" / f"{name}.npz").select(skeleton.names).positions for name in names]
    data = np.concatenate(parts)[:: 120 // fps].astype(float)
    if protocol:
        data = corrupt.apply(protocol, data, 0, skeleton)[0]
    stream, frames = Stream(skeleton, fps, 0.25), round(60 * fps * minutes)
    took, used, memory = np.zeros(frames), np.zeros(frames), []
    begun, busy = time.perf_counter(), time.process_time()
    for k in range(frames):
        time.sleep(max(0, begun + k / fps - time.perf_counter()))
        start, own = time.perf_counter(), time.thread_time()
        stream.push(data[k % len(data)])
        took[k], used[k] = time.perf_counter() - start, time.thread_time() - own
        if k % (frames // 10) == 0:
            memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    busy = time.process_time() - busy
    p50, p99 = np.quantile(took * fps, [0.5, 0.99]).tolist()
    return {
        "minutes": minutes,
        "median": round(p50, 4),
        "p99": round(p99, 4),
        "p99 of its own work": round(float(np.quantile(used * fps, 0.99)), 4),
        "load": round(busy * fps / frames, 3),
        "MB after a tenth": round(memory[1], 1),
        "MB at the end": round(memory[-1], 1),
    }


def main() -> None:
    """Measure, print, and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=4, help="a row, each of another subject (4)")
    parser.add_argument("--frames", type=int, default=600, help="of a clip (600)")
    parser.add_argument("--time", type=float, metavar="MINUTES", help="measure times, not errors")
    parser.add_argument("--corrupt", default="", metavar="PROTOCOL", help="what is timed (as recorded)")
    parser.add_argument("--rates", type=int, nargs="+", default=[30, 120])
    parser.add_argument("--output", type=Path, default=RESULTS)
    asked, folder = parser.parse_args(), data_folder()
    results = json.loads(asked.output.read_text(encoding="utf-8")) if asked.output.exists() else {}
    for fps in asked.rates:
        if asked.time:
            row = f"{asked.corrupt or 'as recorded'} {fps} Hz"
            found = {row: timed(folder, fps, asked.time, asked.corrupt)}
            results["times"] = results.get("times", {}) | found
            print(found, flush=True)
        for protocol in () if asked.time else PROTOCOLS:
            row = f"{protocol} {fps} Hz"
            found = errors(folder, fps, protocol, asked.clips, asked.frames)
            results |= {"clips": asked.clips, "frames": asked.frames}
            results["errors"] = results.get("errors", {}) | {row: found}
            print(row, found, flush=True)
    with write_beside(asked.output, overwrite=True) as temporary:
        temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
