"""Acclaim ASF + AMC, read only: a skeleton file of bones, and a motion file of rotations a frame.

A joint is named after the bone that ENDS in it, `root` comes first, and the others follow the hierarchy depth first,
which for CMU's files is the standard `cmu31`. A bone with axis rotation C, motion M and offset d (direction times
length, in the rest pose) turns by C M C^-1 relative to its parent, and ends at p_parent + R d. Rotations are applied
in the order in which `axis` and `dof` list them.

Source: J. Lander, "Working with motion capture file formats", Game Developer, January 1998; CMU's files.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motionrecover.io.border import (
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
from motionrecover.motion import UNITS, Motion
from motionrecover.skeleton import Skeleton

CMU_FPS = 120.0
"""Frames a second of the CMU database, where nearly all AMC files come from."""


@dataclass(frozen=True)
class _Bone:
    name: str
    offset: Sequence[float]
    """From the bone's start to its end in the rest pose, in the file's unit."""
    axis: Sequence[float]
    """Three angles of the bone's own axes, in degrees, in the order of `axis_order`."""
    axis_order: str
    dof: Sequence[str]
    """The columns of the bone in the AMC file, such as rx, rz; tx to tz on the root."""


@dataclass(frozen=True)
class _Asf:
    bones: list[_Bone]
    """The root, then the bones depth first."""
    parents: list[int]
    length: float | None
    """The file's `length` unit: 1/length inch is one unit."""
    degrees: bool


def read(path: Path, asked: Asked) -> Motion:
    """Motion of an AMC file on the skeleton of an ASF file: bone ends in global positions (float64).

    The skeleton is `asked.skeleton`, the path of an ASF file, or the only ASF file in the folder. The ASF file states
    the unit, as `length`. Neither file states the frame rate: unless asked for it is `CMU_FPS`, with a
    `MotionFormatWarning`. Nor do they state the up axis: unless asked for it is y, the habit of the format.

    Raises `MotionFormatError` for files that are not whole or do not belong together.
    """
    if path.suffix.lower() == ".asf":
        raise MotionFormatError(f"{path} holds a skeleton without motion: load the .amc file that belongs to it")
    lines = read_lines(path)
    asf_path = _skeleton_path(path, asked)
    asf = _read_asf(asf_path)
    values, degrees = _read_amc(path, lines, asf)
    if asked.unit is None and asf.length is None:
        raise MotionFormatError(f"{asf_path} states no length under :units, give unit= (--unit)")
    unit = asked.unit or UNITS["in"] / (asf.length or 1.0)

    count = len(asf.bones)
    refuse_swollen(path, len(lines.content), len(values), count)
    positions = np.empty((len(values), count, 3))
    for block in blocks(*positions.shape[:2]):
        positions[block] = _posed(asf, values[block], degrees)

    history = [f"read {path.name} (AMC) on {asf_path.name}: {counted(len(values), 'frame')}, {counted(count, 'joint')}"]
    if asked.up is None:
        history.append(f"{path.name} states no up axis: assumed y, override with up= (--up)")
    if asked.fps is None:
        history.append(
            assume(
                f"{path.name} states no frame rate: assumed {CMU_FPS:g} frames a second, that of the CMU database, "
                "override with fps= (--fps)"
            )
        )
    return motion_from(
        positions,
        Skeleton.from_parents([bone.name for bone in asf.bones], asf.parents, _offsets(asf)),
        fps=asked.fps or CMU_FPS,
        unit=unit,
        up=asked.up or "y",
        history=tuple(history),
    )


def _posed(asf: _Asf, values: np.ndarray, degrees: bool) -> np.ndarray:
    """Bone ends (frame, joint, 3) of values (frame, degree of freedom)."""
    angles, orders = np.zeros((len(values), len(asf.bones), 3)), []
    root = np.zeros((len(values), 3))
    column = 0
    for b, bone in enumerate(asf.bones):
        turns = []
        for dof in bone.dof:
            if dof[0] == "t":
                root[:, "xyz".index(dof[1])] = values[:, column]
            else:
                angles[:, b, len(turns)] = values[:, column]
                turns.append(dof[1].upper())
            column += 1
        orders.append("".join(turns) + "".join(axis for axis in "XYZ" if axis not in turns))
    if degrees:
        angles = np.radians(angles)
    # The rotation listed first is applied first, so it stands rightmost in the product.
    motion = euler_rotations(angles[..., ::-1], [order[::-1] for order in orders])
    axes = euler_rotations(
        np.radians([bone.axis[::-1] for bone in asf.bones]), [bone.axis_order[::-1] for bone in asf.bones]
    )
    local = axes @ motion @ np.swapaxes(axes, -1, -2)
    translations = np.einsum("fbij,bj->fbi", local, _offsets(asf))
    translations[:, 0] = root
    return forward(asf.parents, translations, local)[0]


