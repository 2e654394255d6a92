"""What a clip's bones say about errors that no smoothing in time finds.

Three kinds: lengths measured in noise are too long; joints of a depth camera are off for seconds; and distances of
markers on skin vary, and contradict each other where a segment has more of them than freedom.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionrecover.evidence.bone_lengths import BoneLengths
from motionrecover.isometry.objective import ends
from motionrecover.skeleton import bone_lengths

HELD = 0.9
"""Quantile of distances from the length that counts in `slack`: skin's heavy tails show in it, and it still holds where
a tenth of what was measured are outliers that were not found. The mode's spread would tie markers too fast."""
NORMAL = 1.645
"""That quantile of a normal distribution's absolute value."""


def smoothed_lengths(bones: BoneLengths, positions: np.ndarray, weights: np.ndarray, edges) -> BoneLengths:
    """The bones with the median length in the smoothed positions, samples counting by the lesser weight of both ends.

    Noise of s an axis makes a measured bone s^2 / L longer; and what varies slowly has no mode.
    """
    i, j = ends(edges)
    lengths, weight = bone_lengths(positions, edges), np.minimum(weights[:, i], weights[:, j])
    order = np.argsort(lengths, 0)
    below = np.cumsum(np.take_along_axis(weight, order, 0), 0)
    middle = np.take_along_axis(order, (below >= below[-1:] / 2).argmax(0)[None], 0)
    length = np.where(below[-1] > 0, np.take_along_axis(lengths, middle, 0)[0], bones.length)
    return replace(bones, length=length, interval=bones.interval + (length - bones.length)[:, None])


def drift(length: np.ndarray, positions: np.ndarray, covariance: np.ndarray, weights: np.ndarray, edges) -> np.ndarray:
    """Variance (joint,) of an axis by which joints are off for long, seen where bones vary by more than the covariance.

    A bone's excess is shared by its ends equally, and a joint has the mean of its bones' shares.
    """
    i, j = ends(edges)
    expected = covariance[:, i, i] + covariance[:, j, j] - 2 * covariance[:, i, j]
    weight = np.minimum(weights[:, i], weights[:, j])
    excess = np.where(weight > 0, weight * ((bone_lengths(positions, edges) - length) ** 2 - expected), 0).sum(0)
    share = np.maximum(excess, 0) / np.maximum(weight.sum(0), 1e-9) / 2
    total, count = np.zeros((2, positions.shape[1]))
    for end in (i, j):
        np.add.at(total, end, share)
        np.add.at(count, end, 1)
    return total / np.maximum(count, 1)


def slack(measured: np.ndarray, bones: BoneLengths, joints: int) -> np.ndarray:
    """Variance (bone,) of the lengths where bones close cycles, from those `measured` (frame, bone) at intact samples.

    That of its estimate, and of what it varies by. The ends' noise and the sliding of a marker are in all of its bones
    at once: the bones of a joint share one voice, so the variance counts bones / `joints` times.
    """
    own = np.zeros(len(bones.length))
    known = np.isfinite(measured).any(0)
    own[known] = np.nanquantile(np.abs(measured - bones.length)[:, known], HELD, axis=0) / NORMAL
    return len(own) / joints * own**2 + (np.diff(bones.interval)[:, 0] / 3.92) ** 2
