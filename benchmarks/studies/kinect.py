"""What `robust` makes of real Kinect v2 recordings: bones, jitter, lag, and tracked samples that were hidden.

    python -m benchmarks.studies.kinect [--seeds N] [--inferred C] [--output FILE]

There is no truth, so each recording is measured against itself. Tracked samples (state 2) have a confidence of 1,
inferred ones (state 1) of `INFERRED`. The few frames that the sensor dropped are cut out, so that every frame has a
sample of every joint to measure.

    bones   standard deviation over mean of each bone's length over the recording: the largest, and before
    still   root mean square of the second differences before over after, where a joint barely moves: over three tracked
            samples that are within `NEAR` of the mean of the surrounding `AROUND` frames, in their root mean square,
            and this mean moves slower than `SLOW`
    lag     frames by which the recovered velocity must be moved to correlate best with the input's
    hidden  mean distance in mm of the answer from tracked samples that it was not given, beside that of a cubic spline
            through the other tracked samples and that of the floor: third differences over the square root of 20, which
            is what the hidden samples' own noise makes of any answer if it is white. An exact answer would be off by
            the floor, and by what its constant bones cost: `given` is the mean distance of the tracked samples that
            were not hidden from the answer.

Results: `results/kinect.json`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from benchmarks.recordings import data_folder
from benchmarks.suite.peers_time import cubic
from motionrecover.io import load, write_beside
from motionrecover.io.kinect import INFERRED
from motionrecover.recovery import recover
from motionrecover.skeleton import Skeleton

SKELETON = Skeleton.standard("kinect25")
FPS = 30.0
AROUND = 15
"""Frames: half a second."""
SLOW = 0.05
"""Metres a second."""
NEAR = 0.02
"""Metres. A hand that waves twice a second has a mean that stands still."""
RUN = 15
"""Frames hidden in a row, once a joint."""
SHARE = 0.1
"""Of the tracked samples that is hidden one by one."""
LAGS = np.arange(-5, 6)


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Positions (frame, joint, 3) in metres and tracking states (frame, joint) of a recording's own frames."""
    motion = load(path)
    confidence = np.asarray(motion.confidence)
    kept = motion.observed.any(1)
    return motion.positions[kept], np.select([confidence == 1, confidence > 0], [2, 1])[kept]


def solved(positions: np.ndarray, states: np.ndarray, inferred: float, hidden: np.ndarray | None = None) -> np.ndarray:
    """What `robust` makes of a recording, with the `hidden` (frame, joint) samples missing."""
    confidence = np.select([states == 2, states == 1], [1.0, inferred])
    if hidden is not None:
        confidence = np.where(hidden, 0, confidence)
    return recover(positions, SKELETON, confidence=confidence, fps=FPS, dtype="float64").positions


def variation(positions: np.ndarray) -> np.ndarray:
    """Standard deviation over mean (bone,) of the bones' lengths."""
    lengths = SKELETON.bone_lengths_of(positions)
    return lengths.std(0) / lengths.mean(0)


