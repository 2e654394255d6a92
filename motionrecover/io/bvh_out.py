"""Writing BVH: positions as joint rotations and root track, on the hierarchy the clip came on or on one made for it.

A clip read from BVH keeps its hierarchy, channels, frame time, unit and axes, and whatever its positions do not show:
twists, end sites, joints that were left out. For any other clip on a tree the hierarchy is made: the bones at their
median lengths, in the directions of the rest pose or else of the first complete frame, in metres with y up.
"""

from __future__ import annotations

import itertools
import math
import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionrecover.intake import fill
from motionrecover.io.border import PLAIN, counted, from_metres, plain, to_metres
from motionrecover.io.errors import MotionFormatError, MotionFormatWarning
from motionrecover.io.inverse_kinematics import Freedom, Pose, solve
from motionrecover.io.kinematics import continuous_angles, euler_rotations, forward
from motionrecover.motion import Motion
from motionrecover.rig import Rig
from motionrecover.skeleton import ZERO_LENGTH, bone_lengths

MEAN, LARGEST = 0.0005, 0.002
"""Metres off in the mean and at most, from which on the writer warns."""
MOVES = 0.001
"""Metres by which the position channels of a joint other than the root must vary to place it. Many programs give every
joint position channels and repeat the offset in them: there the parent has to turn."""

_ROOT = (*(("position", axis) for axis in (0, 1, 2)), *(("rotation", axis) for axis in (2, 0, 1)))


def write(motion: Motion, path: Path) -> None:
    """Write a motion as BVH; see `posed` for what is warned about and refused."""
    for name in motion.names:
        if not plain(name) or "  " in name or re.search("[{}]", name):
            raise MotionFormatError(
                f"received joint name {name!r}: BVH takes {PLAIN}, without braces and double spaces"
            )
    rig = posed(motion).rig
    assert rig is not None
    lines = [*_hierarchy(rig), "MOTION", f"Frames: {len(rig.values)}", f"Frame Time: {rig.frame_time!r}"]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")
        # 10^-6 degrees and a micrometre, of a file in metres
        np.savetxt(file, rig.values + 0.0, fmt="%.6f")


def posed(motion: Motion) -> Motion:
    """The motion as its rig can show it: positions of the same joints, complete, and the rig that moves so.

    Warns (`MotionFormatWarning`) of unknown positions, which BVH cannot leave out, and where the positions are off by
    more than `MEAN` or `LARGEST`. Raises `MotionFormatError` where `rig_of` does.
    """
    # A sample without one coordinate is not known.
    known = np.isfinite(motion.positions).all(-1, keepdims=True)
    motion = replace(motion, positions=np.where(known, motion.positions, np.nan))
    rig = rig_of(motion)
    column = [rig.names.index(name) for name in motion.names]
    wanted = np.full((len(motion), len(rig.names), 3), np.nan)
    wanted[:, column] = motion.positions
    unknown = int(np.isnan(motion.positions[..., 0]).sum())
    if motion.rig is None:
        seen = np.isfinite(wanted[..., 0]).any(0)
        wanted[:, seen] = fill(wanted[:, seen])
    if unknown:
        how = "their straight line in time" if motion.rig is None else "the rotations that the clip came with"
        warnings.warn(
            f"received {counted(unknown, 'unknown position')}, which BVH cannot leave out: they follow {how}",
            MotionFormatWarning,
            stacklevel=2,
        )

    translations, angles = rig.split()
    orders, turns = rig.orders, rig.turns
    translations *= rig.unit
    vary = np.ptp(translations, axis=0).max(-1) > MOVES
    free = Freedom(rig.parents, orders, turns, rig.moves & (vary | (np.array(rig.parents) == -1))[:, None])
    start = Pose(translations, angles, euler_rotations(angles, orders))
    pose = solve(free, start, from_metres(wanted, 1.0, rig.up))

    shown, _ = forward(rig.parents, pose.translations, pose.rotations)
    found = to_metres(shown, 1.0, rig.up)[:, column]
    off = np.linalg.norm(found - motion.positions, axis=-1)
    off = off[np.isfinite(off)]
    mean, largest = (float(off.mean()), float(off.max())) if len(off) else (0.0, 0.0)
    apart = f"{1000 * mean:.3f} mm in the mean and {1000 * largest:.3f} mm at most"
    if mean > MEAN or largest > LARGEST:
        warnings.warn(
            f"the positions as rotations are off by {apart}: they do not keep the bone lengths of the hierarchy, or "
            "bend what it holds rigid (recovering with --bone-lengths rest keeps the lengths)",
            MotionFormatWarning,
            stacklevel=2,
        )
    continued = np.unwrap(pose.angles, axis=0)
    for joint in np.flatnonzero(turns == 3):
        continued[:, joint] = continuous_angles(pose.rotations[:, joint], orders[joint], angles[0, joint])
    return motion.with_positions(
        found,
        f"turned into rotations, off by {apart}",
        observed=motion.observed,
        confidence=motion.confidence,
        rig=rig.moved(pose.translations / rig.unit, continued),
    )


