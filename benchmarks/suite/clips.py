"""The clips of the suite: recorded motion on five skeletons, at any rate that divides 120 Hz."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from pathlib import Path

import numpy as np

from benchmarks.recordings import GLITCHED, MANIFEST
from motionrecover.io import load
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

RATE = 120
"""Frames a second of every recording."""
FRAMES = 300
"""The longest clip: the middle frames of a recording, counted at the rate of the row."""
RIGID = 0.005
"""A bone is rigid where its true length varies by less than this share of its mean over the clip."""

_LIMBS = ("UpLeg", "Leg", "Foot", "ToeBase", "Arm", "ForeArm", "Hand")
_BVH19 = ["Hips", "Spine", "Spine1", "Neck1", "Head", *(side + part for side in ("Left", "Right") for part in _LIMBS)]
"""The joints of the BVH conversion of CMU (cgspeed) without end sites, fingers and bones of zero length."""

_SMPL24 = {
    "hip": ("root", "hipjoint", 0.103),
    "knee": ("hipjoint", "femur", 0.387),
    "ankle": ("femur", "tibia", 0.427),
    "foot": ("tibia", "foot", 0.142),
    "spine1": ("root", "lowerback", 0.130),
    "spine2": ("lowerback", "upperback", 0.141),
    "spine3": ("upperback", "thorax", 0.056),
    "neck": ("thorax", "upperneck", 0.215),
    "head": ("upperneck", "head", 0.103),
    "collar": ("upperback", "clavicle", 0.136),
    "shoulder": ("thorax", "clavicle", 0.132),
    "elbow": ("clavicle", "humerus", 0.257),
    "wrist": ("humerus", "radius", 0.266),
    "hand": ("wrist", "hand", 0.088),
}
"""SMPL joint: the two joints of cmu31 that its bone points along, and its length in metres in SMPL's mean body."""


@dataclass(frozen=True, eq=False)
class Clip:
    """The truth: positions (frame, joint, 3) in metres, float64."""

    name: str
    positions: np.ndarray
    skeleton: Skeleton
    fps: float

    @property
    def bone_lengths(self) -> np.ndarray:
        """Median over the frames of the truth (bone,)."""
        return np.median(self.skeleton.bone_lengths_of(self.positions), 0)

    @property
    def rigid(self) -> list[tuple[int, int]]:
        """The bones that keep their length, as a bone that skips a joint does not.

        Five bones of cmu21 skip one. Tibia-toes and thorax-upperneck change their length; humerus-wrist keeps it in
        the recordings, whose wrists only twist.
        """
        lengths = self.skeleton.bone_lengths_of(self.positions)
        steady = np.ptp(lengths, axis=0) < RIGID * lengths.mean(0)
        return [edge for edge, keeps in zip(self.skeleton.edges, steady, strict=True) if keeps]


def pick(
    folder: Path, skeleton: str, fps: int, count: int, subjects: tuple[str, ...] = (), frames: int = 0
) -> tuple[list[str], int]:
    """`count` clips spread evenly over subjects, and over the clips of each; and how many clips are too short.

    `subjects`: those only, or all. `frames`: what the protocol needs, at the row's rate. The same call gives the same
    clips; where there are fewer than `count`, it gives all.
    """
    source = "cgspeed38" if skeleton == "bvh19" else "asfamc31"
    lengths = {
        row["clip"]: -(-int(row["frames"]) * fps // RATE)
        for row in csv.DictReader((folder / MANIFEST).read_text(encoding="utf-8").splitlines())
        if row["skeleton"] == source and row["clip"] not in GLITCHED
    }
    lengths = {name: n for name, n in lengths.items() if not subjects or name.split("_")[0] in subjects}
    long = sorted(name for name, n in lengths.items() if n >= frames)
    groups = [list(group) for _, group in groupby(long, key=lambda name: name.split("_")[0])]
    # Subjects take turns; the first few subjects, and the first few clips of each, are spread over all of them.
    turns = [groups[k] for k in _spread(len(groups))]
    queues = [[group[k] for k in _spread(len(group))] for group in turns]
    order = [queue[turn] for turn in range(max(map(len, queues), default=0)) for queue in queues if turn < len(queue)]
    return sorted(order[:count]), len(lengths) - len(long)


def read(folder: Path, name: str, skeleton: str, fps: int) -> Clip:
    """The middle of a recording on one of the skeletons cmu25, cmu21, bvh19 and smpl24."""
    motion = _motion(folder / "cmu" / "npz" / f"{name}.npz")
    if skeleton == "smpl24":
        motion = smpl24(motion)
    else:
        motion = motion.select(_BVH19 if skeleton == "bvh19" else Skeleton.standard(skeleton).names)
    positions = motion.positions[:: RATE // fps].astype(float)
    start = max(0, (len(positions) - FRAMES) // 2)
    return Clip(name, positions[start : start + FRAMES], motion.skeleton, fps)


def smpl24(motion: Motion) -> Motion:
    """A motion of cmu31 on the 24 joints and with the proportions of SMPL (Loper et al. 2015): every bone points where
    that of the recording does and has the length of SMPL's mean body."""
    skeleton = Skeleton.standard("smpl24")
    at = {name: motion.positions[:, k].astype(float) for k, name in enumerate(motion.names)}
    joints = {0: at["root"]}
    for joint, parent in enumerate(skeleton.parents):
        if parent != -1:
            side, _, part = skeleton.names[joint].rpartition("_")
            start, end, length = _SMPL24[part]
            start, end = (at[name if name in at else side[0] + name] for name in (start, end))
            joints[joint] = joints[parent] + length * (end - start) / np.linalg.norm(
                end - start, axis=-1, keepdims=True
            )
    positions = np.stack([joints[joint] for joint in range(len(skeleton.names))], 1)
    return Motion(positions, skeleton, motion.fps, history=(*motion.history, "with the bone lengths of SMPL"))


@lru_cache(maxsize=4)
def _motion(path: Path) -> Motion:
    return load(path)


def _spread(count: int) -> list[int]:
    """0 .. count - 1 in an order in which any first few are spread over all: by the digits of k / count, reversed."""
    bits = max(1, (count - 1).bit_length())
    order = sorted(range(2**bits), key=lambda k: int(f"{k:0{bits}b}"[::-1], 2))
    return [k for k in order if k < count]
