"""The layout of a C3D file: what its header and parameters say, where its samples lie, and how they are replaced.

A file is blocks of 512 bytes. Block 1, the header, holds 16-bit words: 1 the block of the parameters and the key 50
hexadecimal, 2 points, 3 analog values a frame, 4 and 5 the first and last frame, 7-8 the scale as a float, 9 the block
of the data, 11-12 the frame rate as a float. The parameters begin with four bytes, the last of which tells the
processor and with it how numbers are coded; then come records, each with the distance to the next. In the data each
frame holds four numbers a point, then the analog values; all are floats where the scale is negative, else 16-bit
integers, to be multiplied by the scale. The fourth number of a point is negative where it was not measured, else its
low byte times the scale is the residual, and the high byte tells the cameras.

Nothing is allocated that the file is too small to hold, and nothing but the points is interpreted. ezc3d, the library
for the format, is the oracle of the tests and not used here: of 200 files with some bytes changed, ezc3d 1.7 crashed
the process on one and hung on another; it takes 14 to 27 times the size of a file in memory; it takes residual and
cameras for each other; and a file that it writes back has two more groups, other types and other descriptions.

Source: "The C3D file format: user guide", Motion Lab Systems, 2008.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

BLOCK = 512
KEY = 0x50
INTEL, DEC, SGI = 84, 85, 86
MOST = 65535
"""What a 16-bit word counts. Group TRIAL counts the frames of longer clips in two words, POINT:FRAMES in a float."""
_STARTS, _ENDS = ("TRIAL", "ACTUAL_START_FIELD"), ("TRIAL", "ACTUAL_END_FIELD")


@dataclass(frozen=True, eq=False)
class Layout:
    """A C3D file whose samples all lie inside it."""

    content: bytes
    processor: int
    parameters: dict[tuple[str, str], int]
    """Where the type, dimensions and values of each parameter begin, by group and name."""
    points: int
    frames: int
    words: int
    """Numbers a frame."""
    scale: float
    """Units of the file a step; negative where the samples are floats."""
    start: int
    """Byte of the first sample."""

    @property
    def rate(self) -> float:
        """Frames a second that the parameters state, or else the header; not checked."""
        header = _decode(self.content[20:24], 4, self.processor)
        return float(next(iter(self.numbers("POINT", "RATE")), header[0]))

    @property
    def in_floats(self) -> bool:
        """Whether samples are floats, not integers."""
        return self.scale < 0

    def numbers(self, group: str, name: str) -> np.ndarray:
        """Values (number,) of a parameter, integers unsigned; none where it is absent. Raises `ValueError` for text."""
        kind, _, at, count = self._found(group, name)
        if kind == -1 and count:
            raise ValueError(f"the parameter {group}:{name} holds text in place of numbers, the file is damaged")
        return _decode(self.content[at : at + abs(kind) * count], kind, self.processor)

    def texts(self, group: str, name: str) -> list[str]:
        """Values of a parameter without the blanks at their ends; none where it is absent or holds no text."""
        kind, dims, at, count = self._found(group, name)
        if kind != -1:
            return []
        width = dims[0] if dims else 1
        raw = [self.content[k : k + width] for k in range(at, at + count, width or 1)]
        return [_text(each) for each in raw]

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Points (frame, point, 3) in the file's unit (float64), and their fourth number (frame, point), -1 if none."""
        kind = 4 if self.in_floats else 2
        raw = self.content[self.start : self.start + self.frames * self.words * kind]
        values = _decode(raw, kind, self.processor).reshape(self.frames, self.words)[:, : 4 * self.points]
        values = values.reshape(self.frames, self.points, 4)
        if not self.in_floats:
            values = values.view(np.int16)
        with np.errstate(invalid="ignore"):
            points = values[..., :3].astype(np.float64) * (1.0 if self.in_floats else self.scale)
            # Not a number is no measurement either.
            fourth = np.where(values[..., 3] >= 0, values[..., 3], -1).clip(-1, 2**15 - 1).astype(np.int16)
        return points, fourth

    def written(self, points: np.ndarray, fourth: np.ndarray, changed: np.ndarray, kept: range) -> bytes:
        """The file with other points (frame, point, 3) and fourth numbers (frame, point), where changed (frame, point).

        The arrays are of the frames `kept`. Where these are not all, the header, POINT:FRAMES and group TRIAL count
        them, and what follows the samples stays in its place. Raises `ValueError` for points that the file's integers
        cannot hold, and for frames that cannot be left out.
        """
        kind = 4 if self.in_floats else 2
        stop = self.start + self.frames * self.words * kind
        values = np.frombuffer(self.content[self.start : stop], f"V{kind}").reshape(self.frames, self.words).copy()
        step = 1.0 if self.in_floats else self.scale
        numbers = np.concatenate([np.nan_to_num(points) / step, fourth[..., None]], -1)[changed]
        if not self.in_floats:
            numbers = np.rint(numbers)
            farthest = float(np.abs(numbers).max(initial=0))
            if farthest >= 2**15:
                raise ValueError(
                    f"received a coordinate of {step * farthest:.6g} for a C3D file in 16-bit integers, which ends at "
                    f"{step * (2**15 - 1):.6g}: write another format"
                )
        coded = np.frombuffer(_encode(numbers, kind, self.processor), f"V{kind}").reshape(-1, 4)
        own = values[kept.start : kept.stop, : 4 * self.points].reshape(*changed.shape, 4)
        own[changed] = coded
        values[kept.start : kept.stop, : 4 * self.points] = own.reshape(len(kept), -1)
        body = values[kept.start : kept.stop].tobytes()
        content = bytearray(self.content)
        content[self.start : stop] = body.ljust(stop - self.start, b"\0")
        if len(kept) != self.frames:
            self._count(content, kept)
        return bytes(content)

    def _count(self, content: bytearray, kept: range) -> None:
        """Put the numbers of the frames into the file."""
        if self.numbers("ROTATION", "USED").any():
            raise ValueError("received some of the frames of a C3D file with rotations: write all, or another format")

        def put(at: int, kind: int, values: Sequence[float]) -> None:
            content[at : at + len(values) * abs(kind)] = _encode(np.array(values, float), kind, self.processor)

        first = int(_decode(self.content[6:8], 2, self.processor)[0]) + kept.start
        put(6, 2, [min(first, MOST), min(first + len(kept) - 1, MOST)])
        kind, _, at, count = self._found("POINT", "FRAMES")
        if count:
            put(at, kind, [len(kept) if kind == 4 else min(len(kept), MOST)])
        starts, ends = self.numbers(*_STARTS), self.numbers(*_ENDS)
        if len(starts) == len(ends) == 2:
            first = int(starts @ (1, MOST + 1)) + kept.start
            for key, frame in ((_STARTS, first), (_ENDS, first + len(kept) - 1)):
                kind, _, at, _ = self._found(*key)
                put(at, kind, divmod(frame, MOST + 1)[::-1])

    def _found(self, group: str, name: str) -> tuple[int, list[int], int, int]:
        """Type (-1 text, 1, 2 or 4 bytes a number), dimensions, place and number of values of a parameter."""
        at = self.parameters.get((group, name))
        if at is None:
            return 1, [], 0, 0
        kind, axes = (int(number) for number in np.frombuffer(self.content[at : at + 2].ljust(2, b"\0"), np.int8))
        dims = list(self.content[at + 2 : at + 2 + axes]) if axes >= 0 else []
        place, count = at + 2 + len(dims), math.prod(dims)
        if kind not in (-1, 1, 2, 4) or len(dims) != axes or place + abs(kind) * count > len(self.content):
            raise ValueError(f"the parameter {group}:{name} at byte {at} does not fit into the file, it is damaged")
        return kind, dims, place, count


