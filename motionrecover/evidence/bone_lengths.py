"""Bone lengths from corrupted positions."""

import numpy as np

# Below 6 frames a few corrupted ones outvote the rest, and some clips come back worse than they went in:
# benchmarks/studies/penalties.py.
LEAST_FRAMES = 6
"""An estimate from fewer frames is not safe."""


def estimate_bone_lengths(lengths: np.ndarray) -> np.ndarray:
    """One length (bone,) from the measured lengths (frame, bone) of each bone, NaN where an end is missing.

    The median of the shortest interval that holds half of the frames (Rousseeuw, "Least median of squares regression",
    JASA 79, 1984: the location of the shorth). Corruption of an end makes a bone longer far more often than shorter,
    which biases a median over all frames; the shorth ignores up to half of the frames whatever they say. With more
    than half of a bone's frames corrupted no such estimate is safe: give the lengths then. A bone without a frame
    gets NaN.
    """
    lengths = np.asarray(lengths, np.float64)
    estimates = np.full(lengths.shape[1], np.nan)
    for bone, column in enumerate(lengths.T):
        known = np.sort(column[np.isfinite(column)])
        if len(known):
            half = len(known) // 2 + 1
            start = np.argmin(known[half - 1 :] - known[: len(known) - half + 1])
            estimates[bone] = np.median(known[start : start + half])
    return estimates
