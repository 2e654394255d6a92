"""Corruption for training: its shares, its noise, and that it is drawn from the key alone."""

import jax
import numpy as np
import pytest

from motionrecover.refine.corruptions import PROTOCOLS, protocol

KEY = jax.random.key(3)
CLEAN = np.asarray(jax.random.normal(KEY, (64, 64, 21, 3), "float32"))
MEAN = np.zeros((21, 3), np.float32)


def corrupted(name, key=KEY):
    noisy, observed = jax.jit(protocol(name))(key, CLEAN, MEAN)
    return np.asarray(noisy), np.asarray(observed)


def test_shares_and_noise_are_those_of_the_name():
    noisy, observed = corrupted("choi-missing40")
    assert abs(observed.mean() - 0.6) < 0.005
    assert (noisy == CLEAN).all()
    noisy, observed = corrupted("choi-missing20-noise3")
    assert abs(observed.mean() - 0.8) < 0.005
    assert abs((noisy - CLEAN).std() - 0.03) < 1e-3
    _, observed = corrupted("choi-joints2")
    assert (observed.any(1) == observed.all(1)).all()
    assert ((~observed.any(1)).sum(-1) == 2).all()


def test_li_mixed_has_four_kinds_of_clips():
    noisy, observed = corrupted("li-mixed")
    ratio = 10 * np.log10((CLEAN**2).mean((1, 2, 3)) / ((noisy - CLEAN) ** 2).mean((1, 2, 3)))
    seen = observed.mean((1, 2))
    found = {(round(float(db)), round(float(share), 1)) for db, share in zip(ratio, seen, strict=True)}
    assert found == {(1, 1.0), (5, 1.0), (15, 0.7), (15, 0.6)}


def test_mixed_has_clean_clips_gaps_whole_joints_and_noise():
    noisy, observed = corrupted("mixed")
    sigma = (noisy - CLEAN).std((1, 2, 3))
    assert 0.2 < (sigma < 1e-7).mean() < 0.8
    assert sigma.max() < 0.031
    lost = (~observed.any(1)).sum(-1)
    assert 0.2 < (lost > 0).mean() < 0.8
    assert (~observed).mean((1, 2)).max() < 0.8


@pytest.mark.parametrize("name", PROTOCOLS)
def test_the_key_is_all_there_is(name):
    one, again, other = corrupted(name), corrupted(name), corrupted(name, jax.random.key(4))
    assert (one[0] == again[0]).all()
    assert (one[1] == again[1]).all()
    assert (one[1] != other[1]).any()


@pytest.mark.parametrize("name", ["choi", "choi-missing140", "choi-missing40-noise", "missing40"])
def test_unknown_protocols_are_refused(name, refused):
    refused(lambda: protocol(name), repr(name), "choi-missing40", error=ValueError)
