"""Optical markers with gaps: `robust` on an inferred graph of markers beside what editors fill gaps with.

    python -m benchmarks.studies.markers [--frames N] [--seeds N] [--takes ...] [--output FILE]

Takes: three of the CMU database (41 markers, 120 Hz, no gaps), two of pyomeca (51 markers, 100 Hz; a shoulder and a
box; the second, a TRC file of 93 frames, on request only), and a walk of the package gapfill (13 markers, real gaps),
from the folder `markers` beside the clips. The walk's file says no unit and no rate: 50 Hz is what makes its stride a
walk. Of longer takes the middle frames count.

Rows hide samples that were measured: 10 % of them; a run of 0.5 or 1 s in each of three markers; runs of a marker and
the two that are nearest to it, as long as the real gaps of these takes. Every method gets the same data, in metres, and
no method the hidden samples; the graph is inferred from the data with the gaps in. The error is the mean distance in
mm over hidden samples, `observed` what `robust` moves the samples it was given by. Results: `results/markers.json`.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.recordings import data_folder
from benchmarks.suite import peers_lowrank, peers_rigid, peers_time
from motionrecover.evidence.rigid_graph import infer_graph
from motionrecover.io import MotionFormatWarning, load, write_beside
from motionrecover.motion import Motion
from motionrecover.recovery import recover
from motionrecover.runs import runs_of
from motionrecover.skeleton import Skeleton

TAKES = ("cmu_02_01.c3d", "cmu_135_02.c3d", "cmu_85_12.c3d", "markers_analogs.c3d", "gait-raw.csv")
ASKED = ("markers.trc",)
"""Takes that are measured on request only."""
GAIT_RATE = 50.0
ROWS = ("10 % of the samples", "3 markers, 0.5 s", "3 markers, 1 s", "neighbours, real gap lengths")
PEERS = {
    "linear": peers_time.nothing,
    "spline": lambda positions, fps: peers_time.cubic(positions),
    "pca": peers_lowrank.pca,
    "rigid donors": peers_rigid.rigid_donors,
}
MARGIN = 5
"""Frames at either end in which no run lies."""
CLUSTERS = 12
"""Runs of a marker and its neighbours in a take."""


def read(path: Path) -> Motion:
    """A take, NaN where missing. Which axis is up means nothing here."""
    stated = {"unit": "mm", "fps": GAIT_RATE} if path.suffix == ".csv" else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MotionFormatWarning)
        return load(path, **stated)


def gap_lengths(positions: np.ndarray) -> list[int]:
    """Lengths in frames of all gaps."""
    return [stop - start for missing in np.isnan(positions[..., 0]).T for start, stop in runs_of(missing)]


def hidden(row: str, positions: np.ndarray, fps: float, lengths: list[int], rng: np.random.Generator) -> np.ndarray:
    """Measured samples (frame, marker) that the row hides; `lengths` are those of real gaps."""
    frames, markers, _ = positions.shape
    out = np.zeros((frames, markers), bool)

    def run(joints, length):
        length = min(length, frames - 2 * MARGIN)
        start = rng.integers(MARGIN, frames - MARGIN - length + 1)
        out[start : start + length, joints] = True

    if row == ROWS[0]:
        out = rng.random(out.shape) < 0.1
        out[[0, -1]] = False
    elif row in ROWS[1:3]:
        for marker in rng.choice(markers, 3, replace=False):
            run(marker, round((0.5 if row == ROWS[1] else 1) * fps))
    else:
        apart = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
        with warnings.catch_warnings():
            # Two markers that are never seen together.
            warnings.simplefilter("ignore", RuntimeWarning)
            apart = np.nanmedian(apart, 0)
        for _ in range(CLUSTERS):
            run(np.argsort(apart[rng.integers(markers)])[:3], int(rng.choice(lengths)))
    return out & np.isfinite(positions[..., 0])


def measure(truth: np.ndarray, names: Sequence[str], fps: float, hide: np.ndarray) -> dict[str, float]:
    """Mean error in mm on the hidden samples for every method, and what `robust` moves the observed samples by."""
    data = np.where(hide[..., None], np.nan, truth)

    def error(answer, where):
        return 1000 * float(np.linalg.norm(answer - truth, axis=-1)[where].mean())

    errors = {name: error(fill(data, fps), hide) for name, fill in PEERS.items()}
    start = time.perf_counter()
    graph = infer_graph(data)
    found = recover(data, Skeleton(names, graph.edges), fps=fps, dtype=np.float64)
    seconds = time.perf_counter() - start
    return errors | {
        "robust": error(found.positions, hide),
        "observed": error(found.positions, np.isfinite(data[..., 0])),
        "edges": len(graph.edges),
        "seconds": seconds,
    }


def study(folder: Path, takes: list[str], most: int, seeds: int) -> dict:
    """Means over seeds, by row and take."""
    files = {name: read(folder / name) for name in TAKES + ASKED}
    lengths = [length for take in files.values() for length in gap_lengths(take.positions)]
    table: dict[str, dict] = {}
    for row in ROWS:
        for name in takes:
            take = files[name]
            start = max(0, (len(take) - most) // 2)
            truth = take.positions[start : start + most]
            runs = []
            for seed in range(seeds):
                hide = hidden(row, truth, take.fps, lengths, np.random.default_rng([seed, len(truth)]))
                runs.append(measure(truth, take.names, take.fps, hide))
            mean = {key: round(float(np.mean([run[key] for run in runs])), 3) for key in runs[0]}
            table.setdefault(row, {})[name] = mean
            print(f"{row:30}{name:21}" + "".join(f"{mean[key]:9.2f}" for key in mean), flush=True)
    return table


def main() -> None:
    """Run, write the results, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=300, help="of a take, at most (300)")
    parser.add_argument("--seeds", type=int, default=2, help="a row and take (2)")
    parser.add_argument("--takes", nargs="+", choices=TAKES + ASKED, default=list(TAKES))
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "markers.json")
    asked = parser.parse_args()
    columns = (*PEERS, "robust", "observed", "edges", "seconds")
    print(f"{'mm on hidden samples':51}" + "".join(f"{name[:8]:>9}" for name in columns))
    table = study(data_folder() / "markers", asked.takes, asked.frames, asked.seeds)
    results = {"unit": "mm", "frames": asked.frames, "seeds": asked.seeds, "rows": table}
    asked.output.parent.mkdir(exist_ok=True)
    with write_beside(asked.output, overwrite=True) as temporary:
        temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
