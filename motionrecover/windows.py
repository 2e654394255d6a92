"""Long clips in overlapping windows: where they lie, and how their answers become one again."""

from collections.abc import Callable, Generator
from typing import TypeVar

import numpy as np

from motionrecover.threads import in_order

A = TypeVar("A")


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


def solved(
    solve: Callable[[slice], A], spans: list[slice], workers: int, progress: Callable[[int, int], None] | None
) -> Generator[A]:
    """The answers of the windows, in order, so many at a time.

    `progress`, if given, is told how many are done and how many there are.
    """
    tell = progress or (lambda done, count: None)
    tell(0, len(spans))
    for done, answer in enumerate(in_order(solve, spans, workers), 1):
        tell(done, len(spans))
        yield answer


def shares(spans: list[slice], trust: list[np.ndarray] | None = None) -> list[np.ndarray]:
    """What each window counts for in each of its frames, (frame,), or (frame, joint) with its `trust` of that shape.

    Shares rise linearly from a window's ends to its middle, so inside an overlap one answer turns into the other
    without a step; where a window knows little, at the open end of a gap, the other counts.
    """
    ramps = []
    for k, span in enumerate(spans):
        size = span.stop - span.start
        ramp = np.minimum(np.arange(1.0, size + 1), np.arange(size, 0, -1))
        ramps.append(ramp if trust is None else ramp[:, None] * trust[k])
    total = np.zeros((spans[-1].stop, *ramps[0].shape[1:]))
    for ramp, span in zip(ramps, spans, strict=True):
        total[span] += ramp
    return [ramp / total[span] for ramp, span in zip(ramps, spans, strict=True)]


def blend(parts: list[np.ndarray], spans: list[slice], share: list[np.ndarray] | None = None) -> np.ndarray:
    """One array (frame, ...) from the windows' arrays, which count by their `share`."""
    total = np.zeros((spans[-1].stop, *parts[0].shape[1:]), parts[0].dtype)
    for part, span, one in zip(parts, spans, share or shares(spans), strict=True):
        total[span] += (one.reshape(*one.shape, *[1] * (part.ndim - one.ndim)) * part).astype(part.dtype)
    return total
