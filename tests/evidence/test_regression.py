"""Regression of missing samples: the symmetries of its definition, exact cases, block formulas, variances."""

import numpy as np
import pytest
from helpers import TOLERANCE

from motionrecover import Skeleton, corrupt, synthesize
from motionrecover.evidence import regression
from motionrecover.evidence.pose_prior import blocks_of, leave_out
from motionrecover.evidence.regression import LEAST, bone_distance, predict_missing

MOTION = synthesize(2.5, 120, seed=3)
CLEAN, SKELETON = MOTION.positions, MOTION.skeleton
DISTANCE = bone_distance(SKELETON.edges, len(SKELETON.names))


def interpolated(positions, known):
    frames, guess = np.arange(len(positions)), positions.copy()
    for joint in range(positions.shape[1]):
        seen = known[:, joint]
        for axis in range(3):
            guess[~seen, joint, axis] = np.interp(frames[~seen], frames[seen], positions[seen, joint, axis])
    return guess


def with_gaps(positions, protocol, seed=0):
    """A first guess by interpolation, and what is known, after a protocol of `corrupt`."""
    known = np.isfinite(corrupt.apply(protocol, positions, seed)[0]).all(2)
    return interpolated(positions, known), known


def gap(frames, joints, joint, start, stop):
    known = np.ones((frames, joints), bool)
    known[start:stop, joint] = False
    return known


def errors(predictions, positions, known):
    return np.linalg.norm(predictions - positions, axis=-1)[~known]


def bodies(points, frames=200, seed=0):
    """A rigid motion of points (point, 3): rotations (frame, 3, 3), centres (frame, 3), positions."""
    t = np.linspace(0, 3, frames)
    axis = np.random.default_rng(seed).normal(size=3)
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turns = np.eye(3) + np.sin(t)[:, None, None] * cross + (1 - np.cos(t))[:, None, None] * (cross @ cross)
    centres = np.stack([t, 0.2 * np.sin(3 * t), 0.1 * t**2], 1)
    return turns, centres, points @ turns.transpose(0, 2, 1) + centres[:, None]


def test_bone_distance_counts_bones():
    # 5 is more than any way: another component.
    np.testing.assert_array_equal(bone_distance([(0, 1), (1, 2), (3, 4)], 5)[0], [0, 1, 2, 5, 5])


@pytest.fixture(scope="module")
def case():
    guess, known = with_gaps(CLEAN, "gap3x60", 1)
    return guess, known, *predict_missing(guess, known, DISTANCE)


def test_turned_moved_scaled(case):
    guess, known, predictions, variance = case
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    moved, scaled = predict_missing(1000 * (guess @ turn + [1, -2, 3]), known, DISTANCE)
    scale = np.abs(predictions).max()
    assert np.abs(moved / 1000 - [1, -2, 3] - predictions @ turn).max() < TOLERANCE["equivariance"] * scale
    np.testing.assert_allclose(scaled, 1e6 * variance, rtol=1e-4)


def test_joint_order(case):
    guess, known, predictions, variance = case
    order = np.random.default_rng(1).permutation(len(SKELETON.names))
    mixed, spread = predict_missing(guess[:, order], known[:, order], DISTANCE[np.ix_(order, order)])
    assert np.abs(mixed - predictions[:, order]).max() < TOLERANCE["equivariance"]
    np.testing.assert_allclose(spread, variance[:, order], rtol=1e-4)


def test_known_samples_are_untouched(case):
    guess, known, predictions, variance = case
    np.testing.assert_array_equal(predictions[known], guess[known])
    assert (variance[known] == 0).all()
    assert ((variance[~known] > 0) & np.isfinite(variance[~known])).all()


def test_only_what_is_asked_for(case):
    guess, known, predictions, variance = case
    joint = np.flatnonzero(~known.all(0))[0]
    only = np.zeros(known.shape, bool)
    only[:, joint] = True
    some, spread = predict_missing(guess, known, DISTANCE, only)
    np.testing.assert_array_equal(some[:, joint], predictions[:, joint])
    np.testing.assert_array_equal(np.delete(some, joint, 1), np.delete(guess, joint, 1))
    np.testing.assert_array_equal(spread[:, joint], variance[:, joint])
    assert np.isinf(spread[~known & ~only]).all()


def test_a_joint_of_a_rigid_body():
    points = np.random.default_rng(0).normal(scale=0.3, size=(4, 3))
    _, _, positions = bodies(points)
    known = gap(200, 4, 3, 60, 160)
    predictions, variance = predict_missing(interpolated(positions, known), known, np.ones((4, 4)))
    assert errors(predictions, positions, known).max() < 1e-4
    assert variance.max() < 1e-8


def test_a_joint_that_follows_a_hinge_linearly():
    turns, _, positions = bodies(np.random.default_rng(1).normal(scale=0.3, size=(5, 3)))
    bend = 0.1 * np.sin(np.linspace(0, 20, 200))
    positions[:, 3] += bend[:, None] * turns[:, :, 0]
    positions[:, 4] -= 0.5 * bend[:, None] * turns[:, :, 1]
    known = gap(200, 5, 4, 60, 140)
    predictions, _ = predict_missing(interpolated(positions, known), known, np.ones((5, 5)))
    assert errors(predictions, positions, known).mean() < 2e-3
    assert errors(interpolated(positions, known), positions, known).mean() > 2e-2


