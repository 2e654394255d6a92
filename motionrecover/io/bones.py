"""Bones of files: their own, asked for, a standard's whose joint names fit, or inferred from the distances."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from motionrecover.evidence.rigid_graph import infer_graph
from motionrecover.io.border import assume, counted
from motionrecover.io.errors import MotionFormatError
from motionrecover.skeleton import STANDARDS, Skeleton

INFER = "infer"
"""Asked for as a skeleton, it means the bones that the distances of the clip show."""
MOST_MARKERS, FEW_PAIRS = 500, 10_000
"""Bones are inferred unasked between so many markers at most, which takes a minute, and where there are four samples
to a pair of markers or few pairs."""


def skeleton_for(
    path: Path | str,
    names: Sequence[str],
    own: Skeleton | None,
    asked: Skeleton | str | Path | None,
    positions: np.ndarray,
) -> tuple[Skeleton, list[int], str]:
    """Skeleton of a file with joints `names`, the file's column of each of its joints, and a line of history.

    The asked skeleton goes before the file's `own`; with neither, a standard is taken whose names fit (`recognised`),
    else the bones that the distances in `positions` (frame, joint, 3) show, if any, with a `MotionFormatWarning`.
    Raises `MotionFormatError` where its joints are not the file's, `ValueError` for an unknown skeleton.
    """
    if asked == INFER:
        skeleton, note = _inferred(names, positions), "inferred the bones from distances that stay the same"
    elif asked is not None:
        standard = fitted(str(asked), names) if str(asked) in STANDARDS else None
        skeleton, note = standard or named(asked), "took the bones from the skeleton asked for"
    elif own is not None:
        skeleton, note = own, "took the bones from the file"
    elif found := recognised(names):
        standard, skeleton = found
        size = len(Skeleton.standard(standard).names)
        part = "whose joints these are" if size == len(names) else f"of whose {size} joints these are {len(names)}"
        note = f"took the bones of {standard}, {part}"
    else:
        pairs = len(names) * (len(names) - 1) // 2
        few = pairs <= max(FEW_PAIRS, len(positions) * len(names) // 4) and len(names) <= MOST_MARKERS
        skeleton = _inferred(names, positions) if few else Skeleton(names)
        inferred = (
            f"inferred {counted(len(skeleton.edges), 'bone')} in {counted(len(skeleton.components), 'part')} from "
            "distances that stay the same, which `motionrecover skeleton` lists"
        )
        why = "no distance stays the same" if few else "too many to compare all distances"
        note = assume(
            f"{Path(path).name} names {counted(len(names), 'joint')} without bones: "
            f"{inferred if skeleton.edges else f'{why}, they are taken one by one'}; "
            "override with skeleton= (--skeleton)",
            deeper=1,
        )
    if set(skeleton.names) != set(names):
        lost, new = sorted(set(names) - set(skeleton.names)), sorted(set(skeleton.names) - set(names))
        raise MotionFormatError(
            f"{path} and the skeleton name other joints: only the file has {lost}, only the skeleton has {new}; "
            "give a skeleton with the joints of the file"
        )
    index = {name: column for column, name in enumerate(names)}
    return skeleton, [index[name] for name in skeleton.names], note


def recognised(names: Sequence[str]) -> tuple[str, Skeleton] | None:
    """The smallest standard that has all of these joints, if they are half of it or more and hang together.

    With it the skeleton of these joints, as `fitted` gives it.
    """
    sizes = {standard: len(Skeleton.standard(standard).names) for standard in STANDARDS}
    for standard in sorted(STANDARDS, key=sizes.__getitem__):
        skeleton = fitted(standard, names) if len(names) <= sizes[standard] <= 2 * len(names) else None
        if skeleton is not None and len(skeleton.components) == 1:
            return standard, skeleton
    return None


def fitted(standard: str, names: Sequence[str]) -> Skeleton | None:
    """The joints `names` of a standard, called so, in its order; None where it has others.

    Case, spaces, underscores, dots and dashes make no difference, nor does a prefix: `mixamorig:`, `Subject:`,
    `body_` (FreeMoCap's CSV).
    """
    skeleton = Skeleton.standard(standard)
    theirs = {plain_name(name): name for name in names}
    ours = {plain_name(name): name for name in skeleton.names}
    if len(theirs) < len(names) or not theirs.keys() <= ours.keys():
        return None
    part = skeleton.select([ours[plain] for plain in ours if plain in theirs])
    return Skeleton([theirs[plain_name(name)] for name in part.names], part.edges)


def named(skeleton: Skeleton | str | Path) -> Skeleton:
    """A skeleton from itself, the name of a standard, or a TOML file."""
    if isinstance(skeleton, Skeleton):
        return skeleton
    if str(skeleton) in STANDARDS:
        return Skeleton.standard(str(skeleton))
    if not Path(skeleton).is_file():
        raise ValueError(
            f"received skeleton {str(skeleton)!r}: give a skeleton file that exists, {INFER}, or one of "
            f"{', '.join(STANDARDS)}"
        )
    return Skeleton.from_file(skeleton)


def plain_name(name: str) -> str:
    """What of a joint's name tells it from the others of its rig."""
    return re.sub(r"^mixamorig\d*|^body_|[\s_.-]", "", name.rpartition(":")[2].lower())


def _inferred(names: Sequence[str], positions: np.ndarray) -> Skeleton:
    return Skeleton(names, infer_graph(positions).edges)
