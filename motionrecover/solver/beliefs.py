"""Which samples are intact, given what each says alone and what the bones between them say."""

import math

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from motionrecover.isometry.objective import Edges, ends

SWEEPS = 12
"""At most. A message crosses one bone a sweep; 12 is the way between the farthest joints of the usual bodies."""
STILL = 1e-6
"""Nats. Messages that move by less have arrived: after four to eight sweeps, three once the motion is known."""


def beliefs(
    alone: Float[Array, "frame joint"], together: Float[Array, "frame bone"], edges: Edges
) -> Float[Array, "frame joint"]:
    """Log odds (nats) that a sample is intact, by the sum-product algorithm; every frame on its own.

    p(c) ~ exp(sum_j alone_j c_j + sum_ij together_ij c_i c_j) over binary c (1: intact), with messages

        m_ij = log((1 + exp(h + together_ij)) / (1 + exp(h))),   h = alone_i + sum of messages to i but that of j.

    Exact on trees, loopy on other graphs (Pearl, "Probabilistic Reasoning in Intelligent Systems", 1988, Ch. 4). Two
    joints at their bone's length vouch for each other: with 80 % of all samples displaced, this finds most of the
    intact neighbours before anything is known about the motion.
    """
    if not edges:
        return alone
    i, j = ends(edges)
    alone = alone.T
    # Products with the bones' ends: scattering takes ten times as long.
    to_i, to_j = (jax.nn.one_hot(end, len(alone), dtype=alone.dtype, axis=0) for end in (i, j))
    most = 0.9 * math.log(jnp.finfo(alone.dtype).max)
    factor = jnp.exp(jnp.clip(together.T, -most, most))

    def gathered(forth, back):
        return alone + to_j @ forth + to_i @ back

    def message(h):
        # One exponential and one logarithm, where two of log(1 + exp) take three times as long.
        small = jnp.exp(-jnp.abs(h))
        return jnp.log(jnp.where(h > 0, small + factor, 1 + small * factor) / (1 + small))

    def sweep(carry):
        (forth, back), _, count = carry
        total = gathered(forth, back)
        new = message(total[i] - back), message(total[j] - forth)
        moved = jnp.maximum(jnp.abs(new[0] - forth).max(), jnp.abs(new[1] - back).max())
        return new, moved, count + 1

    silence = jnp.zeros_like(factor)
    start = (silence, silence), jnp.array(jnp.inf, alone.dtype), jnp.array(0)
    messages, _, _ = lax.while_loop(lambda carry: (carry[1] > STILL) & (carry[2] < SWEEPS), sweep, start)
    return gathered(*messages).T
