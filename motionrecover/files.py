"""Between a file and its recovery: what `motionrecover recover` and every clip of a batch have in common."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motionrecover import __version__
from motionrecover.evidence.bone_lengths import estimate_bone_lengths
from motionrecover.io import load
from motionrecover.io.border import counted
from motionrecover.io.bvh_out import rig_of
from motionrecover.motion import Motion
from motionrecover.recovery import Recovery
from motionrecover.report.account import measured

BoneLengths = Literal["auto", "estimate", "rest"]


def take_in(
    path: str | Path, bone_lengths: BoneLengths = "auto", *, as_bvh: bool = False, **asked: Any
) -> tuple[Motion, Literal["estimate", "rest"], np.ndarray | None]:
    """The clip of a file, `rest` or `estimate`, and the lengths (bone,) to recover it with, None for estimates.

    `bone_lengths` auto takes those of the rest pose from a BVH whose frames keep them. `as_bvh`: the answer will be
    written as BVH. `asked` as for `io.load`. Raises as `load` does, and `ValueError` for a clip from which nothing can
    be recovered as asked.
    """
    clip = load(path, **asked)
    if not clip.observed.any():
        raise ValueError(f"{path} holds no measured sample: there is nothing to recover from")
    if as_bvh:
        rig_of(clip)  # refuses what BVH cannot hold before the work
    return clip, *lengths_for(clip, bone_lengths, path)


def lengths_for(
    clip: Motion, bone_lengths: BoneLengths, path: str | Path
) -> tuple[Literal["estimate", "rest"], np.ndarray | None]:
    """`rest` or `estimate`, and the lengths, of a clip that came from `path`: see `take_in`."""
    if bone_lengths == "auto":
        bone_lengths = "rest" if _keeps_rest(clip) else "estimate"
    lengths = clip.skeleton.rest_lengths if bone_lengths == "rest" else None
    if bone_lengths == "rest" and lengths is None:
        raise ValueError(f"{path} brings no rest pose to take bone lengths from: use --bone-lengths estimate")
    return bone_lengths, lengths


def answer(clip: Motion, recovery: Recovery, preset: str, digest: str | None = None) -> Motion:
    """The recovered motion of a clip, with a line of history, and in it the SHA-256 of the clip's file."""
    ended = "converged" if recovery.converged else "not converged"
    note = f"recovered with {preset} of motionrecover {__version__}: {counted(recovery.steps, 'step')}, {ended}"
    if digest is not None:
        note += f"; SHA-256 of the input {digest}"
    return clip.with_positions(recovery.positions, note)


def sha256(path: str | Path) -> str:
    """Of a file, or of a folder's files with their names, in hexadecimal digits."""
    if os.path.isdir(path):
        of_all = hashlib.sha256()
        for each in sorted(each for each in Path(path).rglob("*") if each.is_file()):
            of_all.update(f"{each.relative_to(path).as_posix()}\0{sha256(each)}\0".encode(errors="surrogateescape"))
        return of_all.hexdigest()
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _keeps_rest(motion: Motion) -> bool:
    """Whether a clip that came from BVH has its bones at the lengths of the rest pose, within half a millimetre."""
    rest = motion.skeleton.rest_lengths
    if motion.rig is None or rest is None:
        return False
    lengths = estimate_bone_lengths(motion.skeleton.bone_lengths_of(measured(motion))).length
    return bool((np.abs(lengths - rest) < 0.0005).all())
