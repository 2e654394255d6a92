"""Moving positions onto their bone lengths."""

import numpy as np
import pytest
from helpers import SKELETONS, clip, lengths_of
from scipy.optimize import minimize

from motionrecover.isometry.projection import project


def spread(joints, frames, seed=0):
    root = np.random.default_rng(seed).normal(size=(frames, joints, joints))
    return root @ root.transpose(0, 2, 1) + 0.1 * np.eye(joints)


@pytest.mark.parametrize("name", SKELETONS)
def test_bones_get_their_length(name):
    skeleton = SKELETONS[name]
    truth = clip(skeleton, 5)
    moved = truth + 0.02 * np.random.default_rng(1).normal(size=truth.shape)
    lengths = lengths_of(skeleton, truth)
    found = np.asarray(project(moved, spread(truth.shape[1], 5), lengths, skeleton.edges)[0])
    np.testing.assert_allclose(skeleton.bone_lengths_of(found), np.tile(lengths, (5, 1)), atol=1e-5)


def test_it_is_the_nearest_motion_in_the_measure_of_the_covariance():
    skeleton = SKELETONS["chain"]
    truth = clip(skeleton, 1)
    moved = truth + 0.01 * np.random.default_rng(1).normal(size=truth.shape)
    lengths, covariance = lengths_of(skeleton, truth), spread(5, 1)
    found = np.asarray(project(moved, covariance, lengths, skeleton.edges)[0])
    precision = np.linalg.inv(covariance[0])

    def distance(x):
        away = x.reshape(5, 3) - moved[0]
        return np.sum(away * (precision @ away)) * 1e4

    best = minimize(
        distance,
        moved.ravel(),
        method="SLSQP",
        constraints={"type": "eq", "fun": lambda x: skeleton.bone_lengths_of(x.reshape(1, 5, 3))[0] - lengths},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    # Linearised constraints: the two differ in second order of the centimetre moved.
    np.testing.assert_allclose(found[0], best.x.reshape(5, 3), atol=2e-4)


def test_certain_joints_stay():
    skeleton = SKELETONS["chain"]
    truth = clip(skeleton, 3)
    moved = truth.copy()
    moved[:, 2] += 0.02
    covariance = np.zeros((3, 5, 5))
    covariance[:, 2, 2] = 1.0
    found = np.asarray(project(moved, covariance, lengths_of(skeleton, truth), skeleton.edges)[0])
    np.testing.assert_array_equal(found[:, [0, 1, 3, 4]], moved[:, [0, 1, 3, 4]])
    np.testing.assert_allclose(found, truth, atol=0.05)
    np.testing.assert_allclose(skeleton.bone_lengths_of(found), skeleton.bone_lengths_of(truth), atol=1e-5)


def test_with_slack_lengths_that_contradict_each_other_move_nothing_far():
    rng = np.random.default_rng(5)
    truth = np.tile(rng.normal(scale=0.1, size=(6, 3)) * [1, 1, 0.01], (4, 1, 1))
    edges = tuple((i, j) for i in range(6) for j in range(i))
    lengths = np.array([np.linalg.norm(truth[0, i] - truth[0, j]) for i, j in edges]) + 0.002 * rng.normal(size=15)
    covariance = np.tile(1e-6 * np.eye(6), (4, 1, 1))
    found = np.asarray(project(truth, covariance, lengths, edges, np.full(15, 4e-6))[0])
    assert np.linalg.norm(found - truth, axis=-1).max() < 0.002