def still(positions: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Where (frame - 2, joint) three tracked samples are in a row and the joint barely moves."""
    smooth = uniform_filter1d(positions, AROUND, axis=0, mode="nearest")
    slow = np.linalg.norm(np.gradient(smooth, axis=0), axis=-1) * FPS < SLOW
    variance = uniform_filter1d(positions**2, AROUND, axis=0, mode="nearest") - smooth**2
    both = slow & (variance.sum(-1) < NEAR**2) & (states == 2)
    return both[2:] & both[1:-1] & both[:-2]


def jitter(positions: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Root mean square (joint,) of the second differences that count."""
    squares = (np.diff(positions, 2, axis=0) ** 2).sum(-1)
    return np.sqrt((squares * counted).sum(0) / np.maximum(counted.sum(0), 1))


def lag(before: np.ndarray, after: np.ndarray, states: np.ndarray) -> int:
    """Frames by which the velocity of `after` comes late, over all joints together."""
    velocity, found = np.diff(before, axis=0), np.diff(after, axis=0)
    tracked = (states[1:] == 2) & (states[:-1] == 2)
    velocity = np.where(tracked[..., None], velocity, 0)
    inner = slice(LAGS[-1], len(found) - LAGS[-1])
    return int(LAGS[np.argmax([np.sum(found[inner] * np.roll(velocity, k, 0)[inner]) for k in LAGS])])


def hide(states: np.ndarray, run: int, rng: np.random.Generator) -> np.ndarray:
    """Samples (frame, joint) to hide, tracked between tracked ones: a `run` a joint, or `SHARE` of all for a run of 1.

    Of joints that are tracked in half of the frames or more: an inferred sample lies elsewhere than a tracked one.
    """
    hidden = np.zeros(states.shape, bool)
    for joint, tracked in enumerate((states == 2).T):
        windows = np.lib.stride_tricks.sliding_window_view(tracked, run + 2).all(1)
        starts = np.flatnonzero(windows) + 1 if tracked.mean() >= 0.5 else np.zeros(0, int)
        if run == 1:
            hidden[starts, joint] = rng.random(len(starts)) < SHARE
        elif len(starts):
            hidden[rng.choice(starts) + np.arange(run), joint] = True
    return hidden


def floor(positions: np.ndarray, states: np.ndarray, hidden: np.ndarray) -> float:
    """Mean length of the noise of the `hidden` samples, from third differences of tracked samples of their joints."""
    tracked = np.lib.stride_tricks.sliding_window_view(states == 2, 4, axis=0).all(-1)
    size = np.linalg.norm(np.diff(positions, 3, axis=0), axis=-1) / np.sqrt(20)
    noise = (size * tracked).sum(0) / np.maximum(tracked.sum(0), 1)
    return float((noise * hidden.sum(0)).sum() / hidden.sum())


def measure(path: Path, inferred: float, seeds: int) -> dict:
    """Every measure of one recording."""
    positions, states = read(path)
    answer = solved(positions, states, inferred)
    counted = still(positions, states)
    enough = counted.sum(0) >= AROUND
    ratios = jitter(positions, counted)[enough] / jitter(answer, counted)[enough]
    total = [np.sqrt(np.mean((np.diff(x, 2, axis=0)[counted] ** 2).sum(-1))) for x in (positions, answer)]
    result = {
        "frames": len(positions),
        "inferred": round(float((states == 1).mean()), 3),
        "bones": {"before": variation(positions).max(), "after": variation(answer).max()},
        "still": {
            "samples": round(float(counted.mean()), 3),
            "before mm": 1000 * total[0],
            "after mm": 1000 * total[1],
            "ratio": total[0] / total[1],
            "joints": int(enough.sum()),
            "median joint": np.median(ratios),
            "worst joint": ratios.min(),
        },
        "lag": lag(positions, answer, states),
    }
    for name, run in (("scattered", 1), ("runs", RUN)):
        errors = []
        for seed in range(seeds):
            hidden = hide(states, run, np.random.default_rng([seed, run]))
            spline = cubic(np.where((hidden | (states != 2))[..., None], np.nan, positions))
            found = solved(positions, states, inferred, hidden)
            off = [np.linalg.norm(x - positions, axis=-1)[hidden].mean() for x in (found, spline)]
            given = np.linalg.norm(found - positions, axis=-1)[(states == 2) & ~hidden].mean()
            errors.append([*off, floor(positions, states, hidden), given])
        robust, spline, least, given = 1000 * np.mean(errors, 0)
        result[name] = {
            "robust mm": robust,
            "spline mm": spline,
            "floor mm": least,
            "given mm": given,
            "ratio": spline / robust,
        }
    return _rounded(result)


def _rounded(value):
    """Four significant digits."""
    if isinstance(value, dict):
        return {name: _rounded(part) for name, part in value.items()}
    return value if isinstance(value, int) else float(f"{value:.4g}")


def main() -> None:
    """Measure every recording, print the table and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="draws of hidden samples (3)")
    parser.add_argument("--inferred", type=float, default=INFERRED, help="confidence of an inferred sample")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "kinect.json")
    asked = parser.parse_args()
    results = {}
    print("recording              bones %        still mm: before after ratio median worst  lag  ", end="")
    print("scattered: robust spline floor given ratio   runs: robust spline floor given ratio")
    for path in sorted((data_folder() / "kinect").glob("*.csv")):
        row = results[path.stem] = measure(path, asked.inferred, asked.seeds)
        still_row, bones = row["still"], row["bones"]
        print(f"{path.stem:22} {100 * bones['before']:5.1f} {100 * bones['after']:8.4f}", end="")
        names = "before mm", "after mm", "ratio", "median joint", "worst joint"
        print("        " + " ".join(f"{still_row[name]:6.2f}" for name in names), f"{row['lag']:4d}", end="")
        for name in ("scattered", "runs"):
            print("      " + " ".join(f"{value:6.2f}" for value in row[name].values()), end="")
        print(flush=True)
    with write_beside(asked.output, overwrite=True) as temporary:
        temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
