"""C3D: optical markers, in a binary file with analog data, events and parameters of many kinds; read and written.

Reading. The joints are the points, with the labels they have; points that the file lists as angles, forces, moments,
powers or scalars are left out. A negative residual means that a sample was not measured: it is NaN. In a file that has
residuals, 0 means that a program computed the sample (interpolated, filtered): it counts as half a measurement,
confidence 0.5. Where the cameras that saw a sample are known, one that fewer saw than the usual number in the file has
the square of their ratio as its confidence. In CMU's 02_01 samples jitter by 0.80, 0.34, 0.22, 0.16, 0.15 and 0.14 mm
where 2 to 7 cameras saw them (median of third differences), and by 0.20 and 0.14 mm in the sixth of the smallest and of
the largest residuals: how large a residual is says nothing of use.

Writing a clip that came from C3D. The file is the one it came from, byte for byte, except for points whose position
differs: these get the new coordinates, in the file's own unit, axes and number format, residual 0 and no cameras, which
by convention marks whatever was computed: filled, denoised and repaired samples alike. Samples that are NaN get
residual -1. Points that were left out with `select`, or are no positions, stay as they came, and so does the frame
rate, whatever was asked for.

Any other clip makes a file of its points alone, in millimetres with z up, residual 0 throughout.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionrecover.io.bones import skeleton_for
from motionrecover.io.border import (
    Asked,
    assume,
    counted,
    from_metres,
    motion_from,
    read_bytes,
    refuse_swollen,
    shown,
    source_of,
    unit_spelled,
)
from motionrecover.io.c3d_layout import Layout, blank, layout_of
from motionrecover.io.errors import MotionFormatError
from motionrecover.motion import UNITS, Motion
from motionrecover.source import Source

COMPUTED = 0.5
"""Confidence of samples that a program computed."""
NO_POSITIONS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
"""Parameters of group POINT that list the labels of points which are something else."""
SAME = 1e-6
"""Of the distance from the origin: positions in 32-bit floats that differ by less are the same."""


def read(path: Path, asked: Asked) -> Motion:
    """Motion of a C3D file (float64).

    Unit and up axis are POINT:UNITS and POINT:Y_SCREEN; where the file does not state them, they are assumed to be
    millimetres and z, with a `MotionFormatWarning`.

    Raises `MotionFormatError` for a file that is damaged or not whole, or that states no frame rate.
    """
    content = read_bytes(path)
    layout = layout_of(content)
    refuse_swollen(path, len(content), layout.frames, layout.points)
    labels = _labels(layout)
    others = {label for name in NO_POSITIONS for label in _texts(layout, name)}
    columns = [column for column, label in enumerate(labels) if label not in others]
    if not columns:
        raise MotionFormatError(f"{path} holds {', '.join(NO_POSITIONS).lower()} only: there are no positions to read")
    points, fourth = layout.samples()
    points[fourth < 0] = np.nan
    names = [labels[column] for column in columns]
    skeleton, order, note = skeleton_for(path, names, None, asked.skeleton, points[:, columns])
    columns = [columns[column] for column in order]
    history = [f"read {path.name} (C3D): {counted(layout.frames, 'frame')}, {counted(len(columns), 'joint')}; {note}"]
    if len(columns) < layout.points:
        history.append(f"left {counted(layout.points - len(columns), 'point')} out that are no positions")

    stated = next(iter(layout.texts("POINT", "UNITS")), "")
    unit = asked.unit or unit_spelled(stated)
    if unit is None:
        unit = UNITS["mm"]
        what = f"the unit {shown(stated)}" if stated else "no unit"
        history.append(assume(f"{path.name} states {what}: assumed mm, override with unit= (--unit)"))
    stated = next(iter(layout.texts("POINT", "Y_SCREEN")), "")
    match = re.fullmatch(r"\+?([xyz])", stated.lower())
    up = asked.up or (match[1] if match else None)
    if up is None:
        up = "z"
        what = f"the up axis {shown(stated)}" if stated else "no up axis"
        history.append(assume(f"{path.name} states {what}: assumed z, override with up= (--up)"))
    fps = asked.fps or layout.rate
    if not (np.isfinite(fps) and fps > 0):
        raise MotionFormatError(f"{path} states a frame rate of {fps:g}: give fps= (--fps)")

    motion = motion_from(
        points[:, columns],
        skeleton,
        fps=fps,
        unit=unit,
        up=up,
        history=tuple(history),
        confidence=_confidence(fourth[:, columns]),
    )
    return replace(motion, source=Source("c3d", content, range(layout.frames)))


def write(motion: Motion, path: Path) -> None:
    """Write a motion into the file that it came from, or into one of its own.

    Raises `MotionFormatError` where the motion does not fit its file any more, and for what no C3D file can hold.
    """
    path.write_bytes(_written(motion))


def _written(motion: Motion) -> bytes:
    """The file that `write` writes."""
    unit, up, source = motion.unit, motion.up, source_of(motion, "c3d")
    if source is None:
        unit, up = UNITS["mm"], "z"
        facts = {"UNITS": "mm", "X_SCREEN": "+X", "Y_SCREEN": "+Z"}
        source = Source("c3d", blank(motion.names, len(motion), motion.fps, facts), range(len(motion)))
    layout = layout_of(source.content)
    labels = {label: column for column, label in enumerate(_labels(layout))}
    lost = next((name for name in motion.names if name not in labels), None)
    if lost is not None:
        raise MotionFormatError(
            f"received joint {lost!r}, which the C3D file does not hold: leave the file that the clip came from out "
            "with source=None, and use names without spaces at their ends"
        )
    columns = [labels[name] for name in motion.names]
    points, fourth = (part[source.kept.start : source.kept.stop] for part in layout.samples())
    before, word = points[:, columns], fourth[:, columns]
    after = from_metres(motion.positions.astype(np.float64), unit, up)
    known, was_known = np.isfinite(after).all(-1), np.isfinite(before).all(-1) & (word >= 0)
    off = np.linalg.norm(after - before, axis=-1)
    near = off <= SAME * np.linalg.norm(before, axis=-1)
    changed = np.zeros(fourth.shape, bool)
    changed[:, columns] = np.where(known & was_known, ~near, known != was_known)
    points[:, columns] = after
    fourth[:, columns] = np.where(known, 0, -1)
    return layout.written(points, fourth, changed, source.kept)


def _confidence(fourth: np.ndarray) -> np.ndarray | None:
    """Confidence (frame, joint) from fourth numbers: the low byte is the residual, the high byte has a bit a camera."""
    measured = (fourth >= 0) & (fourth & 0xFF > 0)
    if not measured.any():
        return None
    cameras = np.bitwise_count(fourth >> 8 & 0x7F)
    seen = measured & (cameras > 0)
    usual = np.median(cameras[seen]) if seen.any() else 1.0
    trust = np.where(seen, np.minimum(1.0, (cameras / usual) ** 2), 1.0)
    return np.where(measured, trust, COMPUTED)


def _labels(layout: Layout) -> list[str]:
    """A name of its own for each point: its label, with its number where the label is blank or another's."""
    texts = _texts(layout, "LABELS")
    names: dict[str, None] = {}
    for column in range(layout.points):
        label = texts[column] if column < len(texts) else ""
        name = f"{label or 'point'} {column + 1}" if not label or label in names else label
        while name in names:
            name += "_"
        names[name] = None
    return list(names)


def _texts(layout: Layout, name: str) -> list[str]:
    """Texts of a parameter of POINT that goes on in a second one, a third, ..."""
    found, part = layout.texts("POINT", name), 2
    while more := layout.texts("POINT", f"{name}{part}"):
        found, part = found + more, part + 1
    return found
