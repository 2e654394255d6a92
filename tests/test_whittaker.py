"""Whittaker's smoother is the minimum of its objective."""

import numpy as np
import pytest
from helpers import TOLERANCE

from motionrecover.whittaker import whittaker


@pytest.mark.parametrize("frames", [1, 2, 3, 12])
def test_it_is_the_minimum(frames):
    rng = np.random.default_rng(frames)
    positions, variance, drive = rng.normal(size=(frames, 2, 3)), rng.uniform(0.1, 9, (frames, 2)), np.ones((frames, 2))
    drive[2:] = rng.uniform(0.1, 2, (max(frames - 2, 0), 2))
    found = whittaker(positions, variance, drive)
    second = np.diff(np.eye(frames), 2, axis=0) if frames > 2 else np.zeros((0, frames))
    for joint in range(2):
        normal = np.diag(1 / variance[:, joint]) + second.T @ np.diag(1 / drive[2:, joint]) @ second
        expected = np.linalg.solve(normal, positions[:, joint] / variance[:, [joint]])
        np.testing.assert_allclose(found[:, joint], expected, atol=TOLERANCE["posterior"])
