"""Reading BVH (Biovision hierarchy): a skeleton of offsets, then one row of channels a frame.

Joints keep their file order; each end site becomes a joint, `LeftToeBase_end`. A position channel takes the place of
that component of the joint's OFFSET, on the root as on any joint, as in Blender's importer and pybvh. Rotations are
degrees, multiplied in the order of the channels. Rest offsets are the OFFSETs. Bones join children and parents, but for
those that `_carried` finds.

Rotations are pybvh's. Its parser is not used: pybvh 0.9 refuses joints without exactly three rotation channels,
position channels on joints, roots without position and reordered root positions, takes infinite numbers and unclosed
blocks without a word, and gives no line numbers for the rows.

Source: M. Meredith, S. Maddock, "Motion capture file formats explained", 2001.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from motionrecover.io.border import (
    MOST,
    Asked,
    Lines,
    assume,
    counted,
    finite,
    motion_from,
    read_lines,
    refuse_swollen,
    shown,
)
from motionrecover.io.errors import MotionFormatError
from motionrecover.io.kinematics import blocks, euler_rotations, forward
from motionrecover.motion import FASTEST, SLOWEST, UNITS, Motion
from motionrecover.rig import Rig
from motionrecover.skeleton import Skeleton

PERSON = 1.7
"""Metres that the largest extent of a person's rest pose is expected to be near: height or arm span."""

UNIT_GUESSES = {name: UNITS[name] for name in ("m", "cm", "mm", "in")} | {"CMU's 1/0.45 in": 0.0254 / 0.45}
"""Units that BVH files are written in; the last is that of the CMU database and its cgspeed conversion."""

CARRIES = 0.01
"""Metres by which what a root carries must move in it, outliers aside: hips bob by 3 cm and more above a root that
walks along on the floor."""

_Fail = Callable[[str], NoReturn]

_HEADER = re.compile(r"\s*(Frames|Frame\s+Time)\s*:\s*(.*?)\s*$", re.IGNORECASE)
_CHANNEL = re.compile(r"([XYZ])(position|rotation)$", re.IGNORECASE)


@dataclass
class _Joint:
    name: str
    parent: int
    line: int
    end: bool
    offset: list[float] | None = None
    channels: list[tuple[str, int]] = field(default_factory=list)
    """(position or rotation, axis) for each column of the joint."""


def read(path: Path, asked: Asked) -> Motion:
    """Motion of a BVH file, every joint and end site in global positions (float64).

    BVH states neither unit nor up axis. Unless asked for, the unit is the one of `UNIT_GUESSES` that brings the
    largest extent of the rest pose nearest to `PERSON`, and up is y, or z where `_up` finds it; both go to the
    history, and the unit and z up are warned about (`MotionFormatWarning`).

    Raises `MotionFormatError` for a file that is not a whole BVH file, `ValueError` when asked for a skeleton.
    """
    if asked.skeleton is not None:
        raise ValueError("received a skeleton for a BVH file, which brings its own: leave skeleton= (--skeleton) out")
    lines = read_lines(path)
    joints, start = _hierarchy(path, lines)
    values, fps, frame_time, timing = _motion(path, lines, start, joints, asked)
    del lines

    parents = [joint.parent for joint in joints]
    offsets = np.array([joint.offset for joint in joints])
    rig = Rig(
        names=tuple(joint.name for joint in joints),
        parents=tuple(parents),
        offsets=offsets.copy(),
        channels=tuple(tuple(joint.channels) for joint in joints),
        ends=tuple(joint.end for joint in joints),
        values=values,
        frame_time=frame_time,
        unit=1.0,
        up="y",
    )
    positions = np.empty((len(values), len(joints), 3))
    for block in blocks(*positions.shape[:2]):
        translations, angles = rig.frames(block).split()
        positions[block] = forward(parents, translations, euler_rotations(angles, rig.orders))[0]

    offsets[[parent == -1 for parent in parents]] = 0.0
    rest = forward(parents, offsets[None], np.broadcast_to(np.eye(3), (1, len(joints), 3, 3)))[0]
    history = [f"read {path.name} (BVH): {counted(len(values), 'frame')}, {counted(len(joints), 'joint')}", timing]
    up = asked.up or _up(rest, positions)
    if asked.up is None:
        sentence = f"{path.name} states no up axis: assumed {up}, override with up= (--up)"
        history.append(sentence if up == "y" else assume(f"{sentence}, for its poses are tall along {up}"))
    unit = asked.unit
    if unit is None:
        name, unit = _unit(path, rest)
        history.append(
            assume(
                f"{path.name} states no unit: assumed {name} ({unit:.6g} m), for that makes the largest extent of its "
                f"rest pose {unit * _extents(rest).max():.2f} m, override with unit= (--unit)"
            )
        )
    carried = _carried(rig, unit)
    if carried:
        offsets[carried] = 0.0
        history.append(f"no bone leads to {', '.join(rig.names[joint] for joint in carried)}, which the root carries")
    skeleton = Skeleton.from_parents(rig.names, [-1 if j in carried else p for j, p in enumerate(parents)], offsets)
    motion = motion_from(positions, skeleton, fps=fps, unit=unit, up=up, history=tuple(history))
    return replace(motion, rig=replace(rig, unit=unit, up=up))


