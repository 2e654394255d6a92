"""CSV: one table, wide or long, described by comment lines at its top; read and written, exact.

    # fps: 120                                     # unit: m          (m, cm, mm, in, ft, or metres in one unit)
    # up: y                                        # parents: -1, 0   or  # bones: [["root", "knee"], ...]  or  a-b, c-d
    # rest_offsets: [[0, 0, 0], ...]               # dtype: float32   # history: ["read walk.bvh", ...]

Wide: `frame`, then `<joint>_x`, `<joint>_y`, `<joint>_z` a joint, also with a dot or a space and in capitals, and
optionally `<joint>_confidence` and `<joint>_observed` (0 or 1). Long: `frame,joint,x,y,z`, optionally `confidence`
and `observed`; a pair of frame and joint without a row is missing. Columns called time, timestamp or seconds are
passed over. An empty or NaN cell is missing. Commas, semicolons or tabs separate the cells. A table of numbers without
a header has x, y, z of marker1, marker2, ... in its columns.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn, TypeVar

import numpy as np

from motionrecover.io.bones import skeleton_for
from motionrecover.io.border import (
    Asked,
    assume,
    counted,
    finite,
    frame_rate,
    metres_in,
    motion_from,
    parents_of,
    read_lines,
    shown,
    up_axis,
)
from motionrecover.io.errors import MotionFormatError
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

KEYS = ("fps", "unit", "up", "parents", "bones", "rest_offsets", "dtype", "history")
"""Comment keys that mean something; other comments are passed over."""

CLOCKS = ("time", "timestamp", "seconds")
"""Columns that are passed over: a motion has a constant frame rate."""

NO_HEADER = 0
"""Line of a header that the table lacks."""

_COLUMN = re.compile(r"(.+)[._ ](x|y|z|confidence|observed)$", re.IGNORECASE | re.DOTALL)
_T = TypeVar("_T")

_PARTS = ("x", "y", "z", "confidence", "observed")


@dataclass(frozen=True)
class _Table:
    path: Path
    comments: dict[str, tuple[int, str]]
    """Line number and text of each key."""
    header_line: int
    columns: list[str]
    numbers: list[int]
    """Line number of each row."""
    rows: list[list[str]]


@dataclass(frozen=True)
class _Samples:
    """What the rows say: names in file order; parts (frame, joint, 5) in the order of `_PARTS`, NaN where empty."""

    names: list[str]
    parts: np.ndarray
    has: set[str]
    """The parts that the table has columns for."""


def read(path: Path, asked: Asked) -> Motion:
    """Motion of a CSV file, wide or long, in the dtype it states or float64.

    `fps` and `unit` have to be stated or asked for. Bones that neither states are those of a standard with such joints,
    or inferred from the distances; an up axis is assumed to be y. Both assumptions are a `MotionFormatWarning`.

    Raises `MotionFormatError` for a table that is not whole, not described, or not numeric.
    """
    table = _table(path)
    samples = _long(table) if {"joint", "x", "y", "z"} <= {c.lower() for c in table.columns} else _wide(table)
    unit, fps, up = asked.unit, asked.fps, asked.up
    unit = unit if unit is not None else _stated(table, "unit", metres_in)
    fps = fps if fps is not None else _stated(table, "fps", frame_rate)
    up = up if up is not None else _stated(table, "up", up_axis)
    if fps is None or unit is None:
        name = "fps" if fps is None else "unit"
        raise MotionFormatError(f"{path} states no {name}: give {name}= (--{name}) or start it with '# {name}: ...'")
    own = _own_skeleton(table, samples.names)
    skeleton, order, note = skeleton_for(path, samples.names, own, asked.skeleton, samples.parts[..., :3])
    frames, joints = samples.parts.shape[:2]
    history = [
        *(_stated(table, "history", _history) or []),
        f"read {path.name} (CSV): {counted(frames, 'frame')}, {counted(joints, 'joint')}; {note}",
    ]
    if table.header_line == NO_HEADER:
        history.append(assume(f"{path.name} has no header: took its columns for x, y, z of one marker after the other"))
    if up is None:
        up = "y"
        history.append(assume(f"{path.name} states no up axis: assumed y, override with up= (--up)"))
    parts = samples.parts[:, order]
    return motion_from(
        parts[..., :3].astype(_stated(table, "dtype", _dtype) or np.float64),
        skeleton,
        fps=fps,
        unit=unit,
        up=up,
        history=tuple(history),
        observed=np.isfinite(parts[..., :3]).all(-1) & (parts[..., 4] != 0) if "observed" in samples.has else None,
        confidence=parts[..., 3] if "confidence" in samples.has else None,
    )


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
        if not name or name != name.strip() or not name.isprintable():
            raise ValueError(f"received joint name {name!r}: CSV takes printable names without spaces around them")
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


def _table(path: Path) -> _Table:
    """Comments, columns and rows of a CSV file, every row as long as the header."""
    comments: dict[str, tuple[int, str]] = {}
    filled = [(number, line) for number, line in enumerate(read_lines(path), 1) if line.strip()]
    while filled and filled[0][1].lstrip().startswith("#"):
        number, line = filled.pop(0)
        key, _, value = line.lstrip(" #").partition(":")
        if key.strip().lower() in KEYS:
            comments[key.strip().lower()] = (number, value.strip())
    if len(filled) < 2:
        raise MotionFormatError(f"{path} holds {'no rows' if filled else 'no header'}: get the whole file")
    numbers = [number for number, _ in filled]
    delimiter = next((mark for mark in ",;\t" if mark in filled[0][1]), ",")
    first = [cell.strip() for cell in filled[0][1].split(delimiter)]
    if len(first) % 3 == 0 and all(finite(cell or "0") is not None for cell in first):
        header = delimiter.join(f"marker{marker + 1}_{axis}" for marker in range(len(first) // 3) for axis in "xyz")
        filled.insert(0, (NO_HEADER, header))
        numbers.insert(0, NO_HEADER)
    try:
        cells = csv.reader((line for _, line in filled), delimiter=delimiter, skipinitialspace=True, strict=True)
        columns, *rows = list(cells)
    except csv.Error as error:
        raise MotionFormatError(f"{path} has quotation marks that do not pair up ({error}): correct them") from error
    for number, row in zip(numbers[1:], rows, strict=False):
        if len(row) != len(columns):
            raise MotionFormatError(
                f"{path}, line {number}: received {counted(len(row), 'cell')} under {counted(len(columns), 'column')}, "
                "the row was cut off or has a stray separator"
            )
    return _Table(path, comments, numbers[0], [column.strip() for column in columns], numbers[1:], rows)


def _wide(table: _Table) -> _Samples:
    """Samples of a table with a row a frame."""
    where: dict[str, dict[str, int]] = {}
    clock = None
    for c, column in enumerate(table.columns):
        match = _COLUMN.match(column)
        if match:
            parts = where.setdefault(match[1], {})
            if match[2].lower() in parts:
                _fail_header(table, f"received column {shown(column)} twice, remove one")
            parts[match[2].lower()] = c
        elif column.lower() == "frame":
            clock = c
        elif column.lower() not in CLOCKS:
            _fail_header(table, f"received column {shown(column)}, name columns frame, time or <joint>_x, _y, _z")
    if not where:
        _fail_header(table, "received no joint columns, name them <joint>_x, <joint>_y, <joint>_z")
    for name, parts in where.items():
        lost = next((axis for axis in "xyz" if axis not in parts), None)
        if lost:
            _fail_header(table, f"received joint {name!r} without {lost}, add the column {name}_{lost}")
    if clock is not None:
        frames = _frames(table, clock).tolist()
        for i, step in enumerate(np.diff(frames).tolist()):
            if step != 1:
                raise MotionFormatError(
                    f"{table.path}, line {table.numbers[i + 1]}: received frame {frames[i + 1]} after {frames[i]}, "
                    "give every frame a row, with empty cells where nothing was measured"
                )
    parts = np.full((len(table.rows), len(where), len(_PARTS)), np.nan)
    used = [(joint, _PARTS.index(part), c) for joint, found in enumerate(where.values()) for part, c in found.items()]
    joints, slots, chosen = (list(each) for each in zip(*used, strict=True))
    parts[:, joints, slots] = _floats(table, chosen)
    return _Samples(list(where), parts, {part for found in where.values() for part in found})


def _long(table: _Table) -> _Samples:
    """Samples of a table with a row a frame and joint."""
    columns = [column.lower() for column in table.columns]
    wrong = [name for name in columns if name not in ("frame", "joint", *_PARTS, *CLOCKS) or columns.count(name) > 1]
    if wrong or "frame" not in columns:
        what = f"received column {shown(wrong[0])}" if wrong else "received no column frame"
        _fail_header(table, f"{what}, name each of frame, joint, x, y, z, confidence, observed once")
    at_frame, at_joint = columns.index("frame"), columns.index("joint")
    frames = _frames(table, at_frame)
    joints = [row[at_joint].strip() for row in table.rows]
    index = {name: j for j, name in enumerate(dict.fromkeys(joints))}
    first, count = int(frames.min()), int(np.ptp(frames)) + 1
    # A clip may lack whole frames, but time stamps would ask for memory without end.
    if count > 10 * len(frames):
        raise MotionFormatError(
            f"{table.path} has frames {first} to {first + count - 1} in {counted(len(frames), 'row')}: "
            "number the frames one by one"
        )
    where = (frames - first) * len(index) + np.array([index[name] for name in joints])
    places, firsts = np.unique(where, return_index=True)
    if len(places) != len(where):
        row = int(np.setdiff1d(np.arange(len(where)), firsts)[0])
        raise MotionFormatError(
            f"{table.path}, line {table.numbers[row]}: received frame {frames[row]} of joint {joints[row]!r} again, "
            "remove one"
        )
    has = [part for part in _PARTS if part in columns]
    parts = np.full((count * len(index), len(_PARTS)), np.nan)
    slots = np.array([_PARTS.index(part) for part in has])
    parts[where[:, None], slots] = _floats(table, [columns.index(part) for part in has])
    return _Samples(list(index), parts.reshape(count, len(index), len(_PARTS)), set(has))


def _floats(table: _Table, columns: Sequence[int]) -> np.ndarray:
    """Cells (row, column) as float64, NaN where empty."""
    try:
        values = np.array([[float(row[c].strip() or "nan") for c in columns] for row in table.rows])
        if not np.isinf(values).any():
            return values
    except ValueError:
        pass
    missing = ("", "nan", "+nan", "-nan")
    number, cell, c = next(
        (number, row[c].strip(), c)
        for number, row in zip(table.numbers, table.rows, strict=True)
        for c in columns
        if row[c].strip().lower() not in missing and finite(row[c]) is None
    )
    raise MotionFormatError(
        f"{table.path}, line {number}: received {shown(cell)} in column {table.columns[c]!r}, write a finite number, "
        "or nothing where nothing was measured"
    )


def _frames(table: _Table, column: int) -> np.ndarray:
    """Frame numbers (row,)."""
    values = _floats(table, [column])[:, 0]
    for i in np.flatnonzero(np.isnan(values) | (values != np.trunc(values)) | (np.abs(values) > 2**53))[:1]:
        raise MotionFormatError(
            f"{table.path}, line {table.numbers[i]}: received frame {shown(table.rows[i][column])}, write a "
            "whole number"
        )
    return values.astype(np.int64)


def _fail_header(table: _Table, what: str) -> NoReturn:
    raise MotionFormatError(f"{table.path}, line {table.header_line}: {what}")


def _stated(table: _Table, key: str, parse: Callable[[str], _T]) -> _T | None:
    """What the comment `key` says, None where there is no such comment."""
    if key not in table.comments:
        return None
    number, text = table.comments[key]
    try:
        return parse(text)
    except ValueError as error:
        raise MotionFormatError(f"{table.path}, line {number}: {error}") from error


def _own_skeleton(table: _Table, names: list[str]) -> Skeleton | None:
    """The skeleton that the comments describe, None where they name no bones."""
    offsets = _stated(table, "rest_offsets", _vectors)
    if "parents" in table.comments:
        return _stated(table, "parents", lambda text: Skeleton.from_parents(names, _whole_numbers(text), offsets))
    return _stated(table, "bones", lambda text: Skeleton(names, _bones(text, names), offsets))


def _whole_numbers(text: str) -> list[int]:
    """Numbers between commas, with or without brackets."""
    try:
        return [int(word) for word in text.strip("[] ").split(",")]
    except ValueError as error:
        raise ValueError(f"received parents {shown(text)}, write whole numbers between commas") from error


def _bones(text: str, names: list[str]) -> list[tuple[str, str]]:
    """Bones as a JSON list of pairs, or as `a-b, c-d` where only one reading fits the joint names."""
    if text.startswith("["):
        pairs = _json_list(text)
        if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
            raise ValueError(f'received bones {shown(text)}, write pairs of joint names: [["a", "b"], ...]')
        return [(str(first), str(second)) for first, second in pairs]
    bones = []
    for word in filter(None, map(str.strip, text.split(","))):
        cuts = [(word[:i].strip(), word[i + 1 :].strip()) for i, mark in enumerate(word) if mark == "-"]
        fitting = [cut for cut in cuts if set(cut) <= set(names)]
        if len(fitting) != 1:
            raise ValueError(
                f"received bone {shown(word)}, which {len(fitting) or 'no'} pairs of the joints fit: "
                'write bones as [["a", "b"], ...]'
            )
        bones += fitting
    return bones


def _json_list(text: str) -> list:
    try:
        value = json.loads(text)
    except json.JSONDecodeError:
        value = None
    if not isinstance(value, list):
        raise ValueError(f"received {shown(text)}, write a JSON list")
    return value


def _vectors(text: str) -> np.ndarray:
    try:
        return np.array(_json_list(text), float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"received {shown(text)}, write one [x, y, z] a joint") from error


def _history(text: str) -> list[str]:
    return [str(line) for line in _json_list(text)]


def _dtype(text: str) -> np.dtype:
    if text not in ("float16", "float32", "float64"):
        raise ValueError(f"received dtype {shown(text)}, write float32 or float64")
    return np.dtype(text)
