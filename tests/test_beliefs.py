"""Beliefs about intact samples against summing over every possibility."""

from itertools import product

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import TREES

from motionrecover.solver.beliefs import beliefs


@pytest.mark.parametrize("name", ["bone", "chain", "chain upwards", "star"])
def test_beliefs_are_exact_on_trees(name):
    skeleton, rng = TREES[name], np.random.default_rng(0)
    joints = len(skeleton.names)
    alone, together = rng.normal(scale=3, size=(4, joints)), rng.normal(scale=5, size=(4, len(skeleton.edges)))
    found = beliefs(jnp.asarray(alone), jnp.asarray(together), skeleton.edges)
    states = np.array(list(product([0, 1], repeat=joints)))
    both = np.stack([states[:, i] * states[:, j] for i, j in skeleton.edges], -1)
    level = alone @ states.T + together @ both.T
    weight = np.exp(level - level.max(1, keepdims=True))
    intact = weight @ states / weight.sum(1, keepdims=True)
    np.testing.assert_allclose(1 / (1 + np.exp(-np.asarray(found))), intact, atol=1e-10)


def test_without_bones_each_sample_stands_alone():
    alone = np.random.default_rng(0).normal(size=(3, 2))
    np.testing.assert_array_equal(beliefs(alone, np.zeros((3, 0)), ()), alone)