def _carried(rig: Rig, unit: float) -> list[int]:
    """Joints without a bone to their parent: the only child of a root, or of such children, that moves in it.

    Characters of game engines have a root on the floor that carries the hips by their position channels. Taken for a
    bone it puts the joints of a walk 35 mm off in the mean, and the rotations by as much as a metre.
    """
    children, chain, found = Counter(rig.parents), set(), []
    column = 0
    for joint, (parent, channels) in enumerate(zip(rig.parents, rig.channels, strict=True)):
        places = [column + k for k, (kind, _) in enumerate(channels) if kind == "position"]
        column += len(channels)
        if parent == -1 or (parent in chain and children[parent] == 1):
            chain.add(joint)
            if parent != -1 and places:
                first, last = np.percentile(unit * rig.values[:, places], [5, 95], axis=0)
                if (last - first).max() > CARRIES:
                    found.append(joint)
    return found


def _hierarchy(path: Path, lines: Lines) -> tuple[list[_Joint], int]:
    """Joints in file order, and the number of the line that says MOTION."""
    joints: list[_Joint] = []
    names: Counter[str] = Counter()
    open_blocks: list[int] = []
    awaits_block = False

    def fail(what: str) -> NoReturn:
        raise MotionFormatError(f"{path}, line {number}: {what}")

    number = 0
    for number, line in enumerate(lines, 1):
        if line.strip().upper() == "MOTION":
            break
        for part in re.split(r"([{}])", line):
            if not part.strip():
                continue
            key, *words = part.split()
            if awaits_block and key != "{":
                fail(f"received {shown(key)} where the block of {joints[-1].name!r} should begin, put a '{{' before it")
            match key.upper():
                case "HIERARCHY":
                    pass
                case "ROOT" | "JOINT" | "END":
                    joints.append(_declared(key.upper(), words, number, joints, names, open_blocks, fail))
                    awaits_block = True
                case "{":
                    if not awaits_block:
                        fail("received '{' without a ROOT, JOINT or End Site before it, remove it")
                    open_blocks.append(len(joints) - 1)
                    awaits_block = False
                case "}":
                    if not open_blocks:
                        fail("received '}' with no block open, remove it")
                    joint = joints[open_blocks.pop()]
                    if joint.offset is None:
                        fail(f"the block of {joint.name!r} (line {joint.line}) ends without an OFFSET, add it")
                case "OFFSET" if open_blocks:
                    offset = [value for value in map(finite, words) if value is not None]
                    if not len(offset) == len(words) == 3:
                        fail(f"received OFFSET {shown(' '.join(words))}, give three finite numbers")
                    joints[open_blocks[-1]].offset = offset
                case "CHANNELS" if open_blocks:
                    joints[open_blocks[-1]].channels = _channels(words, fail)
                case _:
                    fail(
                        f"received {shown(key)}, which has no place here in a BVH hierarchy: check that the file is BVH"
                    )
    else:
        where = f"inside the block of {joints[open_blocks[-1]].name!r}" if open_blocks else "before the line MOTION"
        fail(f"the file ends {where}, it was cut off: get the whole file")
    if open_blocks or awaits_block or not joints:
        what = f"inside the block of {joints[-1].name!r}" if joints else "before any ROOT"
        fail(f"MOTION begins {what}, the hierarchy was cut off: get the whole file")
    return joints, number


def _declared(
    key: str,
    words: list[str],
    number: int,
    joints: list[_Joint],
    names: Counter[str],
    open_blocks: list[int],
    fail: _Fail,
) -> _Joint:
    """The joint that a line ROOT, JOINT or End Site declares in the innermost open block."""
    parent = open_blocks[-1] if open_blocks else -1
    if (key == "ROOT") != (parent == -1):
        fail(f"received {key} {'outside of every' if parent == -1 else 'inside a'} ROOT, the braces do not match")
    name = " ".join(words)
    if key == "END":
        name = base = f"{joints[parent].name}_end"
        while name in names:
            names[base] += 1  # so that many end sites of a joint are not counted over and over
            name = f"{base}{names[base]}"
    if not name or name in names:
        fail(f"received joint name {name!r} {'again' if name else ''}, give every joint a name of its own")
    names[name] += 1
    return _Joint(name, parent, number, key == "END")


