"""Whittaker's smoother (Proc. Edinburgh Math. Soc. 41, 1923; Eilers, Analytical Chemistry 75, 2003), weighted."""

from __future__ import annotations

import numpy as np


def whittaker(positions: np.ndarray, variance: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Positions (frame, joint, 3) smoothed along time, each joint by itself:

        min_x sum |x_t - y_t|^2 / v_t + |x_t - 2 x_{t-1} + x_{t-2}|^2 / q_t

    with v the `variance` (frame, joint) of y and q the `drive` (frame, joint). Banded Cholesky: linear in time.
    """
    from scipy.linalg import solveh_banded  # a fifth of a second to import

    least = 1e-6 * drive[drive > 0].min(initial=np.inf)
    weight = 1 / np.maximum(variance, least)
    # Two frames without drive at either end: no second difference reaches over them.
    k = np.zeros((len(drive) + 2, drive.shape[1]))
    k[2:-2] = 1 / np.maximum(drive[2:], least)
    out = positions.copy()
    for joint in range(positions.shape[1]):
        last, middle, first = k[:-2, joint], k[1:-1, joint], k[2:, joint]
        bands = np.zeros((3, len(drive)))
        bands[2] = weight[:, joint] + last + 4 * middle + first
        bands[1, 1:] = -2 * (last + middle)[1:]
        bands[0, 2:] = last[2:]
        out[:, joint] = solveh_banded(bands, weight[:, joint, None] * positions[:, joint])
    return out
