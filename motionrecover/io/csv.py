"""CSV: one table, wide or long, described by comment lines at its top; read here, written by `csv_out`, exact.

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
import itertools
import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn, TypeVar

import numpy as np

from motionrecover.io.bones import skeleton_for
from motionrecover.io.border import (
    Asked,
    Lines,
    assume,
    counted,
    finite,
    frame_rate,
    metres_in,
    motion_from,
    read_lines,
    refuse_swollen,
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

_EXTRA = ("confidence", "observed")
_PARTS = ("x", "y", "z", *_EXTRA)
_LONG = {"joint", "x", "y", "z"}
"""Columns that only a long table has."""


@dataclass(frozen=True)
class _Table:
    path: Path
    lines: Lines
    comments: dict[str, tuple[int, str]]
    """Line number and text of each key."""
    header_line: int
    columns: list[str]
    delimiter: str
    begin: int
    """Number of the line from which on there are rows."""

    def filled(self) -> Iterator[tuple[int, str]]:
        """Line number and text of each row."""
        return ((number, line) for number, line in enumerate(self.lines, 1) if number >= self.begin and line.strip())

    def number(self, row: int) -> int:
        """Line number of a row."""
        return next(itertools.islice(self.filled(), int(row), None))[0]

    def rows(self) -> Iterator[list[str]]:
        """Cells of each row, as many as there are columns."""
        lines = (line for _, line in self.filled())
        rows = csv.reader(lines, delimiter=self.delimiter, skipinitialspace=True, strict=True)
        try:
            for k, row in enumerate(rows):
                if rows.line_num != k + 1:
                    raise csv.Error("one goes on in the next line")
                if len(row) != len(self.columns):
                    raise MotionFormatError(
                        f"{self.path}, line {self.number(k)}: received {counted(len(row), 'cell')} under "
                        f"{counted(len(self.columns), 'column')}, the row was cut off or has a stray separator"
                    )
                yield row
        except csv.Error as error:
            raise _unpaired(self.path, self.number(rows.line_num - 1), error) from error


@dataclass(frozen=True)
class _Samples:
    """What the rows say: names in file order, and an array (frame, joint, ...) for each that has columns.

    NaN where empty.
    """

    names: list[str]
    positions: np.ndarray
    confidence: np.ndarray | None
    observed: np.ndarray | None


def read(path: Path, asked: Asked) -> Motion:
    """Motion of a CSV file, wide or long, in the dtype it states or float64.

    `fps` and `unit` have to be stated or asked for. Bones that neither states are those of a standard with such joints,
    or inferred from the distances; an up axis is assumed to be y. Both assumptions are a `MotionFormatWarning`.

    Raises `MotionFormatError` for a table that is not whole, not described, or not numeric.
    """
    table = _table(path)
    samples = _long(table) if _LONG.intersection(map(str.lower, table.columns)) == _LONG else _wide(table)
    unit, fps, up = asked.unit, asked.fps, asked.up
    unit = unit if unit is not None else _stated(table, "unit", metres_in)
    fps = fps if fps is not None else _stated(table, "fps", frame_rate)
    up = up if up is not None else _stated(table, "up", up_axis)
    if fps is None or unit is None:
        name = "fps" if fps is None else "unit"
        raise MotionFormatError(f"{path} states no {name}: give {name}= (--{name}) or start it with '# {name}: ...'")
    own = _own_skeleton(table, samples.names)
    positions = samples.positions
    skeleton, order, note = skeleton_for(path, samples.names, own, asked.skeleton, positions)
    frames, joints = positions.shape[:2]
    history = [
        *(_stated(table, "history", _history) or []),
        f"read {path.name} (CSV): {counted(frames, 'frame')}, {counted(joints, 'joint')}; {note}",
    ]
    if table.header_line == NO_HEADER:
        history.append(assume(f"{path.name} has no header: took its columns for x, y, z of one marker after the other"))
    if up is None:
        up = "y"
        history.append(assume(f"{path.name} states no up axis: assumed y, override with up= (--up)"))
    with np.errstate(over="ignore"):  # what gets infinite by it is refused by `Motion`
        positions = positions.astype(_stated(table, "dtype", _dtype) or np.float64, copy=False)
    return motion_from(
        positions,
        skeleton,
        fps=fps,
        unit=unit,
        up=up,
        history=tuple(history),
        order=order,
        observed=None if samples.observed is None else samples.observed != 0,
        confidence=samples.confidence,
    )


def _table(path: Path) -> _Table:
    """Comments and columns of a CSV file, and where its rows begin."""
    lines = read_lines(path)
    comments: dict[str, tuple[int, str]] = {}
    filled = ((number, line) for number, line in enumerate(lines, 1) if line.strip())
    number, header = 0, None
    for number, line in filled:
        if not line.lstrip().startswith("#"):
            header = line
            break
        key, _, value = line.lstrip(" #").partition(":")
        if key.strip().lower() in KEYS:
            comments[key.strip().lower()] = (number, value.strip())
    if header is None:
        raise MotionFormatError(f"{path} holds no header: get the whole file")
    delimiter = next((mark for mark in ",;\t" if mark in header), ",")
    cells = header.count(delimiter) + 1
    named = cells % 3 != 0 or any(finite(cell.strip() or "0") is None for cell in header.split(delimiter))
    rows = sum(1 for _ in filled)
    if not rows:
        raise MotionFormatError(f"{path} holds no rows: get the whole file")
    refuse_swollen(path, len(lines.content), rows, cells // 3)
    if not named:
        columns = [f"marker{marker + 1}_{axis}" for marker in range(cells // 3) for axis in "xyz"]
        return _Table(path, lines, comments, NO_HEADER, columns, delimiter, number)
    try:
        (columns,) = csv.reader([header], delimiter=delimiter, skipinitialspace=True, strict=True)
    except csv.Error as error:
        raise _unpaired(path, number, error) from error
    return _Table(path, lines, comments, number, [column.strip() for column in columns], delimiter, number + 1)


def _unpaired(path: Path, line: int, error: csv.Error) -> MotionFormatError:
    return MotionFormatError(
        f"{path}, line {line}: received quotation marks that do not pair up ({error}), correct them"
    )


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
    # The coordinates come first and in order, so that the positions need no copy.
    used = [parts[axis] for parts in where.values() for axis in "xyz"]
    extra = [
        (part, joint, c) for joint, parts in enumerate(where.values()) for part, c in parts.items() if part in _EXTRA
    ]
    values, _ = _values(table, [*used, *(c for *_, c in extra), *([] if clock is None else [clock])])
    if clock is not None:
        frames = _frames(table, values[:, -1])
        for i in np.flatnonzero(np.diff(frames) != 1)[:1]:
            raise MotionFormatError(
                f"{table.path}, line {table.number(i + 1)}: received frame {frames[i + 1]} after {frames[i]}, "
                "give every frame a row, with empty cells where nothing was measured"
            )
    found = {part: np.full((len(values), len(where)), np.nan) for part, *_ in extra}
    for column, (part, joint, _) in enumerate(extra, len(used)):
        found[part][:, joint] = values[:, column]
    positions = values[:, : len(used)].reshape(len(values), len(where), 3)
    return _Samples(list(where), positions, found.get("confidence"), found.get("observed"))


def _long(table: _Table) -> _Samples:
    """Samples of a table with a row a frame and joint."""
    columns = [column.lower() for column in table.columns]
    times = Counter(columns)
    wrong = [name for name in columns if name not in ("frame", "joint", *_PARTS, *CLOCKS) or times[name] > 1]
    if wrong or "frame" not in columns:
        what = f"received column {shown(wrong[0])}" if wrong else "received no column frame"
        _fail_header(table, f"{what}, name each of frame, joint, x, y, z, confidence, observed once")
    at_frame, at_joint = columns.index("frame"), columns.index("joint")
    has = [part for part in _PARTS if part in columns]
    values, joints = _values(table, [*(columns.index(part) for part in has), at_frame], at_joint)
    frames = _frames(table, values[:, -1])
    index = {name: j for j, name in enumerate(dict.fromkeys(joints))}
    first, count = int(frames.min()), int(np.ptp(frames)) + 1
    # A clip may lack frames, but time stamps would ask for memory without end.
    if count > 10 * len(frames):
        raise MotionFormatError(
            f"{table.path} has frames {first} to {first + count - 1} in {counted(len(frames), 'row')}: "
            "number the frames one by one"
        )
    refuse_swollen(table.path, len(table.lines.content), count, len(index))
    where = (frames - first) * len(index) + np.array([index[name] for name in joints])
    places, firsts = np.unique(where, return_index=True)
    if len(places) != len(where):
        row = int(np.setdiff1d(np.arange(len(where)), firsts)[0])
        raise MotionFormatError(
            f"{table.path}, line {table.number(row)}: received frame {frames[row]} of joint {joints[row]!r} again, "
            "remove one"
        )
    positions = np.full((count * len(index), 3), np.nan)
    positions[where] = values[:, :3]
    extra = {}
    for column, part in enumerate(has[3:], 3):
        extra[part] = np.full(len(positions), np.nan)
        extra[part][where] = values[:, column]
    shape = count, len(index)
    extra = {part: each.reshape(shape) for part, each in extra.items()}
    return _Samples(list(index), positions.reshape(*shape, 3), extra.get("confidence"), extra.get("observed"))


def _values(table: _Table, columns: Sequence[int], label: int | None = None) -> tuple[np.ndarray, list[str]]:
    """Cells (row, column) as float64, NaN where empty, and the texts of the column `label`, row after row."""
    values, labels = np.empty((sum(1 for _ in table.filled()), len(columns))), []
    for k, row in enumerate(table.rows()):
        try:
            values[k] = [float(row[c].strip() or "nan") for c in columns]
        except ValueError:
            _blame(table, k, row, columns)
        if label is not None:
            labels.append(sys.intern(row[label].strip()))
    for k in np.flatnonzero(np.isinf(values).any(1))[:1]:
        _blame(table, k, next(itertools.islice(table.rows(), int(k), None)), columns)
    return values, labels


def _blame(table: _Table, k: int, row: list[str], columns: Sequence[int]) -> NoReturn:
    """Raise about the first cell of row k that is neither empty nor a finite number."""
    cell, column = next(
        (row[c].strip(), table.columns[c])
        for c in columns
        if row[c].strip().lower() not in ("", "nan", "+nan", "-nan") and finite(row[c]) is None
    )
    raise MotionFormatError(
        f"{table.path}, line {table.number(k)}: received {shown(cell)} in column {column!r}, write a finite number, or "
        "nothing where nothing was measured"
    )


def _frames(table: _Table, values: np.ndarray) -> np.ndarray:
    """Frame numbers (row,)."""
    for i in np.flatnonzero(np.isnan(values) | (values != np.trunc(values)) | (np.abs(values) > 2**53))[:1]:
        what = "no frame" if np.isnan(values[i]) else f"frame {values[i]:.10g}"
        raise MotionFormatError(f"{table.path}, line {table.number(i)}: received {what}, write a whole number")
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
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, list):
        raise ValueError(f"received {shown(text)}, write a JSON list")
    return value


def _vectors(text: str) -> np.ndarray:
    try:
        return np.array(_json_list(text), float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"received {shown(text)}, write one [x, y, z] a joint") from error


def _history(text: str) -> list[str]:
    return [str(line) for line in _json_list(text)]


def _dtype(text: str) -> np.dtype:
    if text not in ("float16", "float32", "float64"):
        raise ValueError(f"received dtype {shown(text)}, write float32 or float64")
    return np.dtype(text)
