"""The border between files and `Motion`: what the caller asked for, text in, metres and y up out."""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motionrecover.io.errors import MotionFormatError, MotionFormatWarning
from motionrecover.motion import FASTEST, SLOWEST, UNITS, UP_AXES, Motion
from motionrecover.skeleton import Skeleton
from motionrecover.source import Source

SMALLEST, LARGEST = 1e-9, 1e9
"""Metres in one unit."""
MOST = 1e30
"""A number in a text; larger ones overflow on the way to positions."""
LONGEST_NAME = 1000
PLAIN = f"printable names of up to {LONGEST_NAME} characters without spaces around them"
"""Which names a line of text takes."""
SWOLLEN, SMALL, JOINT = 6, 100_000, 200
"""Positions may take so many times the bytes of their file, or of a small one, and each joint so many more bytes: with
what leads to them, loading takes up to 20 times the file."""


@dataclass(frozen=True)
class Asked:
    """What the caller says about a file; it goes before what the file says, and None leaves it to the file."""

    skeleton: Skeleton | str | Path | None = None
    """A skeleton, the name of a standard, "infer", or the path of a skeleton file (TOML; ASF for AMC)."""
    unit: float | None = None
    """Metres in one unit of the file."""
    up: str | None = None
    """Axis of the file that points up: x, y or z."""
    fps: float | None = None
    """Frames a second."""


def metres_in(unit: str | float) -> float:
    """Metres in one `unit`: a name of `UNITS` or a positive number, also as text. Raises `ValueError` for others."""
    if isinstance(unit, str) and unit.strip() in UNITS:
        return UNITS[unit.strip()]
    try:
        metres = float(unit)
    except (TypeError, ValueError):
        metres = math.nan
    if not SMALLEST <= metres <= LARGEST:
        raise ValueError(f"received unit {unit!r}: give {', '.join(UNITS)} or the metres in one unit, above 0")
    return metres


def unit_spelled(text: str) -> float | None:
    """Metres in the unit that a file spells, as mm, MM or millimeters; None for none of `UNITS`."""
    word = text.strip().lower()
    match = re.fullmatch(r"(milli|centi|)met(?:er|re)s?", word)
    return UNITS.get({"milli": "mm", "centi": "cm", "": "m"}[match[1]] if match else word)


def up_axis(up: str) -> str:
    """`up` as x, y or z. Raises `ValueError` for anything else."""
    if str(up).strip().lower() not in UP_AXES:
        raise ValueError(f"received up axis {up!r}: give one of {', '.join(UP_AXES)}")
    return str(up).strip().lower()


def frame_rate(fps: str | float) -> float:
    """`fps` as a positive number. Raises `ValueError` for anything else."""
    rate = finite(fps)
    if rate is None or not SLOWEST <= rate <= FASTEST:
        raise ValueError(f"received a frame rate of {fps!r}: give frames a second, above 0 and up to {FASTEST:,.0f}")
    return rate


def finite(text: str | float) -> float | None:
    """The number that `text` writes, None where it writes none, an infinite one or one beyond `MOST`."""
    try:
        number = float(text)
    except (TypeError, ValueError):
        return None
    # float() reads the underscores of Python source; no motion file has them.
    return number if abs(number) <= MOST and "_" not in str(text) else None


def shown(text: str) -> str:
    """`text` quoted and short enough for a message."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def plain(name: str) -> bool:
    """Whether a line of text can hold `name` among others, as `PLAIN` says."""
    return 0 < len(name) <= LONGEST_NAME and name == name.strip() and name.isprintable()


def counted(number: int, noun: str) -> str:
    """`1 frame`, `2 frames`: for messages."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def assume(sentence: str, deeper: int = 0) -> str:
    """Say aloud what was assumed, on behalf of the reader that calls this; returned for the history."""
    # This function, the reader and `load` lie between the warning and the line that asked for the file, and `deeper`
    # functions that the reader calls.
    warnings.warn(sentence, MotionFormatWarning, stacklevel=4 + deeper)
    return sentence


