"""The simple baselines of the studies: what a user would try before any model of a body."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter


def nothing(positions: np.ndarray) -> np.ndarray:
    """The corrupted clip as it is."""
    return positions


def running_median(positions: np.ndarray, frames: int) -> np.ndarray:
    """Median over `frames` frames around each sample, of each coordinate on its own; the ends are held."""
    return median_filter(positions, size=(frames, 1, 1), mode="nearest")


def oracle_spline(positions: np.ndarray, corrupted: np.ndarray) -> np.ndarray:
    """Cubic spline in time through the samples that `corrupted` (frame, joint) names as intact; the ends are held.

    An oracle: no method knows this mask. It bounds what time alone can tell about a sample. Joints with fewer than
    two intact samples stay as they are.
    """
    out, frames = positions.copy(), np.arange(len(positions))
    for joint in range(positions.shape[1]):
        intact = np.flatnonzero(~corrupted[:, joint])
        if len(intact) > 1:
            spline = CubicSpline(intact, positions[intact, joint])
            out[:, joint] = spline(np.clip(frames, intact[0], intact[-1]))
    return out
