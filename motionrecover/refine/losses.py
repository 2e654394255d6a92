"""The losses of both papers, term by term, and how they add up.

Motion y, x is (batch, frame, joint, 3), y refined and x clean. Every term is the mean over the clips of a batch. Square
roots have 1e-12 inside, so that they have a gradient at 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

Motions = Float[Array, "batch frame joint 3"]


@dataclass(frozen=True)
class LossWeights:
    """What each term counts for."""

    position: float = 1.0
    distance: float = 0.0
    bone: float = 0.0
    smooth: float = 0.0
    perceptual: float = 0.0


def position(y: Motions, x: Motions) -> Array:
    """Choi et al. 2024, position loss: mean of (y - x)^2 over everything."""
    return ((y - x) ** 2).mean()


def distance(y: Motions, x: Motions) -> Array:
    """Mean distance of joints from where they were: of a mean of squares, what is missing has nearly all."""
    return jnp.sqrt(((y - x) ** 2).sum(-1) + 1e-12).mean()


def reproduction(y: Motions, x: Motions) -> Array:
    """Li et al. 2020, Eq. 3: |Y - X|_2 / (f d), of f frames and d coordinates a frame."""
    return _norm(y - x).mean() / x[0].size


def perceptual(h: Float[Array, "batch frame hidden"], k: Float[Array, "batch frame hidden"]) -> Array:
    """Li et al. 2020, Eq. 4: |E_p(X_R) - E_p(X_C)|_2 / (f hidden), from both hidden units."""
    return _norm(h - k).mean() / h[0].size


def smooth(y: Motions) -> Array:
    """Choi et al. 2024, smooth loss: |O Y'|_2 / (T + 2), where Y' repeats the first and the last frame of Y.

    O (Li et al. 2020, Eq. 5) is tridiagonal with 1, -2, 1 in a row and -1 at both ends of its diagonal: second
    differences, and 0 in the two rows that see a frame beside its copy. Li's Eq. 6 divides by d as well.
    """
    repeated = jnp.concatenate([y[:, :1], y, y[:, -1:]], 1)
    return _norm(jnp.diff(repeated, 2, axis=1)).mean() / repeated.shape[1]


def bone(y: Motions, x: Motions, bones: tuple[tuple[int, int], ...]) -> Array:
    """Choi et al. 2024, bone-length loss; Li et al. 2020, Eq. 7: mean of |l_b(y) - l_b(x)| over frames and bones.

    Li's lengths are those of the one actor; here each clip has its own.
    """
    if not bones:
        return jnp.zeros((), y.dtype)
    return jnp.abs(_lengths(y, bones) - _lengths(x, bones)).mean()


def choi(
    y: Motions, x: Motions, metric: tuple[Motions, Motions], bones: tuple[tuple[int, int], ...]
) -> dict[str, Array]:
    """Terms of Choi et al. 2024: positions of normalised motion, smoothness and bones of the same in metres (`metric`).

    The published code takes all three of normalised motion, whose axes have scales of their own: not bone lengths. Both
    scales are about a metre, so that the published weights serve.
    """
    return {
        "position": position(y, x),
        "distance": distance(*metric),
        "bone": bone(*metric, bones),
        "smooth": smooth(metric[0]),
    }


def li(y: Motions, x: Motions, metric: tuple[Motions, Motions], bones: tuple[tuple[int, int], ...]) -> dict[str, Array]:
    """Terms of Li et al. 2020, Eqs. 3, 6, 7; arguments as in `choi`."""
    channels = y.shape[2] * 3
    return {"position": reproduction(y, x), "bone": bone(*metric, bones), "smooth": smooth(metric[0]) / channels}


def _norm(y: Array) -> Array:
    """|y| of each clip (batch,)."""
    return jnp.sqrt((y.reshape(len(y), -1) ** 2).sum(-1) + 1e-12)


def _lengths(y: Motions, bones: tuple[tuple[int, int], ...]) -> Array:
    i, j = jnp.array(bones).T
    return jnp.sqrt(((y[:, :, i] - y[:, :, j]) ** 2).sum(-1) + 1e-12)