def _offsets(asf: _Asf) -> np.ndarray:
    """From the start of each bone to its end (joint, 3) in the rest pose, in the file's unit."""
    return np.array([bone.offset for bone in asf.bones], float)


def beside(path: Path) -> list[Path]:
    """The ASF files in the folder of an AMC file."""
    return sorted(other for other in path.parent.iterdir() if other.suffix.lower() == ".asf")


def _skeleton_path(path: Path, asked: Asked) -> Path:
    """The ASF file that was asked for, or the only one beside the AMC file."""
    if asked.skeleton is not None:
        if isinstance(asked.skeleton, Skeleton) or Path(asked.skeleton).suffix.lower() != ".asf":
            raise ValueError("received a skeleton that is no ASF file: an AMC file needs the .asf it was made with")
        return Path(asked.skeleton)
    found = beside(path)
    if len(found) != 1:
        raise MotionFormatError(
            f"{path} needs a skeleton and its folder holds {counted(len(found), '.asf file')}: "
            "give the right one as skeleton= (--skeleton)"
        )
    return found[0]


def _read_asf(path: Path) -> _Asf:
    """Bones, parents and units of an ASF file."""
    sections: dict[str, list[tuple[int, str]]] = defaultdict(list)

    def content(section: str) -> Iterator[tuple[int, list[str]]]:
        return ((number, line.split()) for number, line in sections[section])

    section, lines = "", read_lines(path)
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        if words and words[0].startswith(":"):
            section = words[0].lower()
        elif words:
            sections[section].append((number, " ".join(words)))
    for needed in (":root", ":bonedata", ":hierarchy"):
        if not sections[needed]:
            raise MotionFormatError(f"{path} has no {needed} section within its {len(lines)} lines, get the whole file")

    units = {words[0].lower(): (number, words[1:]) for number, words in content(":units")}
    length = _numbers(path, *units["length"], 1)[0] if "length" in units else None
    if length is not None and length <= 0:
        raise MotionFormatError(f"{path}, line {units['length'][0]}: received length {length:g}, write one above 0")
    degrees = "angle" not in units or not " ".join(units["angle"][1]).lower().startswith("rad")

    fields = {words[0].lower(): (number, words[1:]) for number, words in content(":root")}
    for name in ("position", "orientation"):
        if name in fields and any(_numbers(path, *fields[name], 3)):
            raise MotionFormatError(
                f"{path}, line {fields[name][0]}: received a root {name} other than 0 0 0, which is not supported"
            )
    bones = {"root": _Bone("root", (0, 0, 0), (0, 0, 0), "XYZ", _dof(path, fields, "order", "root"))}
    fields, begun = {}, 0
    for number, words in content(":bonedata"):
        key = words[0].lower()
        if key == "begin":
            fields, begun = {}, number
        elif key == "end":
            bone = _bone(path, fields, begun, degrees)
            if bone.name in bones:
                raise MotionFormatError(f"{path}, line {begun}: received bone {bone.name!r} again, remove one")
            bones[bone.name], begun = bone, 0
        else:
            fields[key] = (number, words[1:])
    if begun:
        raise MotionFormatError(f"{path}, line {begun}: the bone that begins here has no end, get the whole file")

    parent_of: dict[str, str] = {}
    children: dict[str, list[str]] = defaultdict(list)
    for number, (parent, *names) in content(":hierarchy"):
        if parent.lower() in ("begin", "end") and not names:
            continue
        for name in (parent, *names):
            if name not in bones:
                raise MotionFormatError(f"{path}, line {number}: received {shown(name)}, which :bonedata does not hold")
        for name in names:
            if name in parent_of or name == "root":
                raise MotionFormatError(f"{path}, line {number}: received a second parent for {name!r}, remove one")
            parent_of[name] = parent
        children[parent] += names
    order, waiting = [], ["root"]
    while waiting:
        order.append(waiting.pop())
        waiting += reversed(children[order[-1]])
    loose = sorted(set(bones) - set(order))
    if loose:
        raise MotionFormatError(f"{path} holds bones that no :hierarchy line ties to the root: {', '.join(loose)}")
    index = {name: joint for joint, name in enumerate(order)}
    parents = [-1, *(index[parent_of[name]] for name in order[1:])]
    return _Asf([bones[name] for name in order], parents, length, degrees)


