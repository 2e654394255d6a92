"""Kinect v2 CSV: a line a frame, without a header: the time in 100 ns, then x, y, z and tracking state of 25 joints.

Joints are in the order of the SDK's JointType, metres in the axes of the camera: y is up where the camera is level. A
tracked sample (state 2) has a confidence of 1, an inferred one (1) of `INFERRED`; one that is not tracked (0) is
missing. The sensor drops frames: lines go to the frames that their times say, and frames without a line are missing.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from motionrecover.io.bones import skeleton_for
from motionrecover.io.border import Asked, Lines, counted, finite, motion_from, read_lines, refuse_swollen, shown
from motionrecover.io.errors import MotionFormatError
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

INFERRED = 0.3
"""Confidence of an inferred sample."""
TICKS = 1e7
"""Of the clock, in a second."""
SLOWEST, FASTEST = 5, 60
"""Frames a second. The sensor has 30, and 15 in the dark: other rates come from another clock."""
JOINTS = Skeleton.standard("kinect25").names
COLUMNS = 1 + 4 * len(JOINTS)
STATES = ("0", "1", "2")


def fits(path: Path) -> bool:
    """Whether a file begins with a line of such a table."""
    try:
        with path.open("rb") as file:
            cells = _cells(file.readline(100 * COLUMNS).decode("utf-8-sig", "replace"))
    except OSError:
        return False
    return len(cells) == COLUMNS and finite(cells[0]) is not None and set(cells[4::4]) <= set(STATES)


def read(path: Path, asked: Asked) -> Motion:
    """Motion of a Kinect v2 recording, a frame for each period of its clock.

    The rate is that of the times, to a tenth of a frame: they wobble by 1 ms. Raises `MotionFormatError` for lines of
    another length, numbers that are none, unknown states, and times that do not increase or are of another clock.
    """
    lines = read_lines(path)
    values = _values(path, lines)
    frames, rate = _clock(path, lines, values[:, 0], asked.fps)
    refuse_swollen(path, len(lines.content), frames[-1] + 1, len(JOINTS))
    samples = values[:, 1:].reshape(len(values), -1, 4)
    states = samples[..., 3]
    observed = np.isfinite(samples[..., :3]).all(-1) & (states > 0)
    positions = np.full((frames[-1] + 1, len(JOINTS), 3), np.nan)
    positions[frames] = np.where(observed[..., None], samples[..., :3], np.nan)
    confidence = np.zeros(positions.shape[:2])
    confidence[frames] = np.select([observed & (states == 2), observed], [1.0, INFERRED])
    skeleton, order, note = skeleton_for(path, JOINTS, None, asked.skeleton, positions)
    dropped = len(positions) - len(values)
    return motion_from(
        positions,
        skeleton,
        fps=rate,
        unit=asked.unit or 1.0,
        up=asked.up or "y",
        history=(
            f"read {path.name} (Kinect v2): {counted(len(positions), 'frame')}, {dropped} of them dropped by the "
            f"sensor, {np.mean(confidence == INFERRED):.1%} of the samples inferred and of confidence {INFERRED}; "
            f"{note}",
        ),
        order=order,
        confidence=confidence,
    )


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().rstrip(",").split(",")]


def _filled(lines: Lines) -> Iterator[tuple[int, str]]:
    return ((number, line) for number, line in enumerate(lines, 1) if line.strip())


def _values(path: Path, lines: Lines) -> np.ndarray:
    """The cells (line, column) as float64; coordinates of joints that are not tracked may be NaN or infinite."""
    values = np.empty((sum(1 for _ in _filled(lines)), COLUMNS))
    for k, (number, line) in enumerate(_filled(lines)):
        cells = _cells(line)
        if len(cells) != COLUMNS:
            raise MotionFormatError(
                f"{path}, line {number}: received {counted(len(cells), 'number')}, a line of Kinect v2 has {COLUMNS}: "
                "a time, and x, y, z and state of 25 joints"
            )
        if not set(cells[4::4]) <= set(STATES):
            state = next(cell for cell in cells[4::4] if cell not in STATES)
            raise MotionFormatError(
                f"{path}, line {number}: received the tracking state {shown(state)}, write 0 (not tracked), "
                "1 (inferred) or 2 (tracked)"
            )
        for column, cell in enumerate(cells):
            try:
                values[k, column] = cell
            except ValueError as error:
                raise MotionFormatError(f"{path}, line {number}: received {shown(cell)}, write a number") from error
    return values


def _clock(path: Path, lines: Lines, times: np.ndarray, asked: float | None) -> tuple[np.ndarray, float]:
    """Frame (line,) of each line, from 0, and frames a second."""
    if len(times) == 1:
        if asked is None:
            raise MotionFormatError(f"{path} has one line, which tells no frame rate: give fps= (--fps)")
        return np.zeros(1, int), asked
    steps = np.diff(times)
    for late in np.flatnonzero(~(steps > 0))[:1]:
        number, _ = next(itertools.islice(_filled(lines), int(late) + 1, None))
        raise MotionFormatError(
            f"{path}, line {number}: received the time {times[late + 1]:.0f} after {times[late]:.0f}, "
            "put the lines in order of their times"
        )
    counts = np.maximum(np.round(steps / np.median(steps)), 1)
    rate = asked or round(counts.sum() * TICKS / (times[-1] - times[0]), 1)
    if asked is None and not SLOWEST <= rate <= FASTEST:
        raise MotionFormatError(
            f"{path} has lines {np.median(steps):.0f} apart, which is no rate of a Kinect in units of 100 ns: "
            "give fps= (--fps)"
        )
    if counts.sum() > 10 * len(times):
        raise MotionFormatError(
            f"{path} has {len(times)} lines over {counts.sum() + 1:.0f} frames: cut it where the recording stopped"
        )
    return np.concatenate([[0], np.cumsum(counts)]).astype(int), rate
