"""The wavelet transform: orthogonal at every length, equal to PyWavelets where PyWavelets is, blind to padding."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import pywt
from helpers import TOLERANCE
from hypothesis import given, settings
from hypothesis import strategies as st

from motionrecover.wavelets import filters, levels, wavedec, waverec

FAMILIES = [w for w in pywt.wavelist(kind="discrete") if pywt.Wavelet(w).orthogonal and w != "dmey"]
SOME = ["haar", "db2", "db10", "sym5", "coif3"]


decompose = jax.jit(wavedec, static_argnums=(1, 2))
reconstruct = jax.jit(waverec, static_argnums=(1, 2, 3))


def matrix(wavelet, level, length, stored):
    """W (coefficient, frame) for signals of `length` frames stored in `stored`, by applying it to unit vectors."""
    basis = np.pad(np.eye(stored)[:length], ((0, stored - length), (0, 0)))  # one shape, one program for every length
    return np.asarray(decompose(jnp.asarray(basis), wavelet, level, length)).T[:, :length]


@pytest.mark.parametrize("wavelet", FAMILIES)
def test_every_orthogonal_family_is_orthogonal_both_ways(wavelet):
    w = matrix(wavelet, 1, 48, 48)
    assert w.shape == (48, 48)
    np.testing.assert_allclose(w @ w.T, np.eye(48), atol=TOLERANCE["orthogonality"])
    np.testing.assert_allclose(w.T @ w, np.eye(48), atol=TOLERANCE["orthogonality"])


@pytest.mark.parametrize("wavelet", SOME)
@pytest.mark.parametrize("level", [0, 1, 2, 4])
def test_every_length_is_orthogonal_and_inverted_by_its_transpose(wavelet, level):
    for length in (1, 2, 3, 5, 8, 16, 31, 37, 63, 64):
        w = matrix(wavelet, level, length, 64)
        np.testing.assert_allclose(w.T @ w, np.eye(length), atol=TOLERANCE["orthogonality"])
        used = np.abs(w).sum(1) > 0
        assert used.sum() == length
        rows = np.asarray(reconstruct(jnp.eye(64), 64, wavelet, level, length))
        np.testing.assert_allclose(rows[used, :length], w[used], atol=TOLERANCE["orthogonality"])


@pytest.mark.parametrize("length", [1, 3, 13])
def test_odd_stored_lengths(length):
    w = np.asarray(wavedec(jnp.eye(length), "db2", 2)).T
    np.testing.assert_allclose(w.T @ w, np.eye(length), atol=TOLERANCE["orthogonality"])
    np.testing.assert_allclose(waverec(jnp.asarray(w.T), length, "db2", 2), np.eye(length), atol=1e-12)


@pytest.mark.parametrize("wavelet", [*SOME, "db38", "sym20"])
@pytest.mark.parametrize("level", [1, 2, 3])
def test_equals_pywavelets_where_pywavelets_is_orthogonal(wavelet, level):
    x = np.random.default_rng(0).normal(size=(2, 64))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # "all coefficients will experience boundary effects"
        expected = np.concatenate(pywt.wavedec(x, wavelet, mode="periodization", level=level), -1)
    np.testing.assert_allclose(decompose(jnp.asarray(x), wavelet, level), expected, atol=1e-10)


@settings(max_examples=40)
@given(frames=st.integers(1, 48), wavelet=st.sampled_from(["haar", "db10"]), seed=st.integers(0, 99))
def test_what_stands_in_the_padding_counts_for_nothing(frames, wavelet, seed):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=48)
    clean, dirty = np.where(np.arange(48) < frames, x, 0), np.where(np.arange(48) < frames, x, rng.normal(size=48))
    coefficients = decompose(jnp.asarray(clean), wavelet, 2, frames)
    assert (coefficients == decompose(jnp.asarray(dirty), wavelet, 2, frames)).all()
    back = np.asarray(reconstruct(coefficients, 48, wavelet, 2, frames))
    np.testing.assert_allclose(back, clean, atol=TOLERANCE["orthogonality"] * 10)
    assert (back[frames:] == 0).all()


@pytest.mark.parametrize(("length", "stored"), [(16, 17), (16, 40), (24, 64)])
def test_padding_is_no_part_of_the_transform(length, stored):
    """The coefficients of the valid frames are those of the transform that knows no padding."""
    x = np.random.default_rng(0).normal(size=length)
    exact = np.split(np.asarray(wavedec(jnp.asarray(x), "db4", 2)), [length // 4, length // 2])
    padded = np.asarray(wavedec(jnp.asarray(np.pad(x, (0, stored - length))), "db4", 2, length))
    first, second = levels(stored, 2)
    parts = np.split(padded, [second, 2 * second])
    assert len(parts[2]) == first
    for part, expected in zip(parts, exact, strict=True):
        np.testing.assert_allclose(part[: len(expected)], expected, atol=TOLERANCE["orthogonality"])
        assert (part[len(expected) :] == 0).all()


def test_smooth_signal_has_sparse_details():
    x = np.linspace(-1, 1, 64) ** 2
    details = np.abs(np.asarray(wavedec(jnp.asarray(x), "db4", 2)))[16:]
    assert (details > 1e-9).sum() < 12  # only around the two ends, where the period jumps


@pytest.mark.parametrize("wavelet", ["bior4.4", "dmey", "no such wavelet"])
def test_refuses_what_is_not_orthogonal(wavelet):
    with pytest.raises(ValueError, match=wavelet):
        filters(wavelet)
