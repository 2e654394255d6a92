"""The missing-marker networks of Kucherenko & Kjellstrom (arXiv:1803.02665, 2018), which STR's Table V has.

Missing markers are 0. `WindowNet` sees ten frames at once through one hidden layer of 1024 units, tanh after both
layers; a clip is its groups of ten frames, the last one completed by missing frames. `LSTMNet` is an LSTM of 2048 units
followed by one as wide as a pose, whose output is the pose; it runs forward in time only. In training both drop a tenth
of their units and add noise of 0.05 of the data's spread to the input. (Sizes: the authors' public settings.)

The last tanh cannot leave [-1, 1], where their data lies. So does motion that is divided by its largest coordinate.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from motionrecover.refine.layers import LSTM, Linear, blank, dropout, flat

DROPOUT = 0.1
NOISE = 0.05


class WindowNet(eqx.Module):
    """Motion (batch, frame, joint, 3), normalised, to clean motion of the same shape."""

    hidden: Linear
    output: Linear
    window: int = eqx.field(static=True)
    noise: float = eqx.field(static=True)
    dropout: float = eqx.field(static=True)

    @staticmethod
    def make(
        joints: int,
        rng: np.random.Generator,
        width: int = 1024,
        window: int = 10,
        spread: float = 0.2,
        dropout: float = DROPOUT,
    ) -> WindowNet:
        """`spread` of the data, which the noise is a share of."""
        size = 3 * joints * window
        layers = Linear.make(size, width, rng), Linear.make(width, size, rng)
        return WindowNet(*layers, window, NOISE * spread, dropout)

    def __call__(
        self,
        x: Float[Array, "batch frame joint 3"],
        observed: Bool[Array, "batch frame joint"],
        key: PRNGKeyArray | None = None,
    ) -> tuple[Float[Array, "batch frame joint 3"], WindowNet]:
        """The clean motion; the mask only says which samples are blanked."""
        keys = (None,) * 3 if key is None else jax.random.split(key, 3)
        batch, frames = x.shape[:2]
        h = flat(blank(_noisy(x, self.noise, keys[0]), observed))
        h = jnp.pad(h, ((0, 0), (0, -frames % self.window), (0, 0))).reshape(batch, -1, self.hidden.weight.shape[0])
        h = jnp.tanh(self.hidden(dropout(h, self.dropout, keys[1])))
        y = jnp.tanh(self.output(dropout(h, self.dropout, keys[2])))
        return y.reshape(batch, -1, *x.shape[2:])[:, :frames], self


class LSTMNet(eqx.Module):
    """Motion (batch, frame, joint, 3), normalised, to clean motion of the same shape."""

    hidden: LSTM
    output: LSTM
    noise: float = eqx.field(static=True)
    dropout: float = eqx.field(static=True)

    @staticmethod
    def make(
        joints: int, rng: np.random.Generator, width: int = 2048, spread: float = 0.2, dropout: float = DROPOUT
    ) -> LSTMNet:
        """`spread` of the data, which the noise is a share of."""
        size = 3 * joints
        return LSTMNet(LSTM.make(size, width, rng), LSTM.make(width, size, rng), NOISE * spread, dropout)

    def __call__(
        self,
        x: Float[Array, "batch frame joint 3"],
        observed: Bool[Array, "batch frame joint"],
        key: PRNGKeyArray | None = None,
    ) -> tuple[Float[Array, "batch frame joint 3"], LSTMNet]:
        """The clean motion; the mask only says which samples are blanked."""
        keys = (None, None) if key is None else jax.random.split(key)
        h = self.hidden(flat(blank(_noisy(x, self.noise, keys[0]), observed)))
        return self.output(dropout(h, self.dropout, keys[1])).reshape(x.shape), self


def _noisy(x: Array, sigma: float, key: PRNGKeyArray | None) -> Array:
    return x if key is None else x + sigma * jax.random.normal(key, x.shape, x.dtype)
