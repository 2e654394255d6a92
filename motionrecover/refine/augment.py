"""More people than were recorded: clean windows as other bodies would have made them, drawn anew for each batch.

proportions    each bone as long as it was times a number between 1/(1 + SPREAD) and 1 + SPREAD, the same on both
               sides and all frames; joints are hung on their parents again, from the root on
mirror         left and right change places, in half of the windows
backwards      the frames in opposite order, in half of the windows
heading        turned about the vertical by up to `TURN`, since the heading of a clip with gaps is an estimate
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from motionrecover.skeleton import Skeleton

SPREAD = 0.25
TURN = 0.2
"""Radians."""


def augmented(
    key: PRNGKeyArray, clean: Float[Array, "batch frame joint 3"], skeleton: Skeleton
) -> Float[Array, "batch frame joint 3"]:
    """Other windows, each changed in its own way."""
    length, side, order, turn = jax.random.split(key, 4)
    parents, (left, right) = skeleton.parents, (np.array(skeleton.mirror, int).reshape(-1, 2)).T

    stretch = jnp.log1p(SPREAD) * jax.random.uniform(length, (len(clean), len(parents)), jnp.float32, -1, 1)
    stretch = jnp.exp(stretch.at[:, right].set(stretch[:, left]))
    up = np.array([joint if parent < 0 else parent for joint, parent in enumerate(parents)])
    roots = np.array(parents) < 0
    bones = jnp.where(roots[:, None], clean, stretch[:, None, :, None] * (clean - clean[:, :, up]))
    y = jnp.einsum("ja,btac->btjc", _ancestors(parents), bones)

    mirrored = y[:, :, np.array(skeleton.other_side)] * jnp.array([-1.0, 1, 1], y.dtype)
    y = jnp.where(jax.random.bernoulli(side, 0.5, (len(y), 1, 1, 1)), mirrored, y)
    y = jnp.where(jax.random.bernoulli(order, 0.5, (len(y), 1, 1, 1)), y[:, ::-1], y)
    angle = jax.random.uniform(turn, (len(y), 1, 1), jnp.float32, -TURN, TURN)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, height, z = jnp.moveaxis(y, -1, 0)
    return jnp.stack([cos * x + sin * z, height, cos * z - sin * x], -1)


def _ancestors(parents: tuple[int, ...]) -> np.ndarray:
    """(joint, joint) 1 where the second is the first or above it."""
    above = np.eye(len(parents), dtype=np.float32)
    for joint in range(len(parents)):
        up = parents[joint]
        while up >= 0:
            above[joint, up] = 1
            up = parents[up]
    return above
