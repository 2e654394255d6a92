"""BRA-P, the perceptual-based refinement network (Li et al., IEEE Access 8, 2020).

Two autoencoders of the architecture of `bra`, without batch normalisation and with dropout at the LSTMs:

    perceptual  Y = D_p(E_p(X)), trained first, on clean motion alone
    denoiser    X_R = D_d(E_d(X_N)), trained on noisy motion, with the hidden units E_p(X_R) compared to E_p(X_C)

The refined motion is Y_R = D_p(E_p(X_R)): the perceptual autoencoder passes over what the denoiser makes of the input.
BRA-P-D leaves that pass out, BRA-P(256) has two linear layers on either side instead of three.
"""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from motionrecover.refine.bra import BRA, WIDTHS

DROPOUT = 0.2


class BRAP(eqx.Module):
    """Motion (batch, frame, joint, 3), normalised, to clean motion of the same shape."""

    perceptual: BRA
    denoiser: BRA
    post_pass: bool = eqx.field(static=True)

    @staticmethod
    def make(
        joints: int,
        rng: np.random.Generator,
        widths: tuple[int, ...] = WIDTHS,
        post_pass: bool = True,
        dropout: float = DROPOUT,
    ) -> BRAP:
        """`post_pass`: whether the perceptual autoencoder passes over the denoiser's output."""
        perceptual, denoiser = (BRA.make(joints, rng, widths, normalised=False, dropout=dropout) for _ in range(2))
        return BRAP(perceptual, denoiser, post_pass)

    def denoise(
        self, x: Float[Array, "batch frame joint 3"], observed: Bool[Array, "batch frame joint"], key: PRNGKeyArray
    ) -> tuple[Float[Array, "batch frame joint 3"], BRAP]:
        """X_R, which the denoiser's losses are on."""
        y, denoiser = self.denoiser(x, observed, key)
        return y, replace(self, denoiser=denoiser)

    def reproduce(
        self, x: Float[Array, "batch frame joint 3"], key: PRNGKeyArray
    ) -> tuple[Float[Array, "batch frame joint 3"], BRAP]:
        """The perceptual autoencoder on clean motion, which its losses are on."""
        y, perceptual = self.perceptual(x, jnp.ones(x.shape[:3], bool), key)
        return y, replace(self, perceptual=perceptual)

    def perceive(self, x: Float[Array, "batch frame joint 3"]) -> Float[Array, "batch frame hidden"]:
        """E_p(X), hidden units without dropout."""
        return self.perceptual.encode(x)[0]

    def __call__(
        self,
        x: Float[Array, "batch frame joint 3"],
        observed: Bool[Array, "batch frame joint"],
        key: PRNGKeyArray | None = None,
    ) -> tuple[Float[Array, "batch frame joint 3"], BRAP]:
        """Y_R, or X_R without the post-pass."""
        y, denoiser = self.denoiser(x, observed, key)
        if self.post_pass:
            y, _ = self.perceptual(y, jnp.ones(observed.shape, bool))
        return y, replace(self, denoiser=denoiser)
