"""Peers that see one joint at a time: interpolation, running median, Hampel and Butterworth, Kalman smoother.

Every peer takes positions (frame, joint, 3) in metres with NaN where nothing was measured, and frames a second. It
returns positions of the same shape. A joint without any sample stays NaN, which counts as a failure.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import simdkalman
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.signal import butter, sosfiltfilt

from motionrecover.runs import run_lengths

SHORT_GAP = 0.1
"""Seconds. Gaps up to here are filled by a spline before any method that needs whole frames, as editors do."""
JERK = 10.0
"""Metres a second cubed, per square root of hertz: the white jerk that drives the Kalman model. Of 1, 3, 10, 30, 60
and 200 the best over gaps, noise and spikes together: less smooths fast motion away, more lets gaps fly off."""


def nothing(positions: np.ndarray, fps: float) -> np.ndarray:
    """Observed samples as they are; a straight line over each gap, the ends held."""
    return _over_gaps(positions, lambda at, values: lambda frames: _lines(frames, at, values))


def spline(positions: np.ndarray, fps: float) -> np.ndarray:
    """Despiked; a cubic spline in time through the samples left, over each gap; the ends are held."""
    return cubic(despike(positions))


def running_median(positions: np.ndarray, frames: int) -> np.ndarray:
    """Linear fill, then the median over `frames` frames around each sample, each coordinate alone; ends are held."""
    return median_filter(_filled(positions), size=(frames, 1, 1), mode="nearest")


def hampel_butterworth(positions: np.ndarray, fps: float) -> np.ndarray:
    """The default chain of Pose2Sim: linear fill, Hampel filter, zero-phase Butterworth low-pass.

    Pagnon, Domalain & Reveret, "Pose2Sim: an open-source Python package for multiview markerless kinematics", JOSS
    7(77), 2022. Its packages bring OpenSim, OpenVINO and Qt, so the chain stands here in SciPy with its defaults: the
    Hampel filter replaces a coordinate by the median of the 7 around it where it lies 2 scaled median deviations off;
    the Butterworth filter is of order 4 in two passes with a cut-off of 6 Hz. Pose2Sim repeats the last value over
    gaps of more than 20 frames; the straight line used here instead is the stronger choice.
    """
    filled = _filled(positions)
    median, deviation = _hampel(filled, 7)
    spikes = np.abs(filled - median) > 2 * deviation
    spikes &= deviation > 0
    spikes[:3] = spikes[-3:] = False
    low_pass = butter(2, 6 / (fps / 2), output="sos")
    return sosfiltfilt(low_pass, np.where(spikes, median, filled), axis=0, padlen=min(9, len(filled) - 1))


def kalman(positions: np.ndarray, fps: float) -> np.ndarray:
    """Despiked; Kalman smoother (`simdkalman`) of a constant acceleration driven by white jerk, each coordinate alone.

    Rauch, Tung & Striebel, AIAA Journal 3(8), 1965; process noise of the discretised Wiener process acceleration model
    after Bar-Shalom, Li & Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, Sec. 6.2.3.
    The noise of the measurements is told from the clip itself: 1.4826 median |x'''| / sqrt(20), third differences,
    at least 0.1 mm.
    """
    despiked = despike(positions)
    frames, joints, _ = despiked.shape
    third = np.abs(np.diff(despiked, 3, axis=0))
    sigma = max(1e-4, 1.4826 * float(np.nanmedian(third)) / np.sqrt(20)) if np.isfinite(third).any() else 1e-4
    dt = 1 / fps
    jerk = np.array([[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]])
    model = simdkalman.KalmanFilter(
        state_transition=np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]]),
        process_noise=JERK**2 * jerk,
        observation_model=np.array([[1.0, 0, 0]]),
        observation_noise=sigma**2,
    )
    series = despiked.transpose(1, 2, 0).reshape(-1, frames)
    start = np.zeros((len(series), 3, 1))
    start[:, 0, 0] = _filled(despiked)[0].ravel()
    spread = np.diag([sigma**2, 2.0**2, 20.0**2])
    smooth = model.smooth(series, initial_value=start, initial_covariance=spread).observations.mean
    return smooth.reshape(joints, 3, frames).transpose(2, 0, 1)


def despike(positions: np.ndarray) -> np.ndarray:
    """Samples far from their neighbours in time set missing: what users of a gap filler do before it.

    Hampel identifier (Davies & Gather, JASA 88(423), 1993) over 7 frames: a coordinate 3 scaled median deviations and
    3 cm away from the median marks its sample. The 3 cm keep clean samples from being thrown away.
    """
    median, deviation = _hampel(_filled(positions), 7)
    spikes = np.abs(positions - median) > np.maximum(3 * deviation, 0.03)
    return np.where(spikes.any(-1, keepdims=True), np.nan, positions)


def cubic(positions: np.ndarray, longest: float = np.inf) -> np.ndarray:
    """A cubic spline in time over each gap of at most `longest` frames; the ends are held."""
    filled = _over_gaps(positions, lambda at, values: CubicSpline(at, values) if len(at) > 1 else lambda _: values)
    missing = np.any(np.isnan(positions), axis=-1)
    return np.where((run_lengths(missing) <= longest)[..., None], filled, positions)


def _filled(positions: np.ndarray) -> np.ndarray:
    return nothing(positions, 0)


def _over_gaps(positions: np.ndarray, curve: Callable[[np.ndarray, np.ndarray], Callable]) -> np.ndarray:
    """Missing samples from `curve(frames, samples)` of each joint, held before the first and after the last sample."""
    out, frames = positions.copy(), np.arange(len(positions))
    missing = np.any(np.isnan(positions), axis=-1)
    for joint in np.flatnonzero(missing.any(0) & ~missing.all(0)):
        gap, at = missing[:, joint], np.flatnonzero(~missing[:, joint])
        out[gap, joint] = curve(at, positions[at, joint])(np.clip(frames[gap], at[0], at[-1]))
    return out


def _lines(frames: np.ndarray, at: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(frames, at, values[:, axis]) for axis in range(3)], -1)


def _hampel(positions: np.ndarray, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Median and scaled median absolute deviation over `frames` frames around each sample, the ends held."""
    half = frames // 2
    windows = sliding_window_view(np.pad(positions, ((half, half), (0, 0), (0, 0)), mode="edge"), frames, axis=0)
    median = np.median(windows, -1)
    return median, np.median(np.abs(windows - median[..., None]), -1) / 0.6745
