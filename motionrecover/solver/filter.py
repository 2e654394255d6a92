"""The frames behind a window, one by one as they come: the smoother's model and beliefs without a look ahead.

From the state z of `solver.kalman` behind the last sure frame on, each frame is judged by its prediction from those
before, as `solver.smoother` judges it by that from all others, and then counted:

    p = P(intact | y) by beliefs( log (1 - pi) / pi + log f(y - z) / N(y - z; v + o^2), bones ),  v = diag(H P H^T)
    (z, P) = update(z, P, y, s^2 / c where p > 1/2, else o^2),  then ahead by Q
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from motionrecover.isometry.objective import Edges
from motionrecover.solver.kalman import ahead, before, update
from motionrecover.solver.smoother import INTACT, Smoother, judged, log_intact, log_normal


def behind(
    samples: Float[Array, "frame joint 3"],
    noise: Float[Array, "frame joint"],
    drive: Float[Array, "joint joint"],
    activity: Float[Array, " frame"],
    start: Float[Array, ""],
) -> tuple[Array, Array]:
    """z (2 joints, 3) and P of the frame behind the samples; arguments as for `kalman.smooth`."""

    def forward(carry, row):
        (z, p), (y, r, a) = carry, row
        return ahead(*update(z, p, y, r), a * drive), None

    following = jnp.concatenate([activity[1:], activity[-1:]])
    return lax.scan(forward, before(samples[0], start), (samples, noise, following))[0]


def follow(
    state: tuple[Array, Array],
    samples: Float[Array, "frame joint 3"],
    confidence: Float[Array, "frame joint"],
    evidence: Float[Array, "frame bone"],
    drive: Float[Array, "joint joint"],
    noise: Float[Array, " joint"],
    outlier: Float[Array, ""],
    outlier_share: Float[Array, ""],
    scale: Float[Array, ""],
    edges: Edges,
) -> tuple[Array, Array, Array]:
    """Positions (frame, joint, 3), covariance (frame, joint, joint) and probability of being intact, frame by frame.

    `state`: z and P of the first frame, from `behind`. `confidence`: 0 where missing. The rest is as in `SmootherState`
    and `Smoother`.
    """
    outlier = jnp.maximum(jnp.maximum(outlier, 4 * noise), (Smoother.GROSS * scale) ** 2)
    odds = jnp.log((1 - outlier_share) / outlier_share)

    def forward(carry, row):
        z, p = carry
        y, c, together = row
        joints, observed = len(y), c > 0
        s2 = noise / jnp.maximum(c, 1e-3)
        variance = jnp.diag(p)[:joints]
        square = jnp.sum((y - z[:joints]) ** 2, -1)
        own = odds + log_intact(square, variance, s2) - log_normal(square, variance + outlier)
        intact = judged(own[None], observed[None], together[None], edges)[0]
        r = jnp.where(intact > INTACT, s2, outlier)
        z, p = update(z, p, y, jnp.where(observed, r, (Smoother.MISSING * scale) ** 2))
        return ahead(z, p, drive), (z[:joints], p[:joints, :joints], intact)

    return lax.scan(forward, state, (samples, confidence, evidence))[1]
