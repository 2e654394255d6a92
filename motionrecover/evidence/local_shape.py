"""What a joint sees of the others: a frame fitted to them in each row, and their shape in it as input to a kernel."""

from __future__ import annotations

import numpy as np

from motionrecover.rotations import nearest_rotation


def rigid_frames(points: np.ndarray, weights: np.ndarray, learnt: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotations (row, 3, 3), centres (row, 3) and local positions (row, point, 3) that match the points best.

    Generalised Procrustes over the first `learnt` rows: rotate to the mean shape, average again (Gower, Psychometrika
    40, 1975); four rounds from the row with most points known. Points on a line leave a rotation about it open. The
    multiple of the identity makes it the smallest one instead of a toss of the rounding errors.
    """
    if not points.shape[1]:
        return np.tile(np.eye(3), (len(points), 1, 1)), np.zeros((len(points), 3)), points
    first = slice(learnt)
    fullest = np.argmax((weights[first] == weights[first].max(0)).sum(1))
    weights = weights / weights.sum(1, keepdims=True)
    centres = np.einsum("ts,tsi->ti", weights, points)
    points = points - centres[:, None]
    if points.shape[1] < 3:
        return np.tile(np.eye(3), (len(points), 1, 1)), centres, points
    size = (points**2).sum((1, 2)).mean() + np.finfo(np.float64).tiny

    def fit(rows: slice, shape: np.ndarray) -> np.ndarray:
        A = np.einsum("tsi,ts,sj->tij", points[rows], weights[rows], shape)
        A += (1e-8 * np.linalg.norm(A, axis=(1, 2)) + 1e-18 * size)[:, None, None] * np.eye(3)
        return nearest_rotation(A)

    shape = points[fullest]
    for _ in range(4):
        turned = points[first] @ fit(first, shape)
        shape = (weights[first, :, None] * turned).sum(0) / weights[first].sum(0)[:, None]
    rotations = fit(slice(None), shape)
    return rotations, centres, points @ rotations


def inputs(shapes: np.ndarray, share: np.ndarray, learnt: int) -> tuple[np.ndarray, np.ndarray]:
    """Products (row, train) of the inputs u made of local positions, and their squares (row,)."""
    flat = (shapes * share[:, None]).reshape(len(shapes), -1)
    size = np.sqrt((flat[:learnt] ** 2).sum(1).mean())
    u = flat - flat[:learnt].mean(0)
    # A rigid body's local positions are rounding errors, and stay that small.
    scale = max(np.sqrt((u[:learnt] ** 2).sum(1).mean()), 1e-9 * size)
    u /= scale + np.finfo(np.float64).tiny
    return u @ u[:learnt].T, (u**2).sum(1)