def rig_of(motion: Motion) -> Rig:
    """The rig that the motion came on, or one made for it.

    Raises `MotionFormatError` where the rig does not fit the motion any more, and where there is none and the skeleton
    is no tree.
    """
    rig = motion.rig
    if rig is None:
        return _made(motion)
    if len(rig.values) != len(motion) or not set(motion.names) <= set(rig.names):
        raise MotionFormatError(
            f"received {counted(len(motion), 'frame')} of {', '.join(motion.names[:3])}, ... with a rig of "
            f"{counted(len(rig.values), 'frame')} of {', '.join(rig.names[:3])}, ...: cut its frames with "
            "rig=motion.rig.frames(...), or leave it out with rig=None"
        )
    same = math.isclose(1 / rig.frame_time, motion.fps, rel_tol=1e-3)
    return rig if same else replace(rig, frame_time=1 / motion.fps)


def _made(motion: Motion) -> Rig:
    """A rig whose rest pose is the clip's own; leaves get an end site of no length.

    Where the children of a joint move against each other, each gets a joint of no length before it, as LHipJoint is in
    the BVH files of CMU: no rotation of one joint moves hips or shoulders that are not rigid (2.4 mm off in the mean
    without it on CMU's AMC 05_01, 11 mm at most).
    """
    skeleton = motion.skeleton
    try:
        parents = skeleton.parents
    except ValueError as error:
        raise MotionFormatError(f"BVH holds one tree: {error}, write .npz or .csv") from error
    if parents.count(-1) != 1:
        roots = [name for name, parent in zip(motion.names, parents, strict=True) if parent == -1]
        raise MotionFormatError(
            f"BVH holds one tree, received {len(roots)} ({', '.join(roots[:5])}): select one, or write .npz or .csv"
        )
    whole = _complete(motion, parents)
    offsets = _offsets(motion, parents, whole)
    names, above, rest, ends = [], [], [], []
    taken = set(motion.names)

    def put(name: str, parent: int, offset: np.ndarray, end: bool = False, new: bool = True) -> int:
        while new and name in taken:
            name += "_"
        taken.add(name)
        for column, value in ((names, name), (above, parent), (rest, offset), (ends, end)):
            column.append(value)
        return len(names) - 1

    below: dict[int, list[int]] = {}
    for joint, parent in enumerate(parents):
        below.setdefault(parent, []).append(joint)
    # Depth first, as the blocks of a file lie in each other.
    waiting = [(below[-1][0], -1, False)]
    while waiting:
        joint, parent, apart = waiting.pop()
        name, children = motion.names[joint], below.get(joint, [])
        if apart:
            parent = put(f"{names[parent]}_{name}", parent, np.zeros(3))
        end = not children and parent != -1 and name == f"{names[parent]}_end"
        place = put(name, parent, offsets[joint], end, new=False)
        bends = _bends(whole[:, children], offsets[children])
        waiting += [(child, place, bends) for child in reversed(children)]
        if not children and not end:
            put(f"{name}_end", place, np.zeros(3), end=True)

    channels = tuple(() if end else _ROOT if at == -1 else _ROOT[3:] for end, at in zip(ends, above, strict=True))
    values = np.zeros((len(motion), sum(map(len, channels))))
    return Rig(tuple(names), tuple(above), np.array(rest), channels, tuple(ends), values, 1 / motion.fps, 1.0, "y")


