"""How fast the joints of a clip change their velocity, from corrupted positions."""

import numpy as np

PRIOR = 20.0
"""Differences that the common variance counts for. At 80 % corruption a joint has two intact ones of its own."""
STILL = 1e-4
"""Relative change of what is fitted at which fitting ends."""


def estimate_drive(positions: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Variance (joint,) of one axis of the second differences x_t - 2 x_{t-1} + x_{t-2} of the intact motion.

    Of positions (frame, joint, 3), those of three observed samples in a row count. They are a mixture of two normals
    of mean zero, intact and not, because a displaced sample displaces three of them; fitted by expectation
    maximisation (Dempster, Laird & Rubin 1977), first to all joints together from several starts, then to each joint
    with the common value as a prior of `PRIOR` differences. Low by up to half where motion is uneven, which only makes
    the first smoothing stronger. NaN where there is nothing to tell.
    """
    counted = observed[2:] & observed[1:-1] & observed[:-2]
    if not counted.any():
        return np.full(positions.shape[1], np.nan)
    squares = (np.diff(positions, 2, axis=0) ** 2).sum(-1) / 3
    pooled = squares[counted]
    wide = pooled.mean()
    if wide == 0:
        return np.zeros(positions.shape[1])
    pooled = np.maximum(pooled, 1e-12 * wide)
    fits = [_fit(pooled, np.quantile(pooled, q), wide) for q in (0.005, 0.02, 0.1, 0.3)]
    _, narrow, share = max(fits)
    variance = np.full(positions.shape[1], narrow)
    square = np.where(counted, np.maximum(squares, 1e-12 * wide), 0)
    for _ in range(40):
        intact = counted * _intact(square, share, variance, wide)
        before, variance = variance, ((intact * square).sum(0) + PRIOR / 2 * narrow) / (intact.sum(0) + PRIOR / 2)
        if np.abs(variance / before - 1).max() < STILL:
            break
    return variance


def _fit(squares, narrow, wide):
    """Log likelihood, variance and share of the narrow part of the mixture."""
    share, total, before = 0.5, squares.sum(), (0.5, narrow, wide)
    for _ in range(60):
        before = share, narrow, wide
        intact = _intact(squares, *before)
        part, count = intact @ squares, intact.sum()
        share = np.clip(count / len(squares), 1e-4, 1 - 1e-4)
        narrow = max(part / count, squares.min())
        wide = max((total - part) / max(len(squares) - count, 1e-9), narrow)
        if abs(narrow / before[1] - 1) + abs(share / before[0] - 1) < STILL:
            break
    level = np.logaddexp(0, _odds(squares, *before)) - 1.5 * squares / before[1]
    return level.sum() + len(squares) * (np.log(before[0]) - 1.5 * np.log(before[1])), narrow, share


def _odds(square, share, narrow, wide):
    """Log odds that a difference is of the wide part."""
    return np.log(1 / share - 1) + 1.5 * (np.log(narrow / wide) + square * (1 / narrow - 1 / wide))


def _intact(square, share, narrow, wide):
    """Probability that a difference is of the narrow part."""
    return 1 / (1 + np.exp(np.minimum(_odds(square, share, narrow, wide), 500)))
