"""EBF, the encoder-bidirectional-filter network (Mall et al., arXiv:1712.03380, 2017), for joint positions.

The network does not make positions, it makes filters: for each joint and frame weights of the 2r + 1 frames around,
which sum to one, applied to the input whose gaps are filled by straight lines in time,

    y_t = sum_k softmax(taps_t)_k x_{t+k},     k = -r .. r

The trunk is that of `bra` without batch normalisation, with ReLU. Mall's code is not public; Li et al. 2020 compare
with this network on positions, without (EBF) and with (EBF+B) the bone-length loss. It cannot place a joint that is
never observed: that stays at the mean pose.
"""

from __future__ import annotations

from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from motionrecover.refine.bra import WIDTHS
from motionrecover.refine.layers import BiLSTM, Linear, flat, interpolate

REACH = 10


class EBF(eqx.Module):
    """Motion (batch, frame, joint, 3), normalised, to clean motion of the same shape."""

    encoder: list[Linear]
    lstm1: BiLSTM
    lstm2: BiLSTM
    decoder: list[Linear]
    reach: int = eqx.field(static=True)
    """Frames r on either side."""

    @staticmethod
    def make(joints: int, rng: np.random.Generator, widths: tuple[int, ...] = WIDTHS, reach: int = REACH) -> EBF:
        """Drawn so that each joint's filter starts out near the sample itself."""
        inner = (3 * joints, *widths)
        outer = (*widths[::-1], joints * (2 * reach + 1))
        decoder = [Linear.make(*size, rng) for size in pairwise(outer)]
        start = np.zeros((joints, 2 * reach + 1), np.float32)
        start[:, reach] = 5.0
        decoder[-1] = Linear(decoder[-1].weight, jnp.asarray(start.reshape(-1)))
        return EBF(
            [Linear.make(*size, rng) for size in pairwise(inner)],
            BiLSTM.make(widths[-1], widths[-1] // 2, rng),
            BiLSTM.make(widths[-1], widths[-1] // 2, rng),
            decoder,
            reach,
        )

    def __call__(
        self,
        x: Float[Array, "batch frame joint 3"],
        observed: Bool[Array, "batch frame joint"],
        key: PRNGKeyArray | None = None,
    ) -> tuple[Float[Array, "batch frame joint 3"], EBF]:
        """The clean motion."""
        x = interpolate(x, observed)
        h = flat(x)
        for layer in self.encoder:
            h = jax.nn.relu(layer(h))
        h = self.lstm2(self.lstm1(h[None]))[0]
        for layer in self.decoder[:-1]:
            h = jax.nn.relu(layer(h))
        taps = jax.nn.softmax(self.decoder[-1](h).reshape(*x.shape[:3], -1), -1)
        padded = jnp.pad(x, ((0, 0), (self.reach, self.reach), (0, 0), (0, 0)), mode="edge")
        around = jnp.stack([padded[:, k : k + x.shape[1]] for k in range(2 * self.reach + 1)], -1)
        return jnp.einsum("btjck,btjk->btjc", around, taps), self
