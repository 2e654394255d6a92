"""A rest pose before the motion begins, which is no part of it."""

from __future__ import annotations

import numpy as np

JUMP = 5.0
"""Times the usual acceleration. Of 11 CMU clips that begin with a T-pose it is 69 to 340, and at 30 Hz 7 (runs) to 69;
of 213 without one at most 4, but for two that begin with a glitch."""
FAR = 0.1
"""Median bones by which the body jumps at least: nothing is usual of a body that stands still."""


def begins_at_rest(data: np.ndarray, lengths: np.ndarray, known: np.ndarray, off: float) -> bool:
    """Whether frame 0 is another pose than the motion goes on from, such as the T-pose that some BVH files begin with.

    It is if all of it is measured, all bones are within `off` of their `known` (bone,) lengths, and the second
    difference there, as the median of the joints, is `JUMP` times the usual one. `data` (frame, joint, 3), NaN where
    missing; `lengths` (frame, bone).
    """
    if len(data) < 3 or not np.isfinite(data[0]).all():
        return False
    held = np.isfinite(known)
    if not held.any() or np.max(np.abs(lengths[0] - known)[held]) > off:
        return False
    jumps = np.ma.median(np.ma.masked_invalid(np.linalg.norm(np.diff(data, 2, axis=0), axis=-1)), axis=1).filled(0)
    return bool(jumps[0] > max(JUMP * np.median(jumps), FAR * np.median(known[held])))
