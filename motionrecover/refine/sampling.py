"""Clips at another frame rate, and in windows of one length."""

from __future__ import annotations

import numpy as np


def resample(positions: np.ndarray, fps: float, new_fps: float, frames: int | None = None) -> np.ndarray:
    """Positions (frame, joint, 3) at `new_fps`, from the first frame on, by straight lines between two frames.

    `frames` of the answer: as many as the clip covers unless given; beyond its end the last frame is held.
    """
    if frames is None:
        frames = int(np.floor((len(positions) - 1) * new_fps / fps + 1e-6)) + 1
    at = np.minimum(np.arange(frames) * fps / new_fps, len(positions) - 1)
    before = np.floor(at + 1e-6).astype(int)
    share = np.maximum(at - before, 0)
    share[share < 1e-6] = 0
    after = np.minimum(before + (share > 0), len(positions) - 1)
    share = share[:, None, None]
    return (1 - share) * positions[before] + share * positions[after]


def spans(frames: int, window: int) -> list[slice]:
    """Windows of exactly `window` frames, evenly spread, that cover the clip and overlap by half or more.

    A clip that is shorter has one, which reaches over its end.
    """
    if frames <= window:
        return [slice(0, window)]
    count = -(-(frames - window) // (window // 2)) + 1
    return [slice(start, start + window) for start in np.linspace(0, frames - window, count).astype(int).tolist()]