def read_bytes(path: Path) -> bytes:
    """Contents of a file. Raises `MotionFormatError` when it cannot be read or is empty."""
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise MotionFormatError(f"{path} does not exist: check the name and the folder") from error
    except OSError as error:
        raise MotionFormatError(f"{path} cannot be read: {error.strerror}") from error
    if not content.strip():
        raise MotionFormatError(f"{path} is empty: copy or export it again")
    return content


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of a text file, decoded one by one: a string each takes 20 times the memory of short lines."""

    content: bytes
    """UTF-8, with line feeds only."""

    def __iter__(self) -> Iterator[str]:
        for line in io.BytesIO(self.content):
            yield line.removesuffix(b"\n").decode()
        if self.content.endswith(b"\n"):
            yield ""

    def __len__(self) -> int:
        return self.content.count(b"\n") + 1


def read_lines(path: Path) -> Lines:
    """Lines of a UTF-8 text file. Raises `MotionFormatError` when it is unreadable, empty or not text."""
    content = read_bytes(path).removeprefix(b"\xef\xbb\xbf")
    wrong = content.find(b"\0")
    try:
        content.decode()
    except UnicodeDecodeError as error:
        wrong = error.start
    if wrong >= 0:
        line = content.count(b"\n", 0, wrong) + 1
        raise MotionFormatError(f"{path}, line {line}: received bytes that are not UTF-8 text, export it as text")
    return Lines(content.replace(b"\r\n", b"\n").replace(b"\r", b"\n"))


def refuse_swollen(path: Path, size: int, frames: int, joints: int) -> None:
    """Raise `MotionFormatError` where a file of `size` bytes holds next to nothing of so many samples.

    A sample takes 24 bytes of memory, and seldom less than 6 of a file.
    """
    needed = joints * (24 * frames + JOINT)
    if needed > SWOLLEN * max(size, SMALL):
        raise MotionFormatError(
            f"{path} has {counted(joints, 'joint')} in {counted(frames, 'frame')}, which take {needed / size:.0f} "
            "times its size in memory: leave out what was hardly measured, or cut it where the recording stopped"
        )


# Right-handed rotations that take the file's up axis to y: x' = ..., y' = up, z' = ... as (axes, signs).
_TO_Y_UP = {"x": ([1, 0, 2], [-1, 1, 1]), "y": ([0, 1, 2], [1, 1, 1]), "z": ([0, 2, 1], [1, 1, -1])}


def to_metres(vectors: np.ndarray, unit: float, up: str) -> np.ndarray:
    """Vectors (..., 3) of a file in metres with y up, in their own dtype.

    The turn keeps handedness: z up goes (x, y, z) -> (x, z, -y), x up goes (x, y, z) -> (-y, x, z).
    """
    axes, signs = _TO_Y_UP[up]
    out = vectors[..., axes]
    out = out if out.dtype.kind == "f" else out.astype(np.float64)
    # What gets infinite by it is refused by `Motion`; a signalling NaN is one, too.
    with np.errstate(over="ignore", invalid="ignore"):
        out *= np.asarray(signs, out.dtype) * out.dtype.type(unit)
    return out


def from_metres(vectors: np.ndarray, unit: float, up: str) -> np.ndarray:
    """Vectors (..., 3) in metres with y up as the file has them: the inverse of `to_metres`."""
    axes, signs = _TO_Y_UP[up]
    out = np.empty_like(vectors)
    out[..., axes] = vectors * np.asarray(signs, vectors.dtype) / unit
    return out


def motion_from(
    positions: np.ndarray,
    skeleton: Skeleton,
    *,
    fps: float,
    unit: float,
    up: str,
    history: tuple[str, ...],
    order: Sequence[int] | None = None,
    observed: np.ndarray | None = None,
    confidence: np.ndarray | None = None,
) -> Motion:
    """`Motion` of positions (frame, joint, 3) and a skeleton that are both still in the file's unit and axes.

    `order` holds the column of each joint in positions, observed and confidence, where these are in the file's order.
    """
    if order is not None and list(order) != list(range(positions.shape[1])):
        positions = positions[:, order]
        observed, confidence = (None if each is None else each[:, order] for each in (observed, confidence))
    if skeleton.rest_offsets is not None:
        offsets = to_metres(np.asarray(skeleton.rest_offsets), unit, up)
        skeleton = Skeleton(skeleton.names, skeleton.edges, offsets)
    masks: dict[str, Any] = {} if observed is None else {"observed": observed}
    metres = to_metres(positions, unit, up)
    return Motion(metres, skeleton, fps, confidence=confidence, unit=unit, up=up, history=history, **masks)


def source_of(motion: Motion, format: str) -> Source | None:
    """The file of this format that a motion came from, None where there is none.

    Raises `MotionFormatError` where the motion has other frames than were kept of the file.
    """
    source = motion.source
    if source is None or source.format != format:
        return None
    if len(source.kept) != len(motion) or source.kept.step != 1:
        raise MotionFormatError(
            f"received {counted(len(motion), 'frame')} with a {format.upper()} file of which "
            f"{counted(len(source.kept), 'frame')} are kept: cut both, with source=motion.source.frames(...), at the "
            "ends only, or leave the file out with source=None"
        )
    return source


def parents_of(skeleton: Skeleton) -> tuple[int, ...] | None:
    """Parents that rebuild exactly this skeleton, None where only its list of bones does."""
    try:
        parents = skeleton.parents
    except ValueError:
        return None
    return parents if Skeleton.from_parents(skeleton.names, parents).edges == skeleton.edges else None
