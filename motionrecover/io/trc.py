"""TRC (Track Row Column): optical markers as a table, in the layout of OpenSim; read and written.

    PathFileType  4         (X/Y/Z)    walk.trc
    DataRate      CameraRate  NumFrames  NumMarkers  Units  OrigDataRate  OrigDataStartFrame  OrigNumFrames
    100           100         2          1           mm     100           1                   2
    Frame#        Time        LHEE
                              X1         Y1          Z1

    1             0.00        733.7041   80.9832     191.8668
    2             0.01

Tabs separate the cells; commas and semicolons are read too, as spreadsheets leave them, and so are decimal commas.
Blank and NaN cells are missing, also those that a row lacks at its end. Where the header counts other frames or markers
than there are, those that are there count, which is said aloud. The format states no up axis: y, OpenSim's, is assumed.

A clip that came from TRC is written in the unit, axes, frame numbers and times of its file; any other in millimetres
with y up, from frame 1 at 0 s.

Source: OpenSim documentation, "Marker (.trc) files".
"""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from motionrecover.io.bones import skeleton_for
from motionrecover.io.border import (
    PLAIN,
    Asked,
    Lines,
    assume,
    counted,
    finite,
    from_metres,
    motion_from,
    plain,
    read_lines,
    refuse_swollen,
    shown,
    source_of,
    unit_spelled,
)
from motionrecover.io.errors import MotionFormatError
from motionrecover.motion import UNITS, Motion
from motionrecover.source import Source

FACTS = (
    *("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"),
    *("OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"),
)


@dataclass(frozen=True)
class _Table:
    facts: dict[str, str]
    """What stands below each of `FACTS`."""
    names: list[str]
    cells: np.ndarray
    """(frame, 2 + 3 markers): frame number, time, coordinates; NaN where blank."""


def read(path: Path, asked: Asked) -> Motion:
    """Motion of a TRC file (float64).

    Raises `MotionFormatError` for a file that is no whole table of numbers under such a header, or states no rate.
    """
    lines = read_lines(path)
    table = _table(path, lines)
    names, frames = table.names, len(table.cells)
    positions = table.cells[:, 2:].reshape(frames, len(names), 3)
    skeleton, order, note = skeleton_for(path, names, None, asked.skeleton, positions)
    history = [f"read {path.name} (TRC): {counted(frames, 'frame')}, {counted(len(names), 'joint')}; {note}"]
    for fact, noun, number in (("NumFrames", "frame", frames), ("NumMarkers", "marker", len(names))):
        stated = table.facts.get(fact, "")
        if finite(stated) != number:
            history.append(
                assume(f"{path.name} states {fact} {shown(stated)}: took the {counted(number, noun)} it has")
            )
    fps = asked.fps or finite(table.facts.get("DataRate", ""))
    if fps is None or fps <= 0:
        raise MotionFormatError(
            f"{path}, line 3: received DataRate {shown(table.facts.get('DataRate', ''))}, write frames a second above "
            "0 or give fps= (--fps)"
        )
    stated = table.facts.get("Units", "")
    unit = asked.unit or unit_spelled(stated)
    if unit is None:
        unit = UNITS["mm"]
        history.append(assume(f"{path.name} states Units {shown(stated)}: assumed mm, override with unit= (--unit)"))
    if asked.up is None:
        history.append(assume(f"{path.name} states no up axis: assumed y, override with up= (--up)"))
    motion = motion_from(
        positions, skeleton, fps=fps, unit=unit, up=asked.up or "y", history=tuple(history), order=order
    )
    return replace(motion, source=Source("trc", lines.content, range(frames)))


