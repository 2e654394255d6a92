"""Runs of True along time in masks, and how far off the nearest True is."""

from __future__ import annotations

import numpy as np


def runs_of(mask: np.ndarray) -> list[tuple[int, int]]:
    """Start and stop of every run of True in mask (frame,), in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def run_lengths(mask: np.ndarray) -> np.ndarray:
    """Frames (frame, column) of the run of True around each element of mask (frame, column); 0 where it is False."""
    frames = np.arange(len(mask))[:, None]
    before = np.maximum.accumulate(np.where(mask, -1, frames), 0)
    after = np.minimum.accumulate(np.where(mask, len(mask), frames)[::-1], 0)[::-1]
    return np.where(mask, after - before - 1, 0)


def frames_away(known: np.ndarray) -> np.ndarray:
    """Frames (frame, column) from each element to the nearest known one of its column; infinite without one."""
    frames = np.arange(len(known), dtype=float)[:, None]
    last = np.maximum.accumulate(np.where(known, frames, -np.inf), 0)
    following = np.minimum.accumulate(np.where(known, frames, np.inf)[::-1], 0)[::-1]
    return np.minimum(frames - last, following - frames)
