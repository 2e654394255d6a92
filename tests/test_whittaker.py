"""Whittaker's smoother is the minimum of its objective."""

import numpy as np
import pytest
from helpers import TOLERANCE

from motionrecover.whittaker import whittaker


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 12])
def test_it_is_the_minimum(frames, order):
    rng = np.random.default_rng(frames)
    positions, variance, drive = rng.normal(size=(frames, 2, 3)), rng.uniform(0.1, 9, (frames, 2)), np.ones((frames, 2))
    drive[order:] = rng.uniform(0.1, 2, (max(frames - order, 0), 2))
    found = whittaker(positions, variance, drive, order)
    differences = np.diff(np.eye(frames), order, axis=0) if frames > order else np.zeros((0, frames))
    for joint in range(2):
        normal = np.diag(1 / variance[:, joint]) + differences.T @ np.diag(1 / drive[order:, joint]) @ differences
        expected = np.linalg.solve(normal, positions[:, joint] / variance[:, [joint]])
        np.testing.assert_allclose(found[:, joint], expected, atol=TOLERANCE["posterior"])