def _bends(children: np.ndarray, rest: np.ndarray) -> bool:
    """Whether the children (frame, joint, 3) of a joint are not as far apart as at rest (joint, 3), outliers aside."""
    pairs = list(itertools.combinations(range(children.shape[1]), 2))
    apart = np.percentile(bone_lengths(children, pairs), [5, 95], axis=0)
    return bool((np.abs(apart - bone_lengths(rest[None], pairs)) > MOVES).any())


def _complete(motion: Motion, parents: Sequence[int]) -> np.ndarray:
    """Positions (frame, joint, 3) without gaps; a joint never seen is where the nearest one above it is that was."""
    positions = fill(motion.positions.astype(float))
    seen = np.asarray(np.isfinite(motion.positions[..., 0]).any(0))
    if not seen.any():
        raise MotionFormatError("received a clip without any known position: nothing says how long the bones are")
    for joint in np.flatnonzero(~seen).tolist():
        at = parents[joint]
        while at != -1 and not seen[at]:
            at = parents[at]
        positions[:, joint] = positions[:, int(seen.argmax()) if at == -1 else at]
    return positions


def _offsets(motion: Motion, parents: Sequence[int], positions: np.ndarray) -> np.ndarray:
    """Offsets (joint, 3) of the rest pose of a made rig, given the positions without gaps."""
    missing = np.isnan(motion.positions[..., 0])
    pose = positions[int((missing == missing.all(0)).all(1).argmax())]
    along = pose - pose[list(parents)]
    rest = motion.skeleton.rest_offsets
    if rest is not None:
        straight = np.linalg.norm(rest, axis=-1, keepdims=True) > ZERO_LENGTH
        along = np.where(straight, rest, along)
    along[parents.index(-1)] = 0.0
    lengths = np.linalg.norm(along, axis=-1)
    measured = motion.skeleton.bone_lengths_of(motion.positions)
    for bone, (_, child) in enumerate(motion.skeleton.edges):
        seen = measured[np.isfinite(measured[:, bone]), bone]
        if len(seen) and lengths[child] > ZERO_LENGTH:
            along[child] *= np.median(seen) / lengths[child]
    return along


def _hierarchy(rig: Rig) -> list[str]:
    """Lines of the text up to MOTION."""
    lines, open_blocks = ["HIERARCHY"], []
    for joint, (name, parent) in enumerate(zip(rig.names, rig.parents, strict=True)):
        while open_blocks and open_blocks[-1] != parent:
            open_blocks.pop()
            lines.append("\t" * len(open_blocks) + "}")
        tabs = "\t" * len(open_blocks)
        key = "End Site" if rig.ends[joint] else f"{'ROOT' if parent == -1 else 'JOINT'} {name}"
        lines += [
            tabs + key,
            tabs + "{",
            f"{tabs}\tOFFSET " + " ".join(f"{value:.12g}" for value in rig.offsets[joint]),
        ]
        if not rig.ends[joint]:
            words = [f"{'XYZ'[axis]}{kind}" for kind, axis in rig.channels[joint]]
            lines.append(f"{tabs}\tCHANNELS {len(words)} {' '.join(words)}".rstrip())
        open_blocks.append(joint)
    return lines + ["\t" * depth + "}" for depth in reversed(range(len(open_blocks)))]
