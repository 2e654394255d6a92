"""The joint smoother against the normal distribution that it is the posterior of."""

import jax
import numpy as np
import pytest
from helpers import TOLERANCE

from motionrecover.solver.kalman import SPEED, smooth, smooth_each

START = 3.0


def case(frames, joints, seed=0):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(joints, joints))
    drive = 0.01 * (root @ root.T + 0.1 * np.eye(joints))
    samples = np.cumsum(np.cumsum(rng.normal(scale=0.1, size=(frames, joints, 3)), 0), 0)
    noise = 10.0 ** rng.uniform(-3, 1, (frames, joints))
    return samples, noise, drive, np.exp(rng.normal(size=frames))


def posterior(samples, noise, drive, activity, start=START):
    """Mean (frame, joint, 3) and covariance (frame joint, frame joint) by solving for all frames at once."""
    frames, joints, _ = samples.shape
    size = (frames + 1) * joints  # one frame before the first
    precision, linear = np.zeros((size, size)), np.zeros((size, 3))
    part = [slice(t * joints, (t + 1) * joints) for t in range(frames + 1)]
    # z = (x_0, x_-1) before the first sample
    precision[part[1], part[1]] += np.eye(joints) / start
    linear[part[1]] += samples[0] / start
    step = np.zeros((joints, size))
    step[:, part[0]], step[:, part[1]] = -np.eye(joints), np.eye(joints)
    precision += step.T @ step / (start * SPEED**2)
    for t in range(2, frames + 1):
        difference = np.zeros((joints, size))
        difference[:, part[t]], difference[:, part[t - 2]] = np.eye(joints), np.eye(joints)
        difference[:, part[t - 1]] = -2 * np.eye(joints)
        precision += difference.T @ np.linalg.solve(activity[t - 1] * drive, difference)
    for t in range(frames):
        precision[part[t + 1], part[t + 1]] += np.diag(1 / noise[t])
        linear[part[t + 1]] += samples[t] / noise[t][:, None]
    covariance = np.linalg.inv(precision)
    return (covariance @ linear)[joints:].reshape(frames, joints, 3), covariance[joints:, joints:]


@pytest.mark.parametrize(("frames", "joints"), [(1, 2), (2, 1), (3, 3), (12, 4)])
def test_smooth_is_the_posterior(frames, joints):
    arguments = case(frames, joints)
    found = jax.jit(smooth)(*arguments, START)
    mean, covariance = posterior(*arguments)
    np.testing.assert_allclose(found.mean, mean, atol=TOLERANCE["posterior"])
    blocks = covariance.reshape(frames, joints, frames, joints)
    same = np.stack([blocks[t, :, t] for t in range(frames)])
    np.testing.assert_allclose(found.covariance, same, atol=TOLERANCE["posterior"])


def test_a_joint_unseen_for_long_at_the_start_keeps_its_variance():
    samples, _, drive, activity = case(110, 3)
    noise = np.full((110, 3), 2.6e-8)
    noise[:100, 1] = 1e10
    found = jax.jit(smooth)(samples, noise, 1e-5 * drive, activity, 0.16)
    _, covariance = posterior(samples, noise, 1e-5 * drive, activity, 0.16)
    variance = np.einsum("tjj->tj", found.covariance)
    assert variance.min() > 0
    np.testing.assert_allclose(variance, np.diag(covariance).reshape(110, 3), rtol=1e-3, atol=1e-6)


def test_joint_by_joint_is_the_same_where_the_drive_is_diagonal():
    samples, noise, drive, activity = case(12, 4)
    one, other = (jax.jit(f)(samples, noise, np.diag(np.diag(drive)), activity, START) for f in (smooth, smooth_each))
    for name, value in vars(one).items():
        expected = np.asarray(value)
        if name == "information":
            expected = expected * np.eye(4)
        np.testing.assert_allclose(getattr(other, name), expected, atol=TOLERANCE["posterior"])


def test_error_is_what_is_left_without_the_sample():
    samples, noise, drive, activity = case(8, 3)
    found = jax.jit(smooth)(samples, noise, drive, activity, START)
    # The first frame also says where the clip starts, so it cannot be left out alone.
    for t, j in [(1, 0), (4, 2), (7, 1)]:
        without = noise.copy()
        without[t, j] = 1e9
        mean, covariance = posterior(samples, without, drive, activity)
        at = t * 3 + j
        np.testing.assert_allclose(found.error[t, j], samples[t, j] - mean[t, j], rtol=1e-5)
        np.testing.assert_allclose(found.error_variance[t, j], covariance[at, at] + noise[t, j], rtol=1e-5)


def test_score_is_the_slope_of_the_likelihood_in_the_drive():
    """d log p(y) / dQ = sum_t a_t (g g^T - 3 G) / 2 over the frames that are driven, by finite differences."""
    samples, noise, drive, activity = case(9, 2)

    def likelihood(q):
        """log p(y): the prior of all frames, plus the noise, is normal."""
        big = posterior_prior(q, activity)
        total = big + np.diag(noise.ravel())
        away = (samples - samples[0]).reshape(-1, 3)
        return -1.5 * np.linalg.slogdet(total)[1] - 0.5 * np.sum(away * np.linalg.solve(total, away))

    def posterior_prior(q, a):
        """Covariance of (frame joint) around the first sample."""
        frames, joints = noise.shape
        eye = np.eye(joints)
        rows = [np.concatenate([eye, 0 * eye, *[0 * eye] * (frames - 1)], 1)]  # x_0 of (x_0, x_-1, w_1, ...)
        before = np.concatenate([eye, eye, *[0 * eye] * (frames - 1)], 1)
        for t in range(1, frames):
            drive_row = np.concatenate([eye * (k == t + 1) for k in range(frames + 1)], 1)
            rows.append(2 * rows[-1] - before + drive_row)
            before = rows[-2]
        cause = np.kron(np.diag([START, START * SPEED**2] + [0] * (frames - 1)), eye)
        for t in range(1, frames):
            part = slice((t + 1) * joints, (t + 2) * joints)
            cause[part, part] = a[t] * q
        rows = np.concatenate(rows)
        return rows @ cause @ rows.T

    found = jax.jit(smooth)(samples, noise, drive, activity, START)
    weight = activity[1:, None, None]
    score, information = np.asarray(found.score)[1:], np.asarray(found.information)[1:]
    slope = ((score @ score.transpose(0, 2, 1) - 3 * information) * weight).sum(0) / 2
    step = 1e-6 * np.array([[1.0, 0.5], [0.5, -0.3]])
    measured = (likelihood(drive + step) - likelihood(drive - step)) / 2
    np.testing.assert_allclose(np.sum(slope * step), measured, rtol=1e-4)
