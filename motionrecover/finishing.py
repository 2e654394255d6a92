"""What `recover` does on request when the motion is found: joints never seen placed by their bones, feet planted."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from motionrecover.estimate import FREE, project_blocks
from motionrecover.evidence.contacts import find_contacts, foot_joints, plant
from motionrecover.evidence.pose_prior import Poses, mean_from_poses, median_distances, present, proportioned
from motionrecover.evidence.regression import ALIKE, bone_distance
from motionrecover.skeleton import Skeleton

NEAR, REACH = 0.8, 3.0
"""Bones over which a joint's weight falls by e, in the fit of the frame and in the input, for joints never seen."""
NOISE = 0.01
"""Of the regression on poses."""


def fill_unseen(positions: np.ndarray, edges: Any, bone_lengths: np.ndarray) -> np.ndarray:
    """Positions (frame, joint, 3) with joints that are NaN throughout placed by their bones.

    Between two neighbours: at its distances from both, bent away from the body. Beyond one: straight on from the bone
    before, as a stretched limb. Only a guess: a bone does not say which way it points. A joint whose bones have no
    finite length, or whose neighbours are not known, stays NaN.
    """
    out, edges = positions.copy(), [tuple(edge) for edge in edges]
    length = {edge: l for edge, l in zip(edges, bone_lengths, strict=True) if np.isfinite(l) and l > 0}
    unseen = [joint for joint in range(positions.shape[1]) if np.isnan(positions[:, joint]).all()]
    near = {
        joint: [(a + b - joint, length[a, b]) for a, b in edges if joint in (a, b) and (a, b) in length]
        for joint in range(positions.shape[1])
    }
    for _ in unseen:
        for joint in unseen:
            known = [(k, l) for k, l in near[joint] if not np.isnan(out[:, k]).all()]
            if not np.isnan(out[:, joint]).all() or not known:
                continue
            if len(known) > 1:
                out[:, joint] = _on_the_circle(out, *known[0], *known[1])
                continue
            k, l = known[0]
            before = [m for m, _ in near[k] if m != joint and not np.isnan(out[:, m]).all()]
            if before:
                along = out[:, k] - out[:, before[0]]
                out[:, joint] = out[:, k] + l * along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)
    return out


def place_by_poses(
    positions: np.ndarray, poses: Poses, edges: Any, bone_lengths: np.ndarray, stored: int, seconds: dict[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (frame, joint, 3) with joints that are NaN throughout placed as in poses of other people.

    Each is predicted from the joints that the clip shows (`evidence.pose_prior`), then all are moved onto the lengths
    of their bones (bone,), or those that fit the body's others where they are NaN, as far as either is certain. A frame
    in which one of the others is unknown stays as it is. With the variance (frame, joint) of the error of one axis,
    infinite where nothing was placed. `stored` frames at a time go through the program; its times are added to
    `seconds`.
    """
    out, variance = positions.copy(), np.full(positions.shape[:2], np.inf)
    here = present(poses.positions)
    unseen = np.isnan(positions[..., 0]).all(0)
    wanted, others = np.flatnonzero(here & unseen), np.flatnonzero(here & ~unseen)
    frames = np.flatnonzero(np.isfinite(positions[:, others]).all((1, 2)))
    if not len(wanted) or len(others) < ALIKE or not len(frames):
        return out, variance
    distances = median_distances(positions)
    for (i, j), length in zip(edges, bone_lengths, strict=True):
        if np.isfinite(length) and length > 0:
            distances[i, j] = distances[j, i] = length
    body = proportioned(poses, distances)
    away = bone_distance(body.tree, positions.shape[1])
    for joint in wanted:
        far = away[joint, others] - away[joint, others].min()
        out[frames, joint], found = mean_from_poses(
            body.positions[:, joint],
            body.positions[:, others],
            positions[np.ix_(frames, others)],
            np.exp(-far / NEAR),
            np.exp(-far / REACH),
            np.ones((len(frames), len(others))),
            NOISE,
            body.bodies,
        )
        variance[frames, joint] = found
    free = np.zeros((len(frames), positions.shape[1]))
    free[:, wanted] = variance[np.ix_(frames, wanted)]
    covariance = free[:, :, None] * np.eye(positions.shape[1])
    complete = np.where(np.isfinite(out[frames]), out[frames], 0)
    with jax.enable_x64(True):
        moved, left = project_blocks(complete, covariance, body.lengths, body.deviations**2, body.tree, stored, seconds)
    # A guessed length is in the prediction too: it is off with it, whatever the projection gains.
    for bone, deviation in zip(body.tree, body.deviations, strict=True):
        left[:, list(bone)] += deviation**2 / 3
    out[np.ix_(frames, wanted)], variance[np.ix_(frames, wanted)] = moved[:, wanted], left[:, wanted]
    return out, variance


def _on_the_circle(positions, i, l_i, j, l_j):
    """The point at distances l_i and l_j from two joints that is farthest from the body's middle."""
    across = positions[:, j] - positions[:, i]
    distance = np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    unit = across / distance
    along = (distance**2 + l_i**2 - l_j**2) / (2 * distance)
    centre = positions[:, i] + along * unit
    out = centre - np.nanmean(positions, 1)
    out -= np.sum(out * unit, -1, keepdims=True) * unit
    radius = np.sqrt(np.maximum(l_i**2 - along**2, 0))
    return centre + radius * out / np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-12)


def plant_feet(
    positions: np.ndarray,
    skeleton: Skeleton,
    bone_lengths: np.ndarray,
    fps: float,
    stored: int,
    seconds: dict[str, float],
) -> np.ndarray:
    """Positions (frame, joint, 3), y up, with feet held in place during contacts, and the bones at their lengths.

    Feet go where `evidence.contacts.plant` wants them; the other joints follow as little as the bones demand. `stored`
    frames at a time go through the program; its times are added to `seconds`.
    """
    feet = foot_joints(skeleton, positions)
    contacts = find_contacts(positions, fps, feet)
    if not contacts.any():
        return positions
    targets, weights = plant(positions, contacts, feet, fps)
    held = weights > 0
    moved = positions.copy()
    moved[:, feet] = np.where(held[..., None], targets, positions[:, feet])
    freedom = np.ones(positions.shape[:2])
    freedom[:, feet] = np.where(held, 1e-4, 1.0)
    # A frame without contact has nothing to follow.
    covariance = np.eye(positions.shape[1]) * (freedom * held.any(1, keepdims=True))[:, None]
    off = np.nanmax(np.abs(skeleton.bone_lengths_of(positions) - bone_lengths), 0, initial=0)
    # Bones that do not keep their length anyway are not held to it.
    rigid = np.isfinite(bone_lengths) & (bone_lengths > 0) & (off < 1e-3 * bone_lengths)
    lengths, slack = np.where(rigid, bone_lengths, 0), np.where(rigid, 0, (FREE * np.nanmedian(bone_lengths)) ** 2)
    complete = np.isfinite(moved).all((1, 2))
    with jax.enable_x64(True):
        moved[complete], _ = project_blocks(
            moved[complete], covariance[complete], lengths, slack, skeleton.edges, stored, seconds
        )
    return moved