def _channels(words: list[str], fail: _Fail) -> list[tuple[str, int]]:
    """(kind, axis) of the words after CHANNELS: their count, then their names."""
    if not words or words[0] != str(len(words) - 1):
        fail(f"received CHANNELS {shown(' '.join(words))}, give the number of channels and then that many names")
    found = [_CHANNEL.match(word) for word in words[1:]]
    channels = [(match[2].lower(), "XYZ".index(match[1].upper())) for match in found if match]
    if len(channels) != len(found) or len(set(channels)) != len(channels):
        fail(f"received the channels {shown(' '.join(words[1:]))}, name each of Xposition ... Zrotation once at most")
    return channels


def _motion(
    path: Path, lines: Lines, start: int, joints: list[_Joint], asked: Asked
) -> tuple[np.ndarray, float, float, str]:
    """Values (frame, channel), frames a second, the frame time, and a line of history about the frame rate."""
    columns = sum(len(joint.channels) for joint in joints)
    header: dict[str, tuple[int, str]] = {}
    begin, count = 0, 0
    for number, line in enumerate(itertools.islice(lines, start, None), start + 1):
        match = None if begin else _HEADER.match(line)
        if match:
            header[match[1].lower().split()[-1]] = (number, match[2])
        elif line.strip():
            begin, count = begin or number, count + 1

    def rows() -> Iterator[tuple[int, str]]:
        numbered = enumerate(itertools.islice(lines, begin - 1, None), begin)
        return ((number, line) for number, line in numbered if line.strip())

    if asked.fps is not None:
        fps, seconds, timing = asked.fps, 1 / asked.fps, f"took the frame rate asked for, {asked.fps:g}"
    elif "time" not in header:
        raise MotionFormatError(f"{path}, line {start}: no 'Frame Time:' follows MOTION, give fps= (--fps)")
    else:
        number, text = header["time"]
        seconds = finite(text)
        if seconds is None or not 1 / FASTEST <= seconds <= 1 / SLOWEST:
            raise MotionFormatError(
                f"{path}, line {number}: received Frame Time {shown(text)}, write seconds above 0 or give fps= (--fps)"
            )
        fps = 1 / seconds
        # Frame times are printed short: .0083333 s means 120 a second, while 23.976 stays as it is.
        if math.isclose(fps, round(fps), rel_tol=1e-4):
            fps = float(round(fps))
        timing = f"took {fps:.6g} frames a second from the frame time {text} s"

    if "frames" not in header:
        raise MotionFormatError(f"{path}, line {start}: no 'Frames:' follows MOTION, add it with the number of rows")
    if not count or not columns:
        what = "the file ends before the first frame" if columns else "the hierarchy declares no channels"
        raise MotionFormatError(f"{path}, line {start}: {what}, get the whole file")
    refuse_swollen(path, len(lines.content), count, len(joints))
    try:
        values = np.loadtxt((line for _, line in rows()), comments=None, ndmin=2)
    except ValueError:
        _blame(path, rows(), columns)
    if values.shape[1] != columns or not (np.abs(values) <= MOST).all():
        _blame(path, rows(), columns)
    number, text = header["frames"]
    if text != str(count):
        raise MotionFormatError(
            f"{path}, line {number}: received Frames: {shown(text)} and {counted(count, 'row')} of numbers, "
            "get the whole file or correct the number"
        )
    return values, fps, seconds, timing


def _blame(path: Path, rows: Iterator[tuple[int, str]], columns: int) -> NoReturn:
    """Raise about the first row that is not `columns` finite numbers."""
    for number, line in rows:
        words = line.split()
        wrong = next((word for word in words if finite(word) is None), None)
        if wrong is not None:
            raise MotionFormatError(f"{path}, line {number}: received {shown(wrong)}, write a finite number")
        if len(words) != columns:
            raise MotionFormatError(
                f"{path}, line {number}: received {counted(len(words), 'number')} for {counted(columns, 'channel')}, "
                "the row was cut off or the hierarchy is another file's"
            )
    raise MotionFormatError(f"{path}: the rows are not plain numbers, export the file again")


def _extents(poses: np.ndarray) -> np.ndarray:
    """Extent along x, y, z (3,) of poses (frame, joint, 3): the median over frames."""
    return np.median(np.ptp(poses, axis=1), axis=0)


def _up(rest: np.ndarray, positions: np.ndarray) -> str:
    """Y, the habit of the format, or z where rest pose and recorded poses are both over twice as tall along z.

    One of the two alone misleads: a person who lies is long along z, and some rest poses are laid out flat.
    """
    tall = all(extents[2] > 2 * extents[1] for extents in (_extents(rest), _extents(positions)))
    return "z" if tall else "y"


def _unit(path: Path, rest: np.ndarray) -> tuple[str, float]:
    """Name and metres of the unit that makes the rest pose a person."""
    size = _extents(rest).max()
    if size == 0:
        raise MotionFormatError(
            f"{path} has a rest pose without extent, from which no unit follows: give unit= (--unit)"
        )
    return min(UNIT_GUESSES.items(), key=lambda item: abs(math.log(item[1] * size / PERSON)))
