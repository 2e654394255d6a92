"""Corruption models: what sensors, trackers and the papers' protocols do to a clean clip.

Every model takes positions (frame, joint, 3) with NaN where nothing was measured, and a `seed` (an integer or a
`numpy.random.Generator`). It returns `(corrupted, hit)`: new positions of the same shape and dtype, and the mask
(frame, joint) of the samples that were thrown, exchanged, shifted, held or removed. Removed samples are NaN.
Dense noise is no hit, since it touches everything; where neither noise nor a hit falls, samples keep their values.
Samples that were missing before stay missing and are no hits. Amplitudes are in the unit of the positions, with
defaults for metres.

Every model raises `ValueError` for misshapen positions and for rates, amplitudes, counts and lengths out of range.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from motionrecover.skeleton import Skeleton

Seed = int | np.random.Generator
Corrupted = tuple[np.ndarray, np.ndarray]

GAP_MARGIN = 20
"""Frames at either end of a clip that `gaps` keeps."""

REAL_GAP_QUANTILES = ((0.0, 1), (0.5, 6), (0.75, 26), (0.9, 104), (0.95, 296), (0.99, 999), (1.0, 3000))
"""(share, frames): that share of the gaps in production body-marker data is at most so long. The two ends are ours."""


def joints(positions: np.ndarray, fraction: float, amplitude: float = 0.25, seed: Seed = 0) -> Corrupted:
    """Each joint of each frame is displaced with probability `fraction`, by uniform noise of +-`amplitude` an axis.

    The protocol `iid` (Yang et al. 2020, Sec. IV-B and Table II: fractions 5, 10, 15, 20 and 80 %, +-25 cm).
    """
    positions, rng = _checked(positions, seed, fraction=fraction, amplitude=amplitude)
    hit = (rng.random(positions.shape[:2]) < fraction) & _measured(positions)
    return _added(positions, rng.uniform(-amplitude, amplitude, positions.shape) * hit[..., None]), hit


def entries(positions: np.ndarray, fraction: float, amplitude: float = 0.25, seed: Seed = 0) -> Corrupted:
    """Each coordinate on its own is displaced with probability `fraction`, by uniform noise of +-`amplitude`.

    The other reading of "a fraction of entities" (Yang et al. 2020, Sec. IV-B). A sample is hit where any of its three
    coordinates is, so the share of hit samples is 1 - (1 - fraction)^3.
    """
    positions, rng = _checked(positions, seed, fraction=fraction, amplitude=amplitude)
    struck = (rng.random(positions.shape) < fraction) & _measured(positions)[..., None]
    hit = np.any(struck, axis=-1)
    return _added(positions, rng.uniform(-amplitude, amplitude, positions.shape) * struck), hit


def missing(positions: np.ndarray, fraction: float, seed: Seed = 0) -> Corrupted:
    """Each joint of each frame is missing with probability `fraction`; the first and the last frame are kept.

    The protocol `rand`.
    """
    positions, rng = _checked(positions, seed, fraction=fraction)
    lost = rng.random(positions.shape[:2]) < fraction
    lost[[0, -1]] = False
    return _removed(positions, lost)


def gaps(positions: np.ndarray, joints: int, frames: int, seed: Seed = 0) -> Corrupted:
    """`joints` random joints lose one run of `frames` frames each, at independent random times.

    The protocol `gapNxL`. No run comes nearer than `GAP_MARGIN` frames to the ends.
    Raises `ValueError` where the clip has too few joints or is too short for that.
    """
    positions, rng = _checked(positions, seed, joints=joints, frames=frames)
    count, available = positions.shape[:2]
    if joints > available:
        raise ValueError(f"received gaps in {joints} joints: the clip has {available}, ask for no more")
    starts = count - 2 * GAP_MARGIN - frames + 1
    if starts < 1:
        raise ValueError(
            f"received a clip of {count} frames: a gap of {frames} frames at least {GAP_MARGIN} frames from the ends "
            f"needs {frames + 2 * GAP_MARGIN}"
        )
    lost = np.zeros((count, available), bool)
    for joint in rng.choice(available, joints, replace=False):
        start = GAP_MARGIN + rng.integers(starts)
        lost[start : start + frames, joint] = True
    return _removed(positions, lost)


def real_gaps(positions: np.ndarray, fraction: float = 0.1, seed: Seed = 0) -> Corrupted:
    """A `fraction` of all samples is missing, in runs as long as real ones: mostly short, with a heavy tail.

    Run lengths follow the log-linear quantile function through `REAL_GAP_QUANTILES`; runs longer than the clip are cut,
    and the last drawn run is cut to meet the fraction. Runs do not touch; the first and the last frame are kept.
    """
    positions, rng = _checked(positions, seed, fraction=fraction)
    shares, lengths = np.array(REAL_GAP_QUANTILES).T

    def draw() -> int:
        return round(float(np.exp(np.interp(rng.random(), shares, np.log(lengths)))))

    return _removed(positions, _runs(positions.shape[:2], fraction, draw, rng))


def mixed(positions: np.ndarray, seed: Seed = 0) -> Corrupted:
    """Everything at once: dense noise, thrown samples and missing runs, in metres.

    The protocol `mixed`: Gaussian noise of 3 mm an axis on everything; 2 % of the samples thrown 60-250 mm in a random
    direction; 10 % missing in runs of 30-120 frames, which do not touch each other or the first and the last frame.
    Runs are cut to what a clip shorter than that holds.
    """
    positions, rng = _checked(positions, seed)
    noisy, _ = noise(positions, 0.003, rng)
    thrown = (rng.random(positions.shape[:2]) < 0.02) & _measured(positions)
    step = rng.normal(size=positions.shape)
    step *= rng.uniform(0.06, 0.25, positions.shape[:2])[..., None] / np.linalg.norm(step, axis=-1, keepdims=True)
    noisy = _added(noisy, step * thrown[..., None])
    lost = _runs(positions.shape[:2], 0.1, lambda: int(rng.integers(30, 121)), rng, shortest=30)
    corrupted, removed = _removed(noisy, lost)
    return corrupted, thrown | removed


def noise(positions: np.ndarray, sigma: float, seed: Seed = 0) -> Corrupted:
    """Gaussian noise of standard deviation `sigma` on every coordinate; nothing is hit."""
    positions, rng = _checked(positions, seed, sigma=sigma)
    return _added(positions, rng.normal(0, sigma, positions.shape)), np.zeros(positions.shape[:2], bool)


def swap(positions: np.ndarray, pairs: Sequence[tuple[int, int]], frames: int, seed: Seed = 0) -> Corrupted:
    """The two joints of each pair are exchanged for one run of `frames` frames, at independent random times.

    What trackers do to left and right, or to two markers that come near each other. Where one of the two was missing,
    the gap changes sides, and both are hit.
    """
    positions, rng = _checked(positions, seed, frames=frames)
    count, available = positions.shape[:2]
    if any(len({*pair}) != 2 or not {*pair} <= {*range(available)} for pair in pairs):
        raise ValueError(f"received pairs {pairs!r}: give pairs of different joint indices from 0 to {available - 1}")
    if frames > count:
        raise ValueError(f"received a swap of {frames} frames: the clip has {count}, ask for no more")
    corrupted, hit = positions.copy(), np.zeros((count, available), bool)
    for pair in map(list, pairs):
        start = rng.integers(count - frames + 1)
        run = slice(start, start + frames)
        corrupted[run, pair] = corrupted[run, pair[::-1]]
        hit[run, pair] = True
    return corrupted, hit & (_measured(positions) | _measured(corrupted))


def swaps(positions: np.ndarray, skeleton: Skeleton, pairs: int, frames: int, seed: Seed = 0) -> Corrupted:
    """`pairs` random pairs of joints trade places for one run of `frames` frames each, at independent random times.

    The protocol `swapNxL`. A pair is the two joints of a bone, or a left joint and the right one; no joint is in two.
    Raises `ValueError` where the skeleton has too few such pairs or the clip is too short.
    """
    positions, rng = _checked(positions, seed, pairs=pairs, frames=frames)
    drawn: list[list[int]] = []
    for pair in rng.permutation(sorted({tuple(sorted(pair)) for pair in (*skeleton.edges, *skeleton.mirror)})).tolist():
        if len(drawn) < pairs and not {*pair} & {joint for other in drawn for joint in other}:
            drawn.append(pair)
    if len(drawn) < pairs:
        raise ValueError(
            f"received swaps of {pairs} pairs: {len(drawn)} without a common joint were found, ask for no more"
        )
    return swap(positions, [(i, j) for i, j in drawn], frames, rng)


def drift(
    positions: np.ndarray, joints: int = 1, amplitude: float = 0.1, period: float = 240.0, seed: Seed = 0
) -> Corrupted:
    """`joints` random joints wander slowly away and back, at most `amplitude` far, in waves of about `period` frames.

    What a marker that slides on cloth or an uncalibrated sensor does: too slow for any outlier test on single samples.
    Each axis is a sum of three sinusoids, scaled so that the largest displacement in the clip is `amplitude`.
    """
    positions, rng = _checked(positions, seed, joints=joints, amplitude=amplitude, period=period)
    count, available = positions.shape[:2]
    if joints > available:
        raise ValueError(f"received a drift of {joints} joints: the clip has {available}, ask for no more")
    offset, hit = np.zeros(positions.shape), np.zeros((count, available), bool)
    for joint in rng.choice(available, joints, replace=False):
        rate, phase = rng.uniform(0.5, 1.5, (3, 3)) / period, rng.uniform(0, 2 * np.pi, (3, 3))
        wander = np.sin(2 * np.pi * rate * np.arange(count)[:, None, None] + phase).sum(-1)
        offset[:, joint] = amplitude * wander / np.linalg.norm(wander, axis=-1).max()
        hit[:, joint] = True
    return _added(positions, offset), hit & _measured(positions)


def kinect(positions: np.ndarray, seed: Seed = 0) -> Corrupted:
    """A depth camera: jitter that grows with speed, and joints that are held while they are out of sight, in metres.

    Jitter is Gaussian of 4 mm an axis plus a tenth of the way that the joint moves in one frame. 8 % of the samples
    lie in runs of 5-30 frames in which a joint stays within 4 cm of its last measured place, as an inferred one does;
    these are the hits. The sizes are modest guesses in the range of Kinect v2 recordings, not a fitted model.
    """
    positions, rng = _checked(positions, seed)
    way = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=-1, keepdims=True)
    jitter = rng.normal(size=positions.shape) * (0.004 + 0.1 * np.nan_to_num(way))
    held = _runs(positions.shape[:2], 0.08, lambda: int(rng.integers(5, 31)), rng)
    held &= _measured(positions)
    corrupted = positions.copy()
    for joint in range(positions.shape[1]):
        # Each held sample repeats the last frame of its joint that is measured and not held.
        free = _measured(positions)[:, joint] & ~held[:, joint]
        source = np.maximum.accumulate(np.where(free, np.arange(len(free)), -1))
        held[source < 0, joint] = False
        run = np.flatnonzero(held[:, joint])
        misplaced = rng.uniform(-0.023, 0.023, positions[:, joint].shape)
        corrupted[run, joint] = (positions[:, joint] + misplaced)[source[run]]
    return _added(corrupted, jitter), held


PROTOCOLS: dict[str, Callable[..., Corrupted]] = {
    "iid-F": lambda positions, seed, skeleton, f: joints(positions, f / 100, seed=seed),
    "entries-F": lambda positions, seed, skeleton, f: entries(positions, f / 100, seed=seed),
    "randF": lambda positions, seed, skeleton, f: missing(positions, f / 100, seed),
    "gapNxL": lambda positions, seed, skeleton, n, l: gaps(positions, n, l, seed),
    "swapNxL": lambda positions, seed, skeleton, n, l: swaps(positions, skeleton, n, l, seed),
    "real-gaps": lambda positions, seed, skeleton: real_gaps(positions, seed=seed),
    "real-gaps-F": lambda positions, seed, skeleton, f: real_gaps(positions, f / 100, seed),
    "mixed": lambda positions, seed, skeleton: mixed(positions, seed),
    "kinect": lambda positions, seed, skeleton: kinect(positions, seed),
}
"""Protocols by form of their name. Capital letters stand for whole numbers: F per cent, N joints or pairs, L frames."""


def apply(name: str, positions: np.ndarray, seed: Seed = 0, skeleton: Skeleton | None = None) -> Corrupted:
    """Corrupts positions, in metres, by the name of a protocol: `iid-20`, `rand30`, `gap3x60`, `mixed`, `real-gaps`.

    `swap2x30` needs the skeleton. Raises `ValueError` for a name of no form in `PROTOCOLS`.
    """
    for form, protocol in PROTOCOLS.items():
        if match := re.fullmatch(re.sub("[A-Z]", r"(\\d+)", form), name):
            if form == "swapNxL" and skeleton is None:
                raise ValueError(
                    f"received the protocol {name!r} without a skeleton, which says who may swap: give one"
                )
            return protocol(positions, seed, skeleton, *map(int, match.groups()))
    raise ValueError(
        f"received the protocol {name!r}: give one of {', '.join(PROTOCOLS)}, with F per cent, N joints, L frames"
    )


def _checked(positions: np.ndarray, seed: Seed, **numbers: float) -> tuple[np.ndarray, np.random.Generator]:
    """Positions and random generator, once the arguments have passed."""
    positions = np.asarray(positions)
    if positions.ndim != 3 or positions.shape[-1] != 3 or not np.issubdtype(positions.dtype, np.floating):
        raise ValueError(
            f"received positions of shape {positions.shape} and dtype {positions.dtype}: "
            "give floats of shape (frame, joint, 3)"
        )
    for name, number in numbers.items():
        if not (np.isfinite(number) and number >= 0) or (name == "period" and number == 0):
            raise ValueError(f"received {name} = {number}: give a finite positive number")
        if name == "fraction" and number > 1:
            raise ValueError(f"received a fraction of {number}: give one from 0 to 1")
        if name in ("joints", "pairs", "frames") and (number != int(number) or number < 1):
            raise ValueError(f"received {name} = {number}: give a whole number from 1 up")
    return positions, np.random.default_rng(seed)


def _measured(positions: np.ndarray) -> np.ndarray:
    return np.all(np.isfinite(positions), axis=-1)


def _added(positions: np.ndarray, offset: np.ndarray) -> np.ndarray:
    return (positions + offset).astype(positions.dtype)


def _removed(positions: np.ndarray, lost: np.ndarray) -> Corrupted:
    corrupted = positions.copy()
    corrupted[lost] = np.nan
    return corrupted, lost & _measured(positions)


def _runs(
    shape: tuple[int, int],
    fraction: float,
    draw: Callable[[], int],
    rng: np.random.Generator,
    shortest: int = 1,
) -> np.ndarray:
    """Mask (frame, joint) of separate runs that cover `fraction` of all samples, to less than `shortest` of them.

    Lengths come from `draw`. The longest run is placed first, each in a random joint at a random free time.
    """
    count, available = shape
    left, lengths = round(fraction * count * available), []
    while left >= shortest and count > 2:
        lengths.append(min(draw(), left, count - 2))
        left -= lengths[-1]
    mask = np.zeros(shape, bool)
    for length in sorted(lengths, reverse=True):
        for joint in rng.permutation(available):
            # A run from `start` is free where neither it nor a neighbour of its ends is taken.
            taken = np.concatenate([[0], np.cumsum(mask[:, joint])])
            starts = 1 + np.flatnonzero(taken[length + 2 :] == taken[: -(length + 2)])
            if len(starts):
                start = rng.choice(starts)
                mask[start : start + length, joint] = True
                break
        else:
            raise ValueError(
                f"received a fraction of {fraction}: {count} frames of {available} joints do not hold separate runs "
                "for that, ask for less"
            )
    return mask