def _bone(path: Path, fields: dict[str, tuple[int, list[str]]], begun: int, degrees: bool) -> _Bone:
    """One block of :bonedata, from its fields (line number, words)."""
    for needed in ("name", "direction", "length"):
        if not fields.get(needed, (0, []))[1]:
            raise MotionFormatError(f"{path}, line {begun}: the bone that begins here has no {needed}, add it")
    name = fields["name"][1][0]
    direction = _numbers(path, *fields["direction"], 3)
    (length,) = _numbers(path, *fields["length"], 1)
    number, words = fields.get("axis", (begun, ["0", "0", "0", "XYZ"]))
    axis, order = _numbers(path, number, words[:3], 3), "".join(words[3:]).upper()
    if sorted(order) != ["X", "Y", "Z"]:
        raise MotionFormatError(f"{path}, line {number}: received axis order {shown(order)}, write one such as XYZ")
    if not degrees:
        axis = np.degrees(axis).tolist()
    return _Bone(name, [length * d for d in direction], axis, order, _dof(path, fields, "dof", name))


def _dof(path: Path, fields: dict[str, tuple[int, list[str]]], key: str, name: str) -> list[str]:
    """Degrees of freedom in file order; none where the field is missing."""
    number, words = fields.get(key, (0, []))
    dof = [word.lower() for word in words]
    known = {"rx", "ry", "rz"} | ({"tx", "ty", "tz"} if name == "root" else set())
    wrong = next((d for i, d in enumerate(dof) if d not in known or d in dof[:i]), None)
    if wrong is not None:
        raise MotionFormatError(
            f"{path}, line {number}: received {shown(wrong)} in the {key} of {name!r}, list {', '.join(sorted(known))} "
            "once at most"
        )
    return dof


def _numbers(path: Path, number: int, words: list[str], count: int) -> list[float]:
    """`count` finite numbers."""
    values = [value for value in map(finite, words) if value is not None]
    if not len(values) == len(words) == count:
        raise MotionFormatError(
            f"{path}, line {number}: received {shown(' '.join(words))}, write {counted(count, 'finite number')}"
        )
    return values


def _read_amc(path: Path, lines: Lines, asf: _Asf) -> tuple[np.ndarray, bool]:
    """Values (frame, degree of freedom) in the order of the bones, and whether angles are in degrees."""
    slots, width = {}, 0
    for bone in asf.bones:
        if bone.dof:
            slots[bone.name] = slice(width, width + len(bone.dof))
            width += len(bone.dof)
    degrees = asf.degrees
    frames: list[np.ndarray] = []
    begins: list[int] = []
    last = 0
    for number, line in enumerate(lines, 1):
        name, *words = line.split() or ["#"]
        if name.startswith(":"):
            degrees = {":DEGREES": True, ":RADIANS": False}.get(name.upper(), degrees)
        elif not words and name.isdecimal():
            if frames and int(name) != last + 1:
                raise MotionFormatError(
                    f"{path}, line {number}: received frame {name} after frame {last}, number the frames one by one"
                )
            last = int(name)
            frames.append(np.full(width, np.nan))
            begins.append(number)
        elif not name.startswith("#"):
            if not frames:
                raise MotionFormatError(f"{path}, line {number}: received {shown(name)} where frame 1 should begin")
            if name not in slots:
                raise MotionFormatError(
                    f"{path}, line {number}: received bone {shown(name)}, which does not move in the skeleton: "
                    "give the .asf that belongs to the file as skeleton= (--skeleton)"
                )
            slot = slots[name]
            frames[-1][slot] = _numbers(path, number, words, slot.stop - slot.start)
    if not frames:
        raise MotionFormatError(f"{path} holds no frame: get the whole file")
    values = np.array(frames)
    for frame, column in np.argwhere(np.isnan(values))[:1]:
        name = next(name for name, slot in slots.items() if slot.start <= column < slot.stop)
        raise MotionFormatError(
            f"{path}, line {begins[frame]}: the frame that begins here lacks bone {name!r}, the file was cut off or "
            "belongs to another skeleton"
        )
    return values, degrees