def test_left_out_blocks_are_those_of_a_fit_without_them():
    rng = np.random.default_rng(0)
    inputs, targets = rng.normal(size=(30, 4)), rng.normal(size=(30, 3))
    K = inputs @ inputs.T + 1 + 0.01 * np.eye(30)
    inverse, blocks = np.linalg.inv(K), [np.arange(8, 15), np.arange(3)]
    left_out = leave_out(inverse, inverse @ targets, blocks_of(blocks))
    for block, residuals, variances in zip(blocks, *left_out, strict=True):
        rest = np.setdiff1d(np.arange(30), block)
        gain = np.linalg.solve(K[np.ix_(rest, rest)], K[np.ix_(rest, block)]).T
        covariance = K[np.ix_(block, block)] - gain @ K[np.ix_(rest, block)]
        found, expected = residuals[: len(block)], targets[block] - gain @ targets[rest]
        np.testing.assert_allclose(found, expected, atol=TOLERANCE["linear solve"])
        np.testing.assert_allclose(variances[: len(block)], np.diag(covariance), rtol=TOLERANCE["linear solve"])
        assert not residuals[len(block) :].any()


@pytest.mark.parametrize(("fps", "protocol"), [(120, "gap3x60"), (30, "gap3x15"), (30, "gap6x40")])
def test_variances_are_those_of_the_errors(fps, protocol):
    ratios = []
    for seed in range(4):
        positions = synthesize(2.5 if fps == 120 else 8, fps, seed=seed).positions
        guess, known = with_gaps(positions, protocol, seed)
        predictions, variance = predict_missing(guess, known, DISTANCE)
        ratios.append(errors(predictions, positions, known) ** 2 / (3 * variance[~known]))
    assert 0.2 < np.median(np.concatenate(ratios)) < 2
    assert np.quantile(np.concatenate(ratios), 0.9) < 10


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_tiny_skeletons(joints):
    positions = bodies(np.random.default_rng(2).normal(scale=0.3, size=(joints, 3)))[2]
    known = gap(200, joints, 0, 90, 110)
    distance = bone_distance([(k, k + 1) for k in range(joints - 1)], joints)
    predictions, variance = predict_missing(interpolated(positions, known), known, distance)
    assert errors(predictions, positions, known).max() < 1e-3
    assert np.isfinite(variance).all()


def test_points_on_a_line_and_in_one_place():
    line = np.array([[0, 0, 0], [0, 0.1, 0], [0, 0.2, 0], [0, 0.3, 0]])
    for points in (line, 0 * line):
        positions = bodies(points)[2]
        known = gap(200, 4, 0, 90, 110)
        predictions, variance = predict_missing(interpolated(positions, known), known, np.ones((4, 4)))
        assert errors(predictions, positions, known).max() < 1e-3
        assert np.isfinite(variance).all()


def test_a_body_that_stands_still():
    positions = np.tile(CLEAN[0], (50, 1, 1))
    known = gap(50, len(SKELETON.names), 4, 10, 30)
    guess = np.where(known[..., None], positions, positions + 0.3)
    predictions, variance = predict_missing(guess, known, DISTANCE)
    assert errors(predictions, positions, known).max() < TOLERANCE["equivariance"]
    assert variance.max() < 1e-12


def test_too_few_known_samples_keep_their_guess():
    guess, known = CLEAN[:40].copy(), np.ones((40, len(SKELETON.names)), bool)
    known[:, 5], known[LEAST - 1 :, 6], known[10:20, 7] = False, False, False
    guess[:, 5] = 100.0
    predictions, variance = predict_missing(guess, known, DISTANCE)
    np.testing.assert_array_equal(predictions[:, 5:7], guess[:, 5:7])
    assert np.isinf(variance[:, 5]).all()
    assert np.isinf(variance[LEAST - 1 :, 6]).all()
    assert errors(predictions[:, 7:8], CLEAN[:40, 7:8], known[:, 7:8]).max() < 0.02  # not led astray by joint 5


def test_two_known_samples_are_enough_to_follow_the_body():
    known = np.ones((300, len(SKELETON.names)), bool)
    known[2:, SKELETON.names.index("head")] = False
    predictions, variance = predict_missing(interpolated(CLEAN, known), known, DISTANCE)
    assert errors(predictions, CLEAN, known).mean() < 0.1 * errors(interpolated(CLEAN, known), CLEAN, known).mean()
    assert np.isfinite(variance).all()


def test_long_clips_are_learnt_from_as_few_frames_as_short_ones(monkeypatch):
    positions = np.tile(CLEAN, (10, 1, 1))
    guess, known = with_gaps(positions, "gap2x240", 2)
    learnt, regress = [], regression._regress
    monkeypatch.setattr(
        regression, "_regress", lambda target, *rest: (learnt.append(len(target)), regress(target, *rest))[1]
    )
    predict_missing(guess, known, DISTANCE)
    assert len(learnt) == 2
    assert max(learnt) <= regression.TRAIN


def test_better_than_interpolation_on_a_recording(shared_data):
    names = Skeleton.standard("cmu25").names
    with np.load(shared_data / "cmu/npz/09_12.npz") as file:
        here = [list(file["names"]).index(name) for name in names]
        positions = file["positions"][:300, here].astype(float)
    guess, known = with_gaps(positions, "gap3x60", 0)
    predictions, _ = predict_missing(guess, known, bone_distance(Skeleton.standard("cmu25").edges, len(names)))
    assert 3 * errors(predictions, positions, known).mean() < errors(guess, positions, known).mean()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p, k, d: (p[..., :2], k, d), "(300, 25, 2)"),
        (lambda p, k, d: (p, k[:, 1:], d), "(300, 24)"),
        (lambda p, k, d: (p, k, d[1:]), "(24, 25)"),
        (lambda p, k, d: (np.where(k[..., None], p, np.nan), k, d), "first guess"),
    ],
)
def test_what_cannot_be_used_is_refused(case, change, words, refused):
    refused(lambda: predict_missing(*change(*case[:2], DISTANCE)), words, error=ValueError)
