"""What each part of `robust` is worth: the preset with one part changed or left out, on five protocols.

    python -m benchmarks.studies.robust [--clips N] [--variants ...] [--output FILE]

Every variant sets constants or functions of the package for its run. Rows and clips are those of `benchmarks.suite`,
one seed; a row's error is over missing samples where it makes gaps, over all samples elsewhere. Results:
`results/robust.json`.

Tried and dropped while the preset was built, by means over 4 to 16 CMU clips. Their code is gone, so nothing here
measures them again:

    wavelets shrunk by the noise level in place of the smoother    3 mm of noise at 120 Hz: 2.5 mm, shift-invariant 2.2,
                                                                   the smoother 1.9
    a drive of 3S x 3S, the axes apart                             3 mm of noise: 3.0 mm
    third differences                                              no row better
    a uniform density for outliers                                 80 % displaced at 30 Hz: 101 mm instead of 27
    Student's t with the noise inside for intact samples           10 cm spikes in 3 mm of noise are accepted
    an activity for each joint                                     3 mm of noise: 1.82 instead of 1.83 mm; gap3x60: 7.8
                                                                   instead of 7.6
    residuals given back until accelerations are the motion's      3 mm of noise at 120 Hz: accelerations 0.93 of the
                                                                   truth's instead of 0.55, error 1.88 instead of 1.83;
                                                                   on Kinect recordings most of the jitter stays
    a quarter of the noise in the last pass, to the same end       0.86 and 1.99 mm
    trust in repaired samples by their variance, in the            gap3x60 7.3 instead of 7.4 mm, gap3x240 17.9 instead
    regression                                                     of 16.1
    how other joints move as a further input                       gap3x60, 40 clips: 8.4 to 8.7 instead of 8.0 mm
    candidates' disagreement as the covariance that bones move     gap3x60, 40 clips: 7.93 instead of 8.01 mm
    a missing joint by
    the prior of the drive with joints correlated as in other      3 cm of noise at 60 Hz: 15.0 instead of 15.4 mm; by
    people's accelerations                                         their distance along the body 15.1
    one more pass of the smoother with a hundredth of the least    optical markers, 10 % missing: 0.34 instead of 0.32
    noise, in place of interpolated residuals                      mm, 0.47 of 0.45, 0.10 of 0.08, 1.45 of 1.40
    stacking of the regression's candidates                        2 to 16 % worse than weights by error
    the clip's own mirror image among the poses of other people    gap3x60, 40 clips: 8.83 instead of 8.85 mm
    orientation in the room as a further input of the regression   gap3x60, 40 clips: 8.66 instead of 8.85 mm, gap3x240
                                                                   17.0 instead of 16.2
"""

from __future__ import annotations

import argparse
import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import jax
import numpy as np

from benchmarks.recordings import data_folder
from benchmarks.suite import clips, measure, methods, rows
from motionrecover import body, estimate, programs
from motionrecover.io.atomic import write_beside
from motionrecover.solver import smoother
from motionrecover.solver.smoother import Smoother

ROWS = (
    "iid-50 cmu25 120 Hz",
    "iid-80 cmu25 30 Hz, bones known",
    "gap3x60 cmu21 120 Hz",
    "mixed cmu21 30 Hz",
    "noise-3 cmu21 120 Hz",
)

Change = tuple[Any, str, Any]
"""Module or class, name, value."""


def unheld(positions, covariance, *_):
    """In place of the projection."""
    return positions.copy(), np.einsum("tjj->tj", covariance)


VARIANTS: dict[str, tuple[Change, ...]] = {
    "as it is": (),
    "no annealing": ((Smoother, "HOT", Smoother.COLD),),
    "outliers from 2 mm": ((Smoother, "GROSS", 0.01),),
    "one noise level": ((smoother, "USUAL", 1e9),),
    "bones do not vouch": ((body, "evidence", lambda lengths, bones: np.zeros_like(lengths)),),
    "no regression": ((estimate, "SHORT", 10**9),),
    "gaps not steadied": ((estimate, "whittaker", lambda positions, variance, drive, order=2: positions),),
    "bones not held": ((estimate, "project_blocks", unheld),),
}


def study(chosen: list[str], count: int) -> dict[str, dict[str, float]]:
    """The mean error in mm by variant and row."""
    folder, method = data_folder(), methods.METHODS["robust"]
    table = {}
    for name in chosen:
        # Constants are part of compiled programs.
        programs._place.cache_clear()
        jax.clear_caches()
        with ExitStack() as stack:
            for owner, attribute, value in VARIANTS[name]:
                stack.enter_context(patch.object(owner, attribute, value))
            table[name] = {row.name: error(row, method, folder, count) for row in map(_row, ROWS)}
        print(f"{name:30}" + "".join(f"{value:10.3f}" for value in table[name].values()), flush=True)
    return table


def error(row: rows.Row, method: methods.Method, folder: Path, count: int) -> float:
    """Mean over `count` clips of the row's error."""
    found = []
    for name in clips.pick(folder, row.skeleton, row.fps, count, row.subjects, row.frames)[0]:
        clip = clips.read(folder, name, row.skeleton, row.fps)
        data = row.corrupted(clip, 0)
        answer = method.run(data.copy(), clip, clip.bone_lengths if row.bones == "known" else None)
        found.append(measure.score(answer, data, clip)[row.headline])
    return round(float(np.mean(found)), 3)


def _row(name: str) -> rows.Row:
    return rows.find([name])[0]


def main() -> None:
    """Measure, print the table, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=2, help="a row (2)")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "robust.json")
    asked = parser.parse_args()
    print(f"{'mm':30}" + "".join(f"{row.split(' ')[0]:>10}" for row in ROWS))
    results = {"clips": asked.clips, "errors": study(asked.variants, asked.clips)}
    with write_beside(asked.output, overwrite=True) as temporary:
        temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
