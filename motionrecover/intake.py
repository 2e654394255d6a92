"""The border of the core: what a caller hands over, checked, completed and made ready for the solver.

Everything a caller can get wrong is refused here in one sentence. What comes out has no NaN, no joint that coincides
with its neighbour, and an origin in the middle of the data.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from motionrecover.evidence.bone_lengths import LEAST_FRAMES, estimate_bone_lengths
from motionrecover.motion import refuse_far
from motionrecover.runs import frames_away
from motionrecover.skeleton import ZERO_LENGTH, Skeleton, components
from motionrecover.solver import Guide, Problem

LONG_BONE = 2.0
"""Metres. A body whose bones are longer than this in the median is not measured in metres."""


@dataclass(frozen=True, eq=False)
class Intake:
    """A checked clip, and how the solver's joints map back to the caller's."""

    data: np.ndarray
    """D (frame, joint, 3), NaN where missing."""
    weights: np.ndarray
    """Trust (frame, joint) in [0, 1]; 0 where missing."""
    bone_lengths: np.ndarray
    """Of all the caller's bones; 0 for a merged one."""
    merged: np.ndarray
    """D of the solver's joints (frame, solver joint, 3), complete."""
    merged_weights: np.ndarray
    groups: np.ndarray
    """Solver joint of each of the caller's joints."""
    edges: tuple[tuple[int, int], ...]
    """Bones between the solver's joints."""
    edge_lengths: np.ndarray
    centre: bool
    """Whether the solver's origin is the data's middle, not the caller's origin."""
    guide: tuple[np.ndarray, np.ndarray] | None = None
    """Of the solver's joints (frame, solver joint, 3), complete, and trust in it (frame, solver joint)."""

    def problem(self, span: slice, stored: int, dtype: np.dtype) -> tuple[Problem, np.ndarray]:
        """The solver's problem for a span of frames, padded to `stored`, and its origin in the caller's coordinates."""
        merged, weights = self.merged[span], self.merged_weights[span]
        known = merged[weights > 0]
        origin = np.median(known, 0) if self.centre and len(known) else np.zeros(3)
        pad = (0, stored - len(merged))

        def array(value, *before) -> Any:  # of NumPy: JAX would convert each by a program of its own
            return np.pad(value, (*before, pad)).astype(dtype)

        guide = None
        if self.guide is not None:
            there, trust = (part[span] for part in self.guide)
            guide = Guide(
                positions=array((there - origin).transpose(2, 1, 0), (0, 0), (0, 0)),
                weights=array(trust.T, (0, 0)),
            )
        lengths: Any = self.edge_lengths.astype(dtype)
        frames: Any = np.asarray(len(merged), np.int32)
        return Problem(
            positions=array((merged - origin).transpose(2, 1, 0), (0, 0), (0, 0)),
            weights=array(weights.T, (0, 0)),
            bone_lengths=lengths,
            frames=frames,
            edges=self.edges,
            guide=guide,
        ), origin

    def restore(self, positions: Any, frames: int) -> np.ndarray:
        """(3, solver joint, stored frame) of the solver as (frame, joint, 3) of the caller, without origin."""
        return np.asarray(positions)[:, self.groups, :frames].transpose(2, 1, 0)


def positions_from(matrix: np.ndarray) -> np.ndarray:
    """(frame, joint, 3) from the papers' motion matrix (3 frames, joints): rows x, y, z of frame 1, 2, ..."""
    return matrix.reshape(-1, 3, matrix.shape[1]).transpose(0, 2, 1)


def matrix_from(positions: np.ndarray) -> np.ndarray:
    """The papers' motion matrix (3 frames, joints), Eq. 1 of Yang et al. 2020, from (frame, joint, 3)."""
    return positions.transpose(0, 2, 1).reshape(-1, positions.shape[1])