def layout_of(content: bytes) -> Layout:
    """The layout of a C3D file. Raises `ValueError` for what is no whole C3D file."""
    if len(content) < 2 * BLOCK or content[1] != KEY:
        raise ValueError("this is no C3D file, which has a header of 512 bytes of which the second is 50 hexadecimal")
    at = BLOCK * (content[0] - 1)
    processor = content[at + 3] if 0 < at < len(content) - 3 else 0
    if processor not in (INTEL, DEC, SGI):
        raise ValueError(
            f"the header puts the parameters into block {content[0]}, which does not begin as they do: "
            "the file is damaged"
        )

    words = _decode(content[:BLOCK], 2, processor)
    floats = _decode(content[:BLOCK], 4, processor)
    layout = Layout(content, processor, _records(content, at + 4, processor), int(words[1]), 0, 0, 0.0, 0)
    (points, analog, first, last), block = words[1:5].tolist(), int(words[8])
    used = layout.numbers("POINT", "USED")
    if len(used) and used[0] != points:
        raise ValueError(f"the header announces {points} points and POINT:USED {used[0]:g}: the file is damaged")
    scale = float(next(iter(layout.numbers("POINT", "SCALE")), floats[3]))
    if not math.isfinite(scale) or scale == 0:
        raise ValueError(f"the scale is {scale:g}, which makes nothing of the samples: the file is damaged")
    frames = last - first + 1
    if last == MOST or frames < 1:
        frames = _long(layout) or max(frames, 0)
    start, size = BLOCK * (block - 1), (4 * points + analog) * (4 if scale < 0 else 2)
    if points < 1 or frames < 1:
        raise ValueError(f"it holds {frames} frames of {points} points: there is nothing to read")
    if block < 2 or start + frames * size > len(content):
        whole = max(0, len(content) - start) // size if block > 1 else 0
        raise ValueError(
            f"the header announces {frames} frames of {size} bytes from block {block} on, of which the file holds "
            f"{whole}: get the whole file"
        )
    return Layout(content, processor, layout.parameters, points, frames, 4 * points + analog, scale, start)


