"""Whittaker's smoother (Proc. Edinburgh Math. Soc. 41, 1923; Eilers, Analytical Chemistry 75, 2003), weighted."""

from __future__ import annotations

import numpy as np


def whittaker(positions: np.ndarray, variance: np.ndarray, drive: np.ndarray, order: int = 2) -> np.ndarray:
    """Positions (frame, joint, 3) smoothed along time, each joint by itself:

        min_x sum |x_t - y_t|^2 / v_t + |(D x)_t|^2 / q_t

    with v the `variance` (frame, joint) of y, q the `drive` (frame, joint) and D x the differences of that order, each
    counted at its last frame. Banded Cholesky, of all joints as one system that falls into parts: linear in time.
    """
    from scipy.linalg import solveh_banded  # a fifth of a second to import

    frames, joints = drive.shape
    least = 1e-6 * drive[drive > 0].min(initial=np.inf)
    weight = 1 / np.maximum(variance, least).T
    # Frames without drive at either end: no difference reaches over them, from one joint to the next.
    k = np.zeros((joints, frames + order))
    k[:, order:-order] = 1 / np.maximum(drive[order:], least).T
    c = np.diff(np.eye(order + 1), order, axis=0)[0]
    bands = np.zeros((order + 1, joints, frames))
    for apart in range(order + 1):
        for i in range(order + 1 - apart):
            bands[order - apart, :, apart:] += c[order - i] * c[order - i - apart] * k[:, i + apart : i + frames]
    bands[order] += weight
    right = (weight[..., None] * positions.swapaxes(0, 1)).reshape(-1, 3)
    smooth = solveh_banded(bands.reshape(order + 1, -1), right, overwrite_ab=True, overwrite_b=True)
    return smooth.reshape(joints, frames, 3).swapaxes(0, 1).copy()