def check(data: Any, skeleton: Skeleton, observed: Any = None, confidence: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Positions (frame, joint, 3) in float64, NaN where missing, and their trust (frame, joint), 0 where missing.

    Raises `ValueError` for misshapen or infinite positions, and masks of another shape or outside [0, 1].
    """
    data = _positions(data, skeleton)
    shape = data.shape[:2]
    trust = _mask(confidence, "confidence", shape, np.float64)
    seen = np.isfinite(data).all(-1) & _mask(observed, "observed", shape, bool) & (trust > 0)
    return np.where(seen[..., None], data, np.nan), np.where(seen, trust, 0.0)


def take_in(
    data: Any,
    skeleton: Skeleton,
    observed: Any = None,
    confidence: Any = None,
    bone_lengths: Any = None,
    needs_bones: bool = True,
    centre: bool = True,
    fill_reach: float | None = 10.0,
    min_frames: int = 1,
    metres: bool = True,
    guide: Any = None,
    guide_confidence: Any = None,
) -> Intake:
    """Check the arguments of `recover` and prepare them. Raises `ValueError` for anything that cannot be used.

    Missing samples are stood for by straight lines in time. Their trust is 1 / (1 + d / `fill_reach`) at d frames from
    the nearest sample of the joint, and 0 where `fill_reach` is None. `metres`: warn
    when the bones are too long to be in metres. `guide` (as `data`) stands for joints that are never observed.
    """
    data, weights = check(data, skeleton, observed, confidence)
    said = None if guide is None else _guide(guide, guide_confidence, skeleton, len(data))
    if said is not None and np.any(weights):
        data = np.where(np.any(weights, axis=0)[:, None], data, said[0])
    seen, shape, names = np.isfinite(data[..., 0]), data.shape[:2], skeleton.names
    if shape[0] < min_frames:
        raise ValueError(
            f"received a clip of {shape[0]} frame{'s' * (shape[0] > 1)}: the model learns from time, "
            f"give at least {min_frames}"
        )
    if seen.any() and not seen.any(0).all():
        missing = [names[joint] for joint in np.flatnonzero(~seen.any(0))]
        raise ValueError(
            f"received {len(missing)} of {len(names)} joints that are never observed ({', '.join(missing)}): "
            "leave them out with `select`, nothing in the clip says where they were"
        )
    if needs_bones:
        _connected(skeleton)

    lengths = _lengths(bone_lengths, skeleton, data)
    zero = lengths < ZERO_LENGTH
    if len(lengths) and zero.all():
        raise ValueError("all joints coincide in every frame: give positions of a body that has an extent")
    if needs_bones and bone_lengths is None and shape[0] < LEAST_FRAMES:
        raise ValueError(
            f"received a clip of {shape[0]} frames without bone lengths: they cannot be estimated from fewer than "
            f"{LEAST_FRAMES}, give bone_lengths=, for example those of the rest pose (--bone-lengths rest)"
        )
    groups, edges, edge_lengths = _merge(skeleton, lengths, zero)
    if metres and len(edge_lengths) and np.median(edge_lengths) > LONG_BONE:
        warnings.warn(
            f"received bones of {np.median(edge_lengths):.3g} m in the median: the presets take positions in metres, "
            "scale yours if they are in another unit",
            stacklevel=3,
        )
    members = [np.flatnonzero(groups == group) for group in range(groups.max() + 1)]
    merged, merged_weights = _merged(data, weights, members)
    if seen.any() and fill_reach is not None:
        away = frames_away(np.isfinite(merged[..., 0]))
        merged_weights = np.where(away > 0, 1 / (1 + away / fill_reach), merged_weights)
    if said is not None:
        there, trust = _merged(*said, members)
        said = fill(there), trust
    return Intake(
        data=data,
        weights=weights,
        bone_lengths=np.where(zero, 0.0, lengths),
        merged=fill(merged),
        merged_weights=merged_weights,
        groups=groups,
        edges=edges,
        edge_lengths=edge_lengths,
        centre=centre,
        guide=said,
    )


def checked_lengths(bone_lengths: Any, skeleton: Skeleton) -> np.ndarray:
    """Given lengths (bone,) in float64. Raises `ValueError` where they do not fit the skeleton or are not positive."""
    bones, names = len(skeleton.edges), skeleton.bone_names
    lengths = np.asarray(bone_lengths, np.float64)
    if lengths.shape != (bones,):
        raise ValueError(f"received bone_lengths of shape {lengths.shape}: the skeleton has {bones} bones")
    bad = ~(np.isfinite(lengths) & (lengths > 0)) & ~(_points(skeleton) & (lengths == 0))
    if bad.any():
        bone = int(np.argmax(bad))
        raise ValueError(f"received a length of {lengths[bone]} for bone {names[bone]}: lengths are positive")
    return lengths


def fill(positions: np.ndarray) -> np.ndarray:
    """Missing samples of (frame, joint, 3) by linear interpolation in time, the ends held; 0 for a joint never seen."""
    frames, out = np.arange(len(positions)), positions.copy()
    for joint in range(positions.shape[1]):
        seen = np.isfinite(positions[:, joint, 0])
        for axis in range(3):
            values = positions[seen, joint, axis]
            out[~seen, joint, axis] = np.interp(frames[~seen], frames[seen], values) if seen.any() else 0.0
    return out


def _positions(data, skeleton):
    """`data` as (frame, joint, 3) in float64 with NaN for missing."""
    data, joints = np.asarray(data), len(skeleton.names)
    if data.dtype == object or not (np.issubdtype(data.dtype, np.floating) or np.issubdtype(data.dtype, np.integer)):
        raise ValueError(f"received data of type {data.dtype}: give real numbers")
    if data.ndim == 2 and data.shape[1] == joints and len(data) % 3 == 0:
        data = positions_from(data)
    if data.ndim != 3 or data.shape[1:] != (joints, 3):
        raise ValueError(
            f"received data of shape {data.shape}: a skeleton of {joints} joints needs "
            f"(frames, {joints}, 3) or the motion matrix (3 frames, {joints})"
        )
    if len(data) == 0:
        raise ValueError("received a clip of 0 frames: recovery needs at least one")
    refuse_far(data, skeleton.names)
    return data.astype(np.float64)


def _mask(mask, name, shape, dtype):
    """An (frame, joint) argument, ones where it is left out or NaN."""
    if mask is None:
        return np.ones(shape, dtype)
    mask = np.asarray(mask).astype(dtype)
    if mask.shape != shape:
        raise ValueError(f"received {name} of shape {mask.shape}: the clip has (frame, joint) = {shape}")
    outside = (mask < 0) | (mask > 1)
    if outside.any():
        raise ValueError(f"received a {name} of {mask[outside][0]}: give values from 0 (ignore) to 1 (trust)")
    return np.where(np.isnan(mask), 1, mask).astype(dtype)


def _guide(guide, confidence, skeleton, frames):
    """The guide's positions (frame, joint, 3), NaN where it says nothing, and the trust in it (frame, joint)."""
    positions, trust = check(guide, skeleton, confidence=confidence)
    if len(positions) != frames:
        raise ValueError(f"received a guide of {len(positions)} frames for a clip of {frames}: give one of each frame")
    return positions, trust


def _connected(skeleton):
    """Refuse a skeleton whose bones cannot hold it together."""
    if not skeleton.edges:
        raise ValueError(
            f"received a skeleton of {len(skeleton.names)} joints without bones: "
            "add bones, or use the preset lowrank_wang2016, which needs none"
        )
    parts = skeleton.components
    if len(parts) > 1:
        raise ValueError(
            f"received a skeleton in {len(parts)} parts: no bone connects {skeleton.names[parts[1][0]]!r} to "
            f"{skeleton.names[parts[0][0]]!r}, add one or recover the parts one by one"
        )


def _lengths(bone_lengths, skeleton, data):
    """Lengths (bone,) as given, or estimated; zero-length bones of the rest pose stay zero."""
    bones = len(skeleton.edges)
    if bone_lengths is None:
        if not np.isfinite(data).any():
            return np.ones(bones)  # nothing observed, nothing recovered: the solver's verdict says so
        lengths = estimate_bone_lengths(skeleton.bone_lengths_of(data)).length
        if np.isnan(lengths).any():
            # A bone whose ends are never seen together is measured between interpolated ends.
            filled = estimate_bone_lengths(skeleton.bone_lengths_of(fill(data))).length
            lengths = np.where(np.isnan(lengths), filled, lengths)
        return np.where(_points(skeleton), 0.0, lengths)
    return checked_lengths(bone_lengths, skeleton)


def _merged(positions, weights, members):
    """Positions and weights of the solver's joints, from those of their members."""
    return (
        np.stack([_medoid(positions[:, joints]) for joints in members], 1),
        np.stack([weights[:, joints].max(1) for joints in members], 1),
    )


def _points(skeleton):
    """Bones (bone,) of no length in the rest pose."""
    rest = skeleton.rest_lengths
    return np.zeros(len(skeleton.edges), bool) if rest is None else rest < ZERO_LENGTH


def _merge(skeleton, lengths, zero):
    """Solver joint of each joint where bones of no length are one joint, and the solver's bones with their lengths."""
    groups = np.empty(len(skeleton.names), int)
    points = [edge for edge, z in zip(skeleton.edges, zero, strict=True) if z]
    for group, joints in enumerate(components(points, len(skeleton.names))):
        groups[joints] = group
    bones: dict[tuple[int, int], float] = {}
    for (i, j), length, z in zip(skeleton.edges, lengths, zero, strict=True):
        if not z:
            a, b = sorted((int(groups[i]), int(groups[j])))
            bones.setdefault((a, b), length)
    return groups, tuple(bones), np.array(list(bones.values()), np.float64)


def _medoid(positions):
    """Of coinciding joints (frame, member, 3) the sample nearest to all others in sum, NaN where nothing is observed.

    The median of two intact samples and two thrown to one side is off; two that coincide are always the nearest.
    """
    if positions.shape[1] == 1:
        return positions[:, 0]
    apart = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    total = np.where(np.isnan(positions[..., 0]), np.inf, np.nansum(apart, -1))
    return positions[np.arange(len(positions)), total.argmin(1)]
