"""Which samples are intact, given what each says alone and what the bones between them say."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from motionrecover.isometry.objective import Edges, ends

SWEEPS = 12
"""A message crosses one bone a sweep; 12 is the way between the farthest joints of the usual bodies."""


def beliefs(
    alone: Float[Array, "frame joint"], together: Float[Array, "frame bone"], edges: Edges
) -> Float[Array, "frame joint"]:
    """Log odds (nats) that a sample is intact, by the sum-product algorithm; every frame on its own.

    p(c) ~ exp(sum_j alone_j c_j + sum_ij together_ij c_i c_j) over binary c (1: intact), with messages

        m_ij = log(1 + exp(h + together_ij)) - log(1 + exp(h)),   h = alone_i + sum of messages to i but that of j.

    Exact on trees, loopy on other graphs (Pearl, "Probabilistic Reasoning in Intelligent Systems", 1988, Ch. 4). Two
    joints at their bone's length vouch for each other: with 80 % of all samples displaced, this finds most of the
    intact neighbours before anything is known about the motion.
    """
    if not edges:
        return alone
    i, j = ends(edges)
    # Products with the bones' ends: scattering takes ten times as long.
    to_i, to_j = (jax.nn.one_hot(end, alone.shape[1], dtype=alone.dtype) for end in (i, j))

    def gathered(forth, back):
        return alone + forth @ to_j + back @ to_i

    def sweep(_, messages):
        forth, back = messages
        total = gathered(forth, back)
        at_i, at_j = total[:, i] - back, total[:, j] - forth
        return (
            jax.nn.softplus(at_i + together) - jax.nn.softplus(at_i),
            jax.nn.softplus(at_j + together) - jax.nn.softplus(at_j),
        )

    silence = jnp.zeros_like(together)
    forth, back = lax.fori_loop(0, SWEEPS, sweep, (silence, silence))
    return gathered(forth, back)
