"""Proximal operators against the minimisation that defines them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import TOLERANCE
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize, minimize_scalar

from motionrecover.prox import singular_value_threshold, soft_threshold


@given(x=st.floats(-5, 5), threshold=st.floats(0, 3))
def test_soft_threshold_minimises_its_definition(x, threshold):
    found = minimize_scalar(lambda y: threshold * abs(y) + (y - x) ** 2 / 2, bounds=(-6, 6), method="bounded")
    at = float(soft_threshold(jnp.asarray(x), threshold))
    assert threshold * abs(at) + (at - x) ** 2 / 2 <= found.fun + TOLERANCE["brute force"]


def matrix_of(x):
    """(joint, component, frame) as the papers' 3T x S matrix."""
    return np.asarray(x).transpose(2, 1, 0).reshape(-1, len(x))


def by_svd(x, threshold):
    u, s, vt = np.linalg.svd(matrix_of(x).astype(float), full_matrices=False)
    frames = ((u * np.maximum(s - threshold, 0)) @ vt).reshape(-1, x.shape[1], len(x))
    return frames.transpose(2, 1, 0), np.sort(s)


@pytest.mark.parametrize("threshold", [0.0, 0.3, 5.0, 1e3])
@pytest.mark.parametrize("rank", [1, 4, 6])
def test_singular_value_threshold_equals_svd(rank, threshold):
    rng = np.random.default_rng(rank)
    x = np.einsum("sr,rct->sct", rng.normal(size=(6, rank)), rng.normal(size=(rank, 3, 50)))
    expected, values = by_svd(x, threshold)
    found, found_values = singular_value_threshold(jnp.asarray(x), threshold)
    scale = values[-1]
    np.testing.assert_allclose(found, expected, atol=TOLERANCE["svd"] * scale)
    # Zero singular values come out as the square root of rounding: 1e-8 of the largest.
    np.testing.assert_allclose(found_values, values, atol=1e-7 * scale)


@pytest.mark.parametrize("x64", [True, False])
def test_singular_value_threshold_in_float32(x64):
    # Spread over five decades, as in a long take: the smallest values are lost to a float32 Gram matrix.
    rng = np.random.default_rng(0)
    x = rng.normal(size=(8, 3, 400)) * np.geomspace(1, 1e-5, 8)[:, None, None]
    x = np.asarray(np.einsum("ij,jct->ict", np.linalg.qr(rng.normal(size=(8, 8)))[0], x), np.float32)
    threshold = 1e-3
    expected, values = by_svd(x, threshold)
    with jax.enable_x64(x64):
        found, _ = singular_value_threshold(jnp.asarray(x), jnp.float32(threshold))
    assert found.dtype == np.float32
    error = np.linalg.norm(np.asarray(found) - expected)
    if x64:
        assert error < TOLERANCE["svd float32"] * values[-1]
    else:
        assert error < 8 * threshold
        assert error < TOLERANCE["svd float32 alone"] * values[-1]


def test_singular_value_threshold_minimises_its_definition():
    rng = np.random.default_rng(3)
    x, threshold = rng.normal(size=(2, 3, 2)), 0.7

    def definition(y):
        return threshold * np.linalg.norm(matrix_of(y), "nuc") + ((y - x) ** 2).sum() / 2

    start = minimize(lambda y: definition(y.reshape(x.shape)), x.ravel(), method="Powell", tol=1e-10)
    found, _ = singular_value_threshold(jnp.asarray(x), threshold)
    assert definition(np.asarray(found)) <= start.fun + TOLERANCE["brute force"]
