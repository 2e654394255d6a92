"""Positions moved onto their bone lengths, the uncertain ones first."""

import jax.numpy as jnp
from jax import lax
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Float

from motionrecover.isometry.objective import Edges, ends

STEPS = 20
"""The correction is of second order after two steps wherever a bone is off by less than a tenth of its length. Some
bones of Kinect recordings are off by half, and vary by up to 3 % after 5 steps."""
DONE = 1e-24
"""A step whose square is this part of that of the bones is the last: a millionth of a micrometre."""


def project(
    positions: Float[Array, "frame joint 3"],
    covariance: Float[Array, "frame joint joint"],
    bone_lengths: Float[Array, " bone"],
    edges: Edges,
    slack: Float[Array, " bone"] | None = None,
) -> tuple[Float[Array, "frame joint 3"], Float[Array, "frame joint"]]:
    """The most likely positions with the given bone lengths, for errors of that covariance on each axis alike.

        min_x sum_c (x_c - y_c)^T P^-1 (x_c - y_c) + sum_ij (|x_i - x_j| - l_ij)^2 / v_ij

    with v = `slack` the variance of each length; left out, it is 0 and the lengths are constraints. By Gauss-Newton
    steps (a frame each; u the unit bone vectors, B the bones' incidence matrix) from x = y and multipliers 0:

        z = ((B P B^T) o (u u^T) + V)^-1 (l - |B x| - V multipliers),   x <- x + P B^T (u z),   multipliers += z

    The second answer is the variance of what is left of the errors, the mean of the three axes: of

        diag(P) - P B^T u ((B P B^T) o (u u^T) + V)^-1 u^T B P

    A step that takes a frame farther from its lengths is tried again at a quarter: where an outlier was taken for
    certain, a frame may have no positions with these lengths.

    A joint of no variance stays; where both ends of a bone are certain, the bone stays as it is. Works on any graph;
    where that has more bones than freedom, as among markers of one segment, no positions may have all the lengths, and
    without slack the answer is anywhere: markers of a segment fly 20 mm off.
    """
    if not edges:
        return positions, jnp.diagonal(covariance, axis1=1, axis2=2)
    slack = jnp.zeros(len(edges)) if slack is None else slack
    i, j = ends(edges)

    def frame(row):
        position, covariance = row
        spread = covariance[:, i] - covariance[:, j]  # P B^T
        between = spread[i] - spread[j]  # B P B^T
        size = jnp.trace(between) / len(edges)
        # Certain bones have a zero row: the ridge leaves them alone.
        ridge = 1e-6 * size + jnp.finfo(position.dtype).tiny ** 0.5

        def linear(x):
            bones = x[i] - x[j]
            length = jnp.linalg.norm(bones, axis=-1)
            unit = bones / jnp.maximum(length, 1e-12)[:, None]
            return length, unit, jnp.linalg.cholesky(between * (unit @ unit.T) + jnp.diag(slack + ridge))

        def off(x):
            return jnp.sum((bone_lengths - jnp.linalg.norm(x[i] - x[j], axis=-1)) ** 2 / (slack + size + ridge))

        def more(state):
            _, _, _, change, step = state
            return (change > DONE) & (step < STEPS)

        def advance(state):
            x, multipliers, pace, _, step = state
            length, unit, factor = linear(x)
            z = pace * cho_solve((factor, True), bone_lengths - length - slack * multipliers)
            push = spread @ (unit * z[:, None])
            closer = off(x + push) <= off(x)
            change = jnp.sum(push**2) / jnp.maximum(jnp.sum(bone_lengths**2), 1e-300)
            x, multipliers = jnp.where(closer, x + push, x), jnp.where(closer, multipliers + z, multipliers)
            return x, multipliers, jnp.where(closer, 1.0, pace / 4), change, step + 1

        one = jnp.ones((), position.dtype)
        moved, *_ = lax.while_loop(more, advance, (position, 0 * bone_lengths, one, jnp.inf * one, 0))
        _, unit, factor = linear(moved)
        inverse = cho_solve((factor, True), jnp.eye(len(edges), dtype=position.dtype))
        known = jnp.sum((spread @ (inverse * (unit @ unit.T))) * spread, 1) / 3
        return moved, jnp.maximum(jnp.diagonal(covariance) - jnp.nan_to_num(known), 0)

    # Frame by frame: LAPACK's batches share threads between programs, and two programs at once wait for ever.
    return lax.map(frame, (positions, covariance))
