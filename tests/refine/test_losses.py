"""The losses against their printed equations."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers import TOLERANCE

from motionrecover.refine import losses

RNG = np.random.default_rng(0)
Y, X = RNG.normal(size=(2, 3, 5, 4, 3))
BONES = ((0, 1), (1, 2), (2, 3))


def test_terms_are_their_equations():
    norms = [np.linalg.norm(y - x) for y, x in zip(Y, X, strict=True)]
    np.testing.assert_allclose(losses.position(Y, X), np.mean((Y - X) ** 2))
    np.testing.assert_allclose(losses.distance(Y, X), np.linalg.norm(Y - X, axis=-1).mean())
    np.testing.assert_allclose(losses.reproduction(Y, X), np.mean(norms) / (5 * 12))
    h, k = RNG.normal(size=(2, 3, 5, 7))
    np.testing.assert_allclose(losses.perceptual(h, k), np.mean(np.linalg.norm(h - k, axis=(1, 2))) / (5 * 7))


def test_smoothness_is_the_product_with_the_matrix_of_equation_5():
    o = np.diag(np.full(7, -2.0)) + np.diag(np.ones(6), 1) + np.diag(np.ones(6), -1)
    o[0, 0] = o[-1, -1] = -1
    repeated = np.concatenate([Y[:, :1], Y, Y[:, -1:]], 1).reshape(3, 7, 12)
    expected = np.mean([np.linalg.norm(o @ clip) for clip in repeated]) / 7
    np.testing.assert_allclose(losses.smooth(Y), expected)
    assert losses.smooth(np.ones_like(Y)) < TOLERANCE["network"]


def test_bone_loss_is_zero_for_rigid_motion_and_by_its_equation_else():
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    assert losses.bone(X @ turn + 3.0, X, BONES) < TOLERANCE["network"]
    lengths = [[np.linalg.norm(clip[:, i] - clip[:, j], axis=-1) for i, j in BONES] for clip in (*Y, *X)]
    np.testing.assert_allclose(losses.bone(Y, X, BONES), np.abs(np.subtract(lengths[:3], lengths[3:])).mean())


def test_clean_motion_loses_nothing_and_gradients_are_finite_there():
    for terms in (losses.choi, losses.li):
        total = lambda y, terms=terms: sum(terms(y, X, (y, X), BONES).values())  # noqa: E731
        assert jnp.isfinite(jax.grad(total)(jnp.array(X))).all()
        assert jnp.isfinite(jax.grad(total)(jnp.zeros_like(X))).all()
        found = terms(X, X, (X, X), BONES)
        assert found["position"] < TOLERANCE["network"]
        assert found["bone"] == 0


def test_lis_smoothness_is_by_channel():
    assert losses.li(Y, X, (Y, X), BONES)["smooth"] * 12 == losses.choi(Y, X, (Y, X), BONES)["smooth"]
