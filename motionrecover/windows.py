"""Long clips in overlapping windows: where they lie, and how their answers become one again."""

import numpy as np


def split(frames: int, window: int, overlap: int) -> list[slice]:
    """The fewest windows of equal size, at most `window` frames, that cover the clip and share `overlap` or more.

    `frames` at most `window` is one window. Raises `ValueError` for an overlap that leaves no step.
    """
    if not 0 <= overlap < window:
        raise ValueError(
            f"received windows of {window} frames that share {overlap}: they must share fewer than they have"
        )
    if frames <= window:
        return [slice(0, frames)]
    count = -(-(frames - overlap) // (window - overlap))
    size = -(-(frames + (count - 1) * overlap) // count)
    starts = np.linspace(0, frames - size, count).astype(int)
    return [slice(start, start + size) for start in starts.tolist()]


def blend(parts: list[np.ndarray], spans: list[slice]) -> np.ndarray:
    """One array (frame, ...) from the windows' arrays: their mean, weighted so that each fades in and out.

    Weights rise linearly from a window's ends to its middle, so inside an overlap one answer turns into the other
    without a step, and elsewhere there is only one.
    """
    frames = spans[-1].stop
    total = np.zeros((frames, *parts[0].shape[1:]), parts[0].dtype)
    weight = np.zeros((frames, *[1] * (parts[0].ndim - 1)), parts[0].dtype)
    for part, span in zip(parts, spans, strict=True):
        size = span.stop - span.start
        ramp = np.minimum(np.arange(1, size + 1), np.arange(size, 0, -1)).reshape(-1, *[1] * (part.ndim - 1))
        total[span] += ramp * part
        weight[span] += ramp
    return total / weight
