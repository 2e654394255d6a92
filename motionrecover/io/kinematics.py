"""Angles and forward kinematics for the formats that store rotations; vectorised over frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motionrecover.rotations import about

LOCKED = 1e-4
"""Cosine of the middle angle below which the first and the last turn about one axis and only their sum shows."""

FEW = 2**11
"""Rotation matrices that are always made in one go."""


def blocks(frames: int, joints: int) -> list[slice]:
    """Parts of the frames to pose one by one: rotations and what leads to them take ten times the positions' memory."""
    some = max(1, FEW // joints, frames // 32)
    return [slice(first, first + some) for first in range(0, frames, some)]


def euler_rotations(angles: np.ndarray, orders: Sequence[str]) -> np.ndarray:
    """Rotation matrices (..., joint, 3, 3) of angles (..., joint, 3) in radians.

    `orders` holds a permutation of XYZ a joint; the matrices of its letters are multiplied from left to right.
    """
    from pybvh.rotations import euler_to_rotmat

    return euler_to_rotmat(angles, list(orders))


def continuous_angles(rotations: np.ndarray, order: str, near: np.ndarray) -> np.ndarray:
    """Angles (frame, 3) in radians of one joint's rotations (frame, 3, 3), that run on from frame to frame.

    R = R_i(a) R_j(b) R_k(c) has two sets of angles, (a, b, c) and (a + pi, pi - b, c + pi), each up to full turns. The
    two are as far from each other's predecessors, so that whether the nearer set changes from one frame to the next
    does not depend on which is taken: the sets follow from the parity of the changes so far. The first frame is the
    nearest to `near` (3,). At gimbal lock c runs straight on between its neighbours, and a makes up for it.
    """
    i, j, k = ("XYZ".index(axis) for axis in order)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    r = rotations
    b = np.arcsin(np.clip(sign * r[:, i, k], -1, 1))
    a, c = (np.arctan2(-sign * r[:, j, k], r[:, k, k]), np.arctan2(-sign * r[:, i, j], r[:, i, i]))
    free = np.flatnonzero(np.hypot(r[:, i, i], r[:, i, j]) > LOCKED)
    last = np.full(len(r), near[2])
    if len(free):
        one = np.stack([a, b, c], -1)[free]
        other = np.stack([a + np.pi, np.pi - b, c + np.pi], -1)[free]
        before = np.concatenate([near[None], one[:-1]])
        changes = _apart(other, before) < _apart(one, before)
        chosen = np.where((np.cumsum(changes) % 2 == 1)[:, None], other, one)
        last = np.interp(np.arange(len(r)), free, np.unwrap(np.concatenate([near[2:], chosen[:, 2]]))[1:])
    # With c known, R R_k(c)^T = R_i(a) R_j(b) gives the others, at gimbal lock too.
    undone = r @ np.swapaxes(about(np.eye(3)[k] * last[:, None]), -1, -2)
    first = np.arctan2(sign * undone[:, k, j], undone[:, j, j])
    middle = np.arctan2(sign * undone[:, i, k], undone[:, i, i])
    return np.unwrap(np.concatenate([near[None], np.stack([first, middle, last], -1)]), axis=0)[1:]


def _apart(angles, others):
    """Squared distance between sets of angles (..., 3), full turns aside."""
    return np.sum(np.square((angles - others + np.pi) % (2 * np.pi) - np.pi), -1)


def forward(parents: Sequence[int], translations: np.ndarray, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Global positions (frame, joint, 3) and rotations (frame, joint, 3, 3) of a forest, parents before their children.

    -1 marks a root. `translations` (frame, joint, 3) and `rotations` (frame, joint, 3, 3) are relative to the parent's
    frame: p_j = p_parent + R_parent t_j and R_j = R_parent L_j.
    """
    positions, turned = translations.copy(), rotations.copy()
    for joint, parent in enumerate(parents):
        if parent != -1:
            turn = turned[:, parent]
            positions[:, joint] = positions[:, parent] + np.einsum("fij,fj->fi", turn, translations[:, joint])
            turned[:, joint] = turn @ rotations[:, joint]
    return positions, turned
