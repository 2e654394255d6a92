"""Positions moved onto their bone lengths, the uncertain ones first."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from motionrecover.isometry.objective import Edges

STEPS = 5
"""The correction is of second order after two steps wherever a bone is off by less than a tenth of its length."""


def project(
    positions: Float[Array, "frame joint 3"],
    covariance: Float[Array, "frame joint joint"],
    bone_lengths: Float[Array, " bone"],
    edges: Edges,
) -> Float[Array, "frame joint 3"]:
    """The most likely positions with the given bone lengths, for errors of that covariance on each axis alike.

        min_x sum_c (x_c - y_c)^T P^-1 (x_c - y_c)   s.t.   |x_i - x_j| = l_ij

    by Gauss-Newton steps on the constraints (a frame each; u the unit bone vectors, B the bones' incidence matrix):

        z = ((B P B^T) o (u u^T))^-1 (l - |B x|),   x <- x + P B^T (u z)

    A joint of no variance stays; where both ends of a bone are certain, the bone stays as it is. Works on any graph.
    """
    if not edges:
        return positions
    i, j = jnp.array(edges).T
    spread = covariance[:, :, i] - covariance[:, :, j]  # P B^T
    between = spread[:, i] - spread[:, j]  # B P B^T
    size = jnp.trace(between, axis1=1, axis2=2) / len(edges)
    # Certain bones have a zero row: the ridge leaves them alone.
    ridge = (1e-6 * size + jnp.finfo(positions.dtype).tiny ** 0.5)[:, None, None] * jnp.eye(len(edges))

    def step(_, x):
        bones = x[:, i] - x[:, j]
        length = jnp.linalg.norm(bones, axis=-1)
        unit = bones / jnp.maximum(length, 1e-12)[..., None]
        matrix = between * jnp.einsum("thc,tgc->thg", unit, unit) + ridge
        z = jnp.linalg.solve(matrix, (bone_lengths - length)[..., None])[..., 0]
        return x + jnp.einsum("tsh,thc->tsc", spread, unit * z[..., None])

    return lax.fori_loop(0, STEPS, step, positions)
