"""BRA, the bidirectional recurrent autoencoder (Li et al., Computers & Graphics 81, 2019; BRA-P paper, Eqs. 1-2).

    H = BiLSTM1(W3(W2(W1 x))),      y = W6(W5(W4 BiLSTM2(H)))

Layers are linear, with biases. Choi et al. 2024 compare with BRA of 3,502k numbers: that has batch normalisation after
every linear layer (3,501,757; without, 3,499,071, which BRA-P is made of). EBD is the same network, trained on the
position alone.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from motionrecover.refine.layers import BatchNorm, BiLSTM, Linear, blank, dropout, flat

WIDTHS = (128, 256, 512)
"""Of the linear layers; the last is also the hidden units', half of it a direction."""


class BRA(eqx.Module):
    """Motion (batch, frame, joint, 3), normalised, to clean motion of the same shape."""

    encoder: list[Linear]
    encoder_norms: list[BatchNorm]
    lstm1: BiLSTM
    lstm2: BiLSTM
    decoder: list[Linear]
    decoder_norms: list[BatchNorm]
    dropout: float = eqx.field(static=True)

    @staticmethod
    def make(
        joints: int,
        rng: np.random.Generator,
        widths: tuple[int, ...] = WIDTHS,
        normalised: bool = True,
        dropout: float = 0.0,
        spread: float = 0.2,
    ) -> BRA:
        """`normalised`: batch normalisation after every linear layer, the last one scaled to the targets' `spread`."""
        sizes = (3 * joints, *widths)
        ends = list(pairwise(sizes))
        decoder = [(out, inner) for inner, out in reversed(ends)]
        norms = normalised * len(ends)
        return BRA(
            [Linear.make(*size, rng) for size in ends],
            [BatchNorm.make(width) for width in sizes[1 : 1 + norms]],
            BiLSTM.make(widths[-1], widths[-1] // 2, rng),
            BiLSTM.make(widths[-1], widths[-1] // 2, rng),
            [Linear.make(*size, rng) for size in decoder],
            [BatchNorm.make(out, scale=1.0 if k + 1 < norms else spread) for k, (_, out) in enumerate(decoder[:norms])],
            dropout,
        )

    def encode(
        self, x: Float[Array, "batch frame joint 3"], key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, "batch frame hidden"], BRA]:
        """The hidden units H of complete motion."""
        h, norms = _through(self.encoder, self.encoder_norms, flat(x), key is not None)
        h = self.lstm1(dropout(h, self.dropout, key)[None])[0]
        return h, replace(self, encoder_norms=norms)

    def __call__(
        self,
        x: Float[Array, "batch frame joint 3"],
        observed: Bool[Array, "batch frame joint"],
        key: PRNGKeyArray | None = None,
    ) -> tuple[Float[Array, "batch frame joint 3"], BRA]:
        """The clean motion; the mask only says which samples are blanked."""
        keys = (None, None) if key is None else jax.random.split(key)
        h, new = self.encode(blank(x, observed), keys[0])
        h = self.lstm2(dropout(h, self.dropout, keys[1])[None])[0]
        y, norms = _through(self.decoder, self.decoder_norms, h, key is not None)
        return y.reshape(x.shape), replace(new, decoder_norms=norms)


def _through(layers: list[Linear], norms: list[BatchNorm], x: Array, training: bool) -> tuple[Array, list[BatchNorm]]:
    new = []
    for k, layer in enumerate(layers):
        x = layer(x)
        if norms:
            x, norm = norms[k](x, training)
            new.append(norm)
    return x, new