def write(motion: Motion, path: Path) -> None:
    """Write a motion as TRC, ten digits a number. Raises `MotionFormatError` for names that no line can hold."""
    for name in motion.names:
        if not plain(name):
            raise MotionFormatError(f"received joint name {name!r}: TRC takes {PLAIN}")
    source, count, markers = source_of(motion, "trc"), len(motion), len(motion.names)
    rate = f"{motion.fps:.10g}"
    facts = dict(zip(FACTS, (rate, rate, "", "", "mm", rate, "1", str(count)), strict=True))
    unit, up, clock = UNITS["mm"], "y", np.stack([np.arange(count) + 1, np.arange(count) / motion.fps], -1)
    if source is not None:
        own = _table(path, Lines(source.content))
        facts |= own.facts
        unit, up, clock = motion.unit, motion.up, own.cells[source.kept.start : source.kept.stop, :2]
    facts |= {"NumFrames": str(count), "NumMarkers": str(markers)}
    positions = from_metres(motion.positions.astype(np.float64), unit, up).reshape(count, -1)
    rows = io.StringIO()
    np.savetxt(rows, np.concatenate([clock, positions], 1) + 0.0, fmt="%.10g", delimiter="\t")
    head = [
        "PathFileType\t4\t(X/Y/Z)\tmotionrecover",
        "\t".join(FACTS),
        "\t".join(facts[fact] for fact in FACTS),
        "\t".join(["Frame#", "Time", *("\t".join([name, "", ""]) for name in motion.names)]),
        "\t".join(["", "", *(f"X{k}\tY{k}\tZ{k}" for k in range(1, markers + 1))]),
        "",
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write("\r\n".join(head) + "\r\n" + rows.getvalue().replace("nan", "").replace("\n", "\r\n"))


def _table(path: Path, lines: Lines) -> _Table:
    """Header and cells of a TRC file."""

    def fail(line: int, what: str) -> NoReturn:
        raise MotionFormatError(f"{path}, line {line}: {what}")

    head = list(itertools.islice(lines, 5))
    if not head[0].strip().startswith("PathFileType"):
        fail(1, f"received {shown(head[0])}, where a TRC file says PathFileType")
    if len(lines) < 6:
        fail(len(lines), "the file ends inside its header, get the whole file")
    mark = next((mark for mark in "\t,;" if mark in head[1]), "\t")
    heads = [[cell.strip() for cell in line.split(mark)] for line in head[1:]]
    facts = {key: value for key, value in zip(heads[0], heads[1], strict=False) if key in FACTS}
    names, axes = [cell for cell in heads[2] if cell][2:], [cell for cell in heads[3] if cell]
    if heads[2][0] != "Frame#" or not names:
        fail(4, f"received {shown(head[3])}, where a TRC file says Frame#, Time and the names of the markers")
    if len(axes) != 3 * len(names):
        fail(5, f"received {counted(len(axes), 'coordinate')} under {counted(len(names), 'marker')}, name each once")

    def rows() -> Iterator[tuple[int, str]]:
        return ((number, line) for number, line in enumerate(lines, 1) if number > 5 and line.strip(mark + " "))

    def whole() -> Iterator[str]:
        for number, line in rows():
            filled = line.rstrip(mark + " ")
            cells = filled.count(mark) + 1
            # What lacks at the end was left away by the program that wrote the file, unless a marker is cut in two.
            if cells > width or (cells % 3 != 2 and line.count(mark) + 1 < width):
                fail(
                    number,
                    f"received {counted(cells, 'cell')} for frame, time and {counted(len(names), 'marker')}, the row "
                    "was cut off or has a stray separator",
                )
            filled += mark * (width - cells)
            yield blank.sub("nan", filled.replace(",", ".") if commas else filled)

    width, blank = 2 + 3 * len(names), re.compile(rf"(?:^|(?<={mark})) *(?={mark}|$)")
    count = sum(1 for _ in rows())
    if not count:
        fail(len(lines), "the file ends before the first frame, get the whole file")
    refuse_swollen(path, len(lines.content), count, len(names))
    commas = mark != "," and not any("." in line for _, line in rows())
    if commas:
        facts = {key: value.replace(",", ".") for key, value in facts.items()}
    try:
        cells = np.loadtxt(whole(), delimiter=mark, comments=None, ndmin=2)
    except MotionFormatError:
        raise
    except ValueError:
        for (number, _), line in zip(rows(), whole(), strict=True):
            for cell in line.split(mark):
                if cell.strip().lower() not in ("nan", "-nan") and finite(cell) is None:
                    fail(number, f"received {shown(cell)}, write a finite number, or nothing where it is missing")
        fail(6, "the rows are not plain numbers, export the file again")
    expected = cells[0, 0] + np.arange(len(cells))
    for row in np.flatnonzero(cells[:, 0] != expected)[:1]:
        number, _ = next(itertools.islice(rows(), int(row), None))
        fail(
            number,
            f"received frame {cells[row, 0]:.10g} where {expected[row]:.10g} is due, give every frame a row, with "
            "blank cells where nothing was measured",
        )
    return _Table(facts, names, cells)
