"""Forward kinematics for the formats that store rotations; vectorised over frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def euler_rotations(angles: np.ndarray, orders: Sequence[str]) -> np.ndarray:
    """Rotation matrices (..., joint, 3, 3) of angles (..., joint, 3) in radians.

    `orders` holds a permutation of XYZ a joint; the matrices of its letters are multiplied from left to right.
    """
    from pybvh.rotations import euler_to_rotmat

    return euler_to_rotmat(angles, list(orders))


def forward(parents: Sequence[int], translations: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Global positions (frame, joint, 3) of a forest whose parents come before their children; -1 marks a root.

    `translations` (frame, joint, 3) and `rotations` (frame, joint, 3, 3) are relative to the parent's frame:
    p_j = p_parent + R_parent t_j and R_j = R_parent L_j.
    """
    positions, turned = translations.copy(), rotations.copy()
    for joint, parent in enumerate(parents):
        if parent != -1:
            turn = turned[:, parent]
            positions[:, joint] = positions[:, parent] + np.einsum("fij,fj->fi", turn, translations[:, joint])
            turned[:, joint] = turn @ rotations[:, joint]
    return positions
