"""Rotation matrices: about a vector, and nearest to a matrix."""

import numpy as np


def about(vectors: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) about vectors (..., 3) by their length in radians (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = skew(vectors)
    # sin(t)/t and (1 - cos(t))/t^2, at 0 too
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (cross @ cross)


def skew(vectors: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) that take the cross product of vectors (..., 3) with what they multiply."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*vectors.shape, 3)


def nearest_rotation(matrices: np.ndarray) -> np.ndarray:
    """argmax over rotations R of trace(R^T M) for each M (..., 3, 3): orthogonal Procrustes (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(matrices)
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    return u @ vt