def blank(labels: Sequence[str], frames: int, rate: float, facts: dict[str, str]) -> bytes:
    """A C3D file (Intel, floats) of points that were not measured; `facts` are further texts of group POINT.

    Raises `ValueError` for more labels, or longer ones, than parameters hold.
    """
    points, width = len(labels), max(len(label.encode()) for label in labels)
    if points > MOST or width > 255:
        raise ValueError(f"received {points} points with names of up to {width} bytes: C3D holds {MOST} and 255")
    # A count is one byte, and the distance to the next record a 16-bit word.
    most = min(255, 2**14 // max(1, width))
    named = {f"LABELS{k // most + 1 if k else ''}": labels[k : k + most] for k in range(0, points, most)}
    first, last = ([n % (MOST + 1), n // (MOST + 1)] for n in (1, frames))

    def parameters(block: int) -> bytes:
        counts = {"USED": points, "FRAMES": min(frames, MOST), "DATA_START": block}
        no_analog = {"USED": 0, "RATE": 0.0, "GEN_SCALE": 1.0, "SCALE": np.zeros(0), "OFFSET": np.zeros(0, int)}
        groups: dict[str, dict[str, Any]] = {
            "TRIAL": {_STARTS[1]: np.array(first), _ENDS[1]: np.array(last)},
            "POINT": {
                **counts,
                "SCALE": -1.0,
                "RATE": float(rate),
                **{name: [text] for name, text in facts.items()},
                **named,
            },
            "ANALOG": {**no_analog, "LABELS": [], "UNITS": []},
            "FORCE_PLATFORM": {"USED": 0, "TYPE": np.zeros(0, int), "ZERO": np.array([1, 0])},
        }
        records = b""
        for number, (group, values) in enumerate(groups.items(), 1):
            records += _record(group, -number, b"")
            records += b"".join(_record(name, number, _stored(value)) for name, value in values.items())
        return records + bytes(2)

    blocks = -(-(len(parameters(0)) + 4) // BLOCK)
    if blocks > 255:
        raise ValueError(f"received {points} points, whose names are too long for a C3D file: shorten them")
    header = bytearray(BLOCK)
    header[:12] = bytes([2, KEY]) + np.array([points, 0, 1, min(frames, MOST), 0], "<u2").tobytes()
    header[12:24] = np.array([-1.0, 0.0, rate], "<f4").tobytes()
    header[16:18] = np.array(2 + blocks, "<u2").tobytes()
    # Not filled up to a block: of clips too long for the header ezc3d reads as many frames as there are bytes.
    missing = np.tile(np.array([0, 0, 0, -1], "<f4"), (frames * points, 1)).tobytes()
    return (
        bytes(header) + (bytes([1, KEY, blocks, INTEL]) + parameters(2 + blocks)).ljust(blocks * BLOCK, b"\0") + missing
    )


def _long(layout: Layout) -> int:
    """Frames of a clip that is too long for the header."""
    starts, ends = layout.numbers(*_STARTS), layout.numbers(*_ENDS)
    if len(starts) == len(ends) == 2:
        return int(ends @ (1, MOST + 1)) - int(starts @ (1, MOST + 1)) + 1
    frames = next(iter(layout.numbers("POINT", "FRAMES")), 0)
    return int(frames) if math.isfinite(frames) else 0


def _records(content: bytes, at: int, processor: int) -> dict[tuple[str, str], int]:
    """Where each parameter's type begins, by group and name in capitals."""
    groups: dict[int, str] = {}
    found: list[tuple[int, str, int]] = []
    while at + 4 <= len(content) and content[at]:
        length, number = (int(each) for each in np.frombuffer(content[at : at + 2], np.int8))
        name = _text(content[at + 2 : at + 2 + abs(length)]).upper()
        place = at + 2 + abs(length)
        if place + 2 > len(content):
            raise ValueError(f"the parameters are cut off at byte {at}: get the whole file")
        if number < 0:
            groups[-number] = name
        else:
            found.append((number, name, place + 2))
        step = int(_decode(content[place : place + 2], 2, processor)[0])
        if step == 0:
            break
        at = place + max(step, 2)
    return {(groups[number], name): place for number, name, place in found if number in groups}


def _record(name: str, number: int, body: bytes) -> bytes:
    """A group or parameter without a description."""
    raw = name.encode()
    return bytes([len(raw), number % 256]) + raw + np.array(len(body) + 3, "<u2").tobytes() + body + b"\0"


def _stored(value: Any) -> bytes:
    """Type, dimensions and values of a parameter: a number, an array of numbers, or a list of texts."""
    if isinstance(value, list | tuple):
        raw = [text.encode() for text in value]
        width = max(map(len, raw), default=0)
        return bytes([255, 2, width, len(raw)]) + b"".join(text.ljust(width) for text in raw)
    value = np.asarray(value)
    kind = 4 if value.dtype.kind == "f" else 2
    return bytes([kind, value.ndim, *value.shape]) + _encode(value, kind, INTEL)


def _text(raw: bytes) -> str:
    """Text of older files is Latin-1, of newer ones UTF-8."""
    raw = raw.split(b"\0")[0]
    try:
        return raw.decode("utf-8").strip()
    except UnicodeDecodeError:
        return raw.decode("latin-1").strip()


def _decode(raw: bytes, kind: int, processor: int) -> np.ndarray:
    """Numbers of 1 or 2 bytes, unsigned, or floats of 4. DEC's are 4 times IEEE's, with the two halves swapped."""
    order = ">" if processor == SGI else "<"
    if kind == 4 and processor == DEC:
        halves = np.frombuffer(raw, "<u2").reshape(-1, 2)
        return halves[:, ::-1].copy().view("<f4").ravel() / np.float32(4)
    return np.frombuffer(raw, {1: "u1", 2: f"{order}u2", 4: f"{order}f4"}[abs(kind)]).astype(
        {1: np.uint8, 2: np.uint16, 4: np.float32}[abs(kind)], copy=False
    )


def _encode(values: np.ndarray, kind: int, processor: int) -> bytes:
    """The inverse of `_decode`; integers below 0 become the complement."""
    order = ">" if processor == SGI else "<"
    if kind == 4 and processor == DEC:
        halves = (4 * values).astype("<f4").view("<u2").reshape(-1, 2)
        return halves[:, ::-1].tobytes()
    if kind == 4:
        return values.astype(f"{order}f4").tobytes()
    return values.astype(np.int64).astype({1: "u1", 2: f"{order}u2"}[abs(kind)]).tobytes()
