"""Writing CSV: a motion as a wide or a long table as `io.csv` reads them, in metres with y up, every number exact."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np

from motionrecover.io.border import PLAIN, parents_of, plain
from motionrecover.motion import Motion


def write_wide(motion: Motion, path: Path) -> None:
    """Write a motion as a row a frame, in metres with y up, every number exact."""
    parts = _written_parts(motion)
    columns = ["frame", *(f"{name}_{part}" for name in motion.names for part, _, _ in parts)]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(_comments(motion))
        table = csv.writer(file, lineterminator="\n")
        table.writerow(columns)
        for frame in range(len(motion)):
            cells = [[_cell(v, form) for v in values[frame].tolist()] for _, values, form in parts]
            table.writerow([frame, *(cell for joint in zip(*cells, strict=True) for cell in joint)])


def write_long(motion: Motion, path: Path) -> None:
    """Write a motion as a row a frame and joint, in metres with y up, every number exact."""
    parts = _written_parts(motion)
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(_comments(motion))
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["frame", "joint", *(part for part, _, _ in parts)])
        for frame in range(len(motion)):
            cells = [[_cell(v, form) for v in values[frame].tolist()] for _, values, form in parts]
            table.writerows([frame, *row] for row in zip(motion.names, *cells, strict=True))


def _written_parts(motion: Motion) -> list[tuple[str, np.ndarray, str]]:
    """(name, values (frame, joint), number format) of the columns that a motion needs."""
    for name in motion.names:
        if not plain(name):
            raise ValueError(f"received joint name {name!r}: CSV takes {PLAIN}")
    # 9 significant digits restore every float32, 17 every float64.
    form = ".9g" if motion.positions.dtype.itemsize <= 4 else ".17g"
    parts = [(axis, motion.positions[..., i], form) for i, axis in enumerate("xyz")]
    if motion.confidence is not None:
        parts.append(("confidence", np.asarray(motion.confidence, float), ".17g"))
    if (motion.observed != np.isfinite(motion.positions).all(-1)).any():
        parts.append(("observed", motion.observed, "d"))
    return parts


def _cell(value: float, form: str) -> str:
    return "" if math.isnan(value) else format(value, form)


def _comments(motion: Motion) -> str:
    """The comment lines that describe a motion."""
    skeleton = motion.skeleton
    parents = parents_of(skeleton)
    lines = {
        "fps": repr(float(motion.fps)),
        "unit": "m",
        "up": "y",
        "dtype": min(motion.positions.dtype, np.dtype("f8")).name,
    }
    if parents is None:
        bones = [[skeleton.names[i], skeleton.names[j]] for i, j in skeleton.edges]
        lines["bones"] = json.dumps(bones, ensure_ascii=False)
    else:
        lines["parents"] = ", ".join(map(str, parents))
    if skeleton.rest_offsets is not None:
        lines["rest_offsets"] = json.dumps(skeleton.rest_offsets)
    if motion.history:
        lines["history"] = json.dumps(motion.history, ensure_ascii=False)
    return "".join(f"# {key}: {value}\n" for key, value in lines.items())
