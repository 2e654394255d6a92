"""Measures of a recovered clip against the truth, on arrays, in float64.

Positions are (frame, joint, 3). A `mask` (frame, joint) is True where a sample counts; left out, every sample counts.
A derivative counts where all the frames that it needs do. A sample that does not count may be NaN; a counted NaN makes
the result NaN, and so does a mask that counts nothing: a method that failed stays visible and never looks good.

Every measure raises `ValueError` for misshapen arguments.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionrecover.motion import UP_AXES
from motionrecover.skeleton import Skeleton, bone_lengths

Edges = Skeleton | Sequence[tuple[int, int]] | np.ndarray


def aje(recovered: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Average joint error: mean of |x~ - x| over counted frames and joints, in the unit of the positions.

    Yang et al. 2020, Sec. IV, omega; elsewhere called the mean per-joint position error (MPJPE).
    """
    recovered, truth = _paired(recovered, truth)
    return _mean(_length(recovered - truth), _counted(mask, recovered))


def abe(recovered: np.ndarray, truth_or_lengths: np.ndarray, bones: Edges, mask: np.ndarray | None = None) -> float:
    """Average bone-length error: mean of |l~ - l| over frames and bones, in the unit of the positions.

    Yang et al. 2020, Sec. IV, xi. The lengths l come from true positions (frame, joint, 3), or are given as (bone,) or
    (frame, bone). `bones` is a skeleton or its edges. A bone counts where both its joints do.
    """
    recovered, lengths = _positions(recovered), np.asarray(truth_or_lengths, float)
    if lengths.ndim == 3:
        lengths = _bone_lengths(_paired(recovered, lengths)[1], bones)
    counted, (i, j) = _counted(mask, recovered), _ends(bones)
    return _mean(bone_length_error(recovered, bones, lengths), counted[:, i] & counted[:, j])


def bone_length_error(positions: np.ndarray, bones: Edges, bone_lengths: np.ndarray) -> np.ndarray:
    """|l~ - l| of every bone in every frame (frame, bone), for true lengths l of (bone,) or (frame, bone)."""
    found = _bone_lengths(_positions(positions), bones)
    lengths = np.asarray(bone_lengths, float)
    if lengths.shape not in (found.shape, found.shape[1:]):
        raise ValueError(
            f"received bone lengths of shape {lengths.shape}: {found.shape[1]} bones in {found.shape[0]} frames need "
            f"({found.shape[1]},) or {found.shape}"
        )
    return np.abs(found - lengths)


def acceleration_ratio(recovered: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean acceleration magnitude of the recovered clip over that of the truth: above 1 jitters, below 1 is too smooth.

    NaN where the truth does not accelerate at all.
    """
    recovered, truth = _paired(recovered, truth)
    mean = _mean(_length(np.diff(truth, 2, axis=0)), _all_of(3, _counted(mask, truth)))
    found = _mean(_length(np.diff(recovered, 2, axis=0)), _all_of(3, _counted(mask, truth)))
    return found / mean if mean else float("nan")


def acceleration_error(recovered: np.ndarray, truth: np.ndarray, fps: float, mask: np.ndarray | None = None) -> float:
    """Mean of |a~ - a|, with a(t) = (x(t-1) - 2 x(t) + x(t+1)) fps^2, in units a second squared."""
    recovered, truth = _paired(recovered, truth)
    return _mean(_length(np.diff(recovered - truth, 2, axis=0)), _all_of(3, _counted(mask, truth))) * fps**2


def jitter(positions: np.ndarray, fps: float, mask: np.ndarray | None = None) -> float:
    """Mean jerk magnitude |x'''|, by third differences times fps^3, in units a second cubed (Flash & Hogan 1985)."""
    positions = _positions(positions)
    return _mean(_length(np.diff(positions, 3, axis=0)), _all_of(4, _counted(mask, positions))) * fps**3


def foot_slide(positions: np.ndarray, contacts: np.ndarray, feet: Sequence[int], fps: float, up: str = "y") -> float:
    """Mean horizontal speed of the feet between two frames in contact, in units a second; NaN without a contact.

    Foot skating after Zhang et al., "Mode-adaptive neural networks for quadruped motion control", 2018, with
    `contacts` (frame, foot) of the joints `feet` in place of their weight for the height over a known floor.
    """
    return _mean(*_planted_speeds(positions, contacts, feet, fps, up))


def skating_ratio(
    positions: np.ndarray,
    contacts: np.ndarray,
    feet: Sequence[int],
    fps: float,
    up: str = "y",
    limit: float = 0.1,
) -> float:
    """Share of the planted steps from frame to frame that are faster than `limit`, units a second; NaN without any.

    Arguments as in `foot_slide`.
    """
    speeds, counted = _planted_speeds(positions, contacts, feet, fps, up)
    return _mean(np.where(np.isnan(speeds), np.nan, speeds > limit), counted)


def _positions(positions: np.ndarray) -> np.ndarray:
    positions = np.asarray(positions, float)
    if positions.ndim != 3 or positions.shape[-1] != 3:
        raise ValueError(f"received positions of shape {positions.shape}: give (frame, joint, 3)")
    return positions


def _planted_speeds(
    positions: np.ndarray, contacts: np.ndarray, feet: Sequence[int], fps: float, up: str
) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal speeds (frame - 1, foot), and where both frames are in contact."""
    positions, contacts = _positions(positions), np.asarray(contacts, bool)
    if contacts.shape != (len(positions), len(feet)):
        raise ValueError(
            f"received contacts of shape {contacts.shape}: give (frame, foot) = {(len(positions), len(feet))}"
        )
    tracks = np.delete(positions[:, list(feet)], UP_AXES.index(up), axis=-1)
    return _length(np.diff(tracks, axis=0)) * fps, _all_of(2, contacts)


def _paired(recovered: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    recovered, truth = _positions(recovered), _positions(truth)
    if recovered.shape != truth.shape:
        raise ValueError(
            f"received recovered positions of shape {recovered.shape} and true ones of shape {truth.shape}: "
            "give the same frames and joints"
        )
    return recovered, truth


def _counted(mask: np.ndarray | None, positions: np.ndarray) -> np.ndarray:
    if mask is None:
        return np.ones(positions.shape[:2], bool)
    mask = np.asarray(mask, bool)
    if mask.shape != positions.shape[:2]:
        raise ValueError(f"received a mask of shape {mask.shape}: the clip has (frame, joint) = {positions.shape[:2]}")
    return mask


def _all_of(frames: int, counted: np.ndarray) -> np.ndarray:
    """Where `frames` frames in a row count: (frame - frames + 1, joint)."""
    count = max(len(counted) - frames + 1, 0)
    return np.logical_and.reduce([counted[k : k + count] for k in range(frames)])


def _ends(bones: Edges) -> np.ndarray:
    edges = bones.edges if isinstance(bones, Skeleton) else bones
    return np.asarray(edges, int).reshape(-1, 2).T


def _bone_lengths(positions: np.ndarray, bones: Edges) -> np.ndarray:
    ends = _ends(bones)
    if ends.max(initial=0) >= positions.shape[1]:
        raise ValueError(f"received bones of more joints than the {positions.shape[1]} of the positions")
    return bone_lengths(positions, ends.T)


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)


def _mean(values: np.ndarray, counted: np.ndarray) -> float:
    return float(values[counted].mean()) if counted.any() else float("nan")
