"""CNN, the convolutional autoencoder of Holden et al., ACM TOG 35(4), 2016, and its answer moved onto bone lengths.

    H = pool(relu(x * W0 + b0)),       y = unpool(H) * W1 + b1

with 256 filters of 25 frames, maxima of two frames, and each hidden frame repeated twice. (The network of Holden's
2015 brief has three such layers; 807k, which Choi et al. 2024 print, is this one: 806,719.)

`CNN+constraint` moves the hidden units until the bones of y have the lengths l_b that the input shows (Sec. 7 of the
paper, its bone-length term): H <- argmin sum_b mean_t (|y_i - y_j| - l_b)^2, by `STEPS` steps of Adam, so that the
answer stays among the motions the decoder can make. The paper's terms for feet and trajectory need contacts and a path,
which input with missing joints does not tell.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from motionrecover.refine.layers import blank, flat, uniform

FILTERS, WIDTH = 256, 25
STEPS, RATE = 40, 0.02


class CNN(eqx.Module):
    """Motion (batch, frame, joint, 3), normalised, to clean motion of the same shape."""

    encoder: Float[Array, "width channel filter"]
    encoder_bias: Float[Array, " filter"]
    decoder: Float[Array, "width filter channel"]
    decoder_bias: Float[Array, " channel"]
    constrained: tuple[tuple[int, int], ...] = eqx.field(static=True)
    """Bones that `constrain` moves the answer onto; none for the CNN by itself."""

    @staticmethod
    def make(
        joints: int,
        rng: np.random.Generator,
        filters: int = FILTERS,
        width: int = WIDTH,
        constrained: tuple[tuple[int, int], ...] = (),
    ) -> CNN:
        """Drawn as Glorot & Bengio (2010) do."""
        channels = 3 * joints
        bound = np.sqrt(6 / (width * (channels + filters)))
        return CNN(
            uniform(rng, (width, channels, filters), bound),
            uniform(rng, (filters,), 0),
            uniform(rng, (width, filters, channels), bound),
            uniform(rng, (channels,), 0),
            constrained,
        )

    def encode(self, x: Float[Array, "batch frame channel"]) -> Float[Array, "batch half filter"]:
        """H; an odd last frame is pooled alone."""
        h = jax.nn.relu(_convolve(x, self.encoder) + self.encoder_bias)
        return jax.lax.reduce_window(h, -jnp.inf, jax.lax.max, (1, 2, 1), (1, 2, 1), "SAME")

    def decode(self, h: Float[Array, "batch half filter"], frames: int) -> Float[Array, "batch frame channel"]:
        """y."""
        return _convolve(jnp.repeat(h, 2, axis=1)[:, :frames], self.decoder) + self.decoder_bias

    def __call__(
        self,
        x: Float[Array, "batch frame joint 3"],
        observed: Bool[Array, "batch frame joint"],
        key: PRNGKeyArray | None = None,
    ) -> tuple[Float[Array, "batch frame joint 3"], CNN]:
        """The clean motion; the mask only says which samples are blanked."""
        h = self.encode(flat(blank(x, observed)))
        return self.decode(h, x.shape[1]).reshape(x.shape), self

    def constrain(
        self,
        x: Float[Array, "batch frame joint 3"],
        observed: Bool[Array, "batch frame joint"],
        metres: Callable[[Array], Array],
    ) -> Float[Array, "batch frame joint 3"]:
        """The clean motion with the bones `constrained` at the mean length that is observed; those never seen are free.

        `metres` makes positions of normalised motion.
        """
        import optax

        adam, (i, j) = optax.adam(RATE), jnp.array(self.constrained).T
        known = (observed[:, :, i] & observed[:, :, j]).astype(x.dtype)
        count = known.sum(1)
        wanted = (_lengths(metres(blank(x, observed)), i, j) * known).sum(1) / jnp.maximum(count, 1)

        def answer(h):
            return self.decode(h, x.shape[1]).reshape(x.shape)

        def cost(h):
            off = _lengths(metres(answer(h)), i, j) - wanted[:, None]
            return (jnp.where(count[:, None] > 0, off, 0) ** 2).mean(1).sum()

        def step(state, _):
            h, moments = state
            updates, moments = adam.update(jax.grad(cost)(h), moments)
            return (h + updates, moments), None

        h = self.encode(flat(blank(x, observed)))
        return answer(jax.lax.scan(step, (h, adam.init(h)), length=STEPS)[0][0])


def _convolve(x: Array, kernel: Array) -> Array:
    return jax.lax.conv_general_dilated(x, kernel, (1,), "SAME", dimension_numbers=("NWC", "WIO", "NWC"))


def _lengths(x: Array, i: Array, j: Array) -> Array:
    return jnp.sqrt(((x[:, :, i] - x[:, :, j]) ** 2).sum(-1) + 1e-12)
