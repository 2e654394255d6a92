"""Bone lengths from corrupted positions: where the measured lengths of a bone crowd together.

A corrupted end makes a bone look any length; intact frames measure the same one again and again, up to noise. So the
length is the mode of what was measured, however few frames share it. With the lengths l_1 <= ... <= l_n of one bone,
the median U of all bones and the resolution D = `RESOLUTION` U:

1. Scan (Kulldorff, "A spatial scan statistic", Communications in Statistics 26, 1997). Let b be a density of all n
   lengths so smooth that it shows no narrow mode. By chance, an interval of width w >= D holds mu = n w b of them. One
   that holds k is surprising by its log likelihood ratio, less the choice of its two ends:

       k log(k / mu) + (n - k) log((n - k) / (n - mu)) - 2 log n,    where mu < k.                                 (1)

   The most surprising one is where step 2 starts; if it is below `SURPRISE`, the shortest half is (Rousseeuw, "Least
   median of squares regression", JASA 79, 1984).
2. Expectation maximisation (Dempster, Laird and Rubin, JRSS B 39, 1977) of a mixture: a share f of intact lengths, from
   N(L, s^2), and the rest, from N(m, v). With p_t for the probability that l_t is intact,

       f = mean of p,    L = mean of l under p,    s^2 = variance of l under p, at least D^2,                      (2)
       m, v = mean and variance of l under 1 - p, and of `PRIOR` lengths more from N(L, U^2).                      (3)

3. The 95 % interval of L is Student's for the sum of p frames, at least D to either side.

The noise of all bones is much alike. A mode narrower than `ALIKE` times the usual spread is an accident: a tracker that
holds a joint, a chance meeting of a few. Then D becomes the usual spread in the scan and `ALIKE` times that in the
mixture, and steps 1 and 2 are done again. Scatter, which is wider than `WIDE` U and has no mode, keeps the median of
the shortest half for its length.

L is the mean of what is measured. Noise of s an axis makes a bone look s^2 / L longer than it is, which is left in.
Lengths in another unit give answers in it, and the order of frames and bones means nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from motionrecover.skeleton import Skeleton

# The mode is no safer than the shorth was here, since a few frames have none: with 20 % of the joints thrown 25 cm an
# axis, 8, 7, 5 and 2 % of the bones of CMU clips are more than 5 % off at 4, 5, 6 and 8 frames, as with the shorth.
# None of them is called rigid. Below 6 frames some clips come back worse than they went in:
# benchmarks/studies/penalties.py.
LEAST_FRAMES = 6
"""An estimate from fewer frames is not safe."""

RESOLUTION = 1e-5
"""Of the median bone: 2 micrometres, what float32 positions a few metres from the origin still resolve."""
MOST_FRAMES = 2000
"""More are thinned to every so many of the sorted lengths, which keeps their distribution."""
SURPRISE = 12.0
"""In nats. One of 13000 columns of noise exceeds it with an interval much narrower than the noise (normal, uniform,
Rayleigh, thrown joints; 6 to 3000 frames). Three exact lengths among 37 reach 19, three among 300 reach 9, four 17."""
PRIOR = 3.0
STEPS, STILL = 30, 1e-6
"""Of step 2, at most, and the change of p at which it ends."""
ALIKE = 0.3
"""Kinect recordings hold a tenth of the lengths of some bones within a millimetre, the rest within centimetres: without
this rule a length is off by 19 %."""

WIDE = 0.1
"""Of the median bone. Spreads of rigid bones in Kinect recordings reach 7 %, thrown joints alone give 30 % and more."""
LOOSE, STEADY = 5.0, 3e-3
"""A rigid bone's spread is at most so many usual ones or this much of its length. In CMU clips with joints left out, a
bone over an ankle varies by 1 % (median), and the others by the resolution."""
RARE = 0.7
"""Of the usual share, less what counting leaves open: a bone that agrees while the body stands still is not rigid."""
BLUNT = 5e-4
"""Of the median bone: 0.1 mm, the least standard deviation that `evidence` takes for granted."""
FREEDOM = 4.0
"""Of Student's t in `evidence`: lengths have heavier tails than normal ones. A depth camera's drift by several spreads
for seconds; with a normal density up to 7 % of its tracked samples are taken for outliers because of it."""
LEAST_GAIN = -60.0

STUDENT = ((np.inf, 1.96), (30, 2.042), (10, 2.228), (6, 2.447), (4, 2.776), (3, 3.182), (2, 4.303), (1, 12.706))
"""(degrees of freedom, 97.5 % quantile) of Student's t, between which 1 / degrees of freedom interpolates."""


@dataclass(frozen=True, eq=False)
class BoneLengths:
    """What the measured lengths say about each bone. One without a frame has a share of 0 and NaN for the rest."""

    length: np.ndarray
    """(bone,)"""
    spread: np.ndarray
    """(bone,): standard deviation of an intact measurement."""
    share: np.ndarray
    """(bone,): of the frames that have both ends, how many agree on the length."""
    rigid: np.ndarray
    """(bone,): whether the bone keeps one length, as far as its frames can tell."""
    interval: np.ndarray
    """(bone, 2): 95 % interval of the length."""
    background: np.ndarray
    """(bone, 2): mean and standard deviation of the lengths that do not agree."""


def estimate_bone_lengths(lengths: np.ndarray) -> BoneLengths:
    """The lengths of bones from measured ones (frame, bone), NaN where an end is missing."""
    lengths = np.asarray(lengths, np.float64)
    return _estimated(lengths.tobytes(), lengths.shape)


# The recovery of a clip asks up to three times: for its swaps, for its skeleton and for its motion.
@lru_cache(maxsize=2)
def _estimated(measured, shape):
    x, n, count = _sorted(np.frombuffer(measured).reshape(shape))
    unit = _unit(x, n)
    floor = width = RESOLUTION * unit
    first, surprise, (length, spread, p, background) = _mode(x, n, unit, width, floor)
    for _ in range(3):
        usual = _usual(spread, n, unit)
        if (spread < ALIKE * usual).any():
            floor, width = max(floor, ALIKE * usual), max(width, usual)
            first, surprise, (length, spread, p, background) = _mode(x, n, unit, width, floor)
    # Too few for a mixture: the median, as uncertain as the lengths differ; one alone says nothing of its spread.
    mode = surprise > SURPRISE
    few = (n <= 5) & ~mode
    middle, sd = _column(np.nanmedian, x, n), _column(np.nanstd, x, n) * np.sqrt(n / np.maximum(n - 1, 1))
    length, p = np.where(few, middle, length), np.where(few, np.isfinite(x), p)
    spread = np.where(few, np.where(n > 1, np.maximum(sd, floor), unit), spread)
    length = np.where(mode | (spread <= WIDE * unit), length, first)
    return _judged(length, spread, p.sum(0) / np.maximum(n, 1), background, count, unit, mode)


def scale_about(lengths: np.ndarray, given: np.ndarray) -> BoneLengths:
    """The same where the lengths are `given` (bone,): the spread is one for all bones, and `rigid` is no longer blind.

    Steps 2 and 3 for the differences l - `given` of all bones together with L = 0, from many first spreads, of which
    the most likely end is kept.
    """
    lengths, given = np.asarray(lengths, np.float64), np.asarray(given, np.float64)
    free = estimate_bone_lengths(lengths)
    x, n, _ = _sorted((lengths - given).reshape(-1, 1))
    count = np.isfinite(lengths).sum(0)
    unit = _median(given)
    if not n[0]:
        return replace(free, length=given)
    x = x[: n[0]]
    floor = RESOLUTION * unit
    spreads = np.geomspace(floor, max(np.sqrt(np.nanmean(x**2)), 3 * floor), 16)
    x = np.repeat(x, len(spreads), 1)
    _, spread, p, background = _mixture(x, 0 * spreads, spreads, 0 * spreads + 0.5, unit, floor, moves=False)
    share = p.sum(0) / n
    best = np.argmax(_log_likelihood(x, 0.0, spread, share, background))
    spread, share = np.full(given.shape, spread[best]), np.full(given.shape, share[best])
    background = np.repeat(background[[best]], len(given), 0) + np.outer(given, [1, 0])
    p = np.where(np.isfinite(lengths), _intact(lengths, given, spread, share, background), 0)
    background = _rest(lengths, 1 - p, given, unit)
    found = _judged(given, spread, p.sum(0) / np.maximum(count, 1), background, count, unit, pooled=free)
    return replace(found, length=given)


def evidence(lengths: np.ndarray, bones: BoneLengths) -> np.ndarray:
    """How many nats each measured length (frame, bone) speaks for two intact ends.

    The log ratio of Student's t at L of scale s and N(m, v), at least `LEAST_GAIN`; 0 where nothing was measured or the
    bone is not rigid. Here s^2 holds the uncertainty of L too.
    """
    lengths = np.asarray(lengths, np.float64)
    uncertain = np.where(bones.rigid, np.diff(bones.interval)[:, 0] / 3.92, 0)
    sigma = np.maximum(np.hypot(bones.spread, uncertain), BLUNT * _median(bones.length))
    mean, deviation = bones.background.T
    gain = _log_student(lengths, bones.length, sigma) - _log_normal(lengths, mean, np.maximum(deviation, sigma))
    return np.where(bones.rigid & np.isfinite(gain), np.maximum(gain, LEAST_GAIN), 0.0)


def symmetric(bones: BoneLengths, pairs: Iterable[tuple[int, int]]) -> BoneLengths:
    """The lengths where the two bones of a pair are taken for equally long, as far as their intervals allow.

    With variances v_1 and v_2 of the two lengths and their difference d, the two differ by some N(0, t^2), where
    t^2 = max(d^2 - v_1 - v_2, 0) is what their uncertainty does not explain. The first moves towards the other by the
    share v_1 / (v_1 + v_2 + t^2) of d, and so the second: to their mean weighted by precision where they agree, hardly
    at all where they do not, for bodies are not symmetric (an upper arm of CMU subject 5 is 6 % longer than the other).
    """
    length, interval = bones.length.copy(), bones.interval.copy()
    unit = _median(length)
    for pair in map(list, pairs):
        known = np.isfinite(bones.length[pair])
        if not known.any():
            continue
        both = np.where(known, bones.length[pair], bones.length[pair][known][0])
        half = np.diff(bones.interval[pair])[:, 0] / 2
        v = np.where(np.isfinite(half), half, 1e3 * unit) ** 2
        d = both[1] - both[0]
        total = max(v.sum(), d * d)
        length[pair] = both + v / total * [d, -d]
        half = np.sqrt(v * (1 - v / total))
        interval[pair] = length[pair][:, None] + half[:, None] * [-1, 1]
    return replace(bones, length=length, interval=interval)


def mirrored_bones(skeleton: Skeleton) -> tuple[tuple[int, int], ...]:
    """Pairs (left, right) of bones whose joints are mirrored, for `symmetric`."""
    other = skeleton.other_side
    index = {frozenset(edge): bone for bone, edge in enumerate(skeleton.edges)}
    lefts = {left for left, _ in skeleton.mirror}
    pairs = []
    for bone, (i, j) in enumerate(skeleton.edges):
        mirrored = index.get(frozenset((other[i], other[j])), bone)
        if mirrored != bone and {i, j} & lefts and (mirrored, bone) not in pairs:
            pairs.append((bone, mirrored))
    return tuple(pairs)


def _sorted(lengths):
    """Sorted lengths (rank, bone), NaN behind the last, thinned; how many of them; and how many there were."""
    x = np.sort(np.where(np.isfinite(lengths), lengths, np.nan), 0)
    count = np.isfinite(x).sum(0)
    n = np.minimum(count, MOST_FRAMES)
    if len(x) > MOST_FRAMES:
        rank = ((np.arange(MOST_FRAMES)[:, None] + 0.5) * np.maximum(count / MOST_FRAMES, 1)).astype(int)
        rank = np.where(rank < count, rank, len(x) - 1)
        x = np.take_along_axis(np.where(np.arange(len(x))[:, None] < count, x, np.nan), rank, 0)
    return x, n, count


def _column(function, x, n):
    """A function of each column that has lengths, NaN for the others."""
    out = np.full(x.shape[1], np.nan)
    if (n > 0).any():
        out[n > 0] = function(x[:, n > 0], 0)
    return out


def _median(lengths):
    """The median bone, of those with a length."""
    lengths = lengths[lengths > 0]
    return float(np.median(lengths)) if len(lengths) else 1.0


def _unit(x, n):
    """U."""
    return _median(_column(np.nanmedian, x, n))


def _mode(x, n, unit, width, floor):
    """Steps 1 and 2: the first length, the surprise and the mixture."""
    length, spread, share, surprise = _start(x, n, width)
    return length, surprise, _mixture(x, length, spread, share, unit, floor)


def _usual(spread, n, unit):
    """The median spread of the bones whose lengths are no mere scatter, 0 without one."""
    spread = spread[(n > 0) & (spread <= WIDE * unit)]
    return np.median(spread) if len(spread) else 0.0


def _start(x, n, floor):
    """Step 1: length, spread and share (bone,) where step 2 starts, and the surprise. 40 counts k stand for all."""
    bones = np.arange(x.shape[1])
    rows = np.arange(len(x))[:, None]
    half = n // 2 + 1
    width = np.where(rows + half <= n, _taken(x, rows + half - 1) - x, np.inf)
    at, held, best = width.argmin(0) if len(x) else 0 * bones, half, np.full(len(bones), -np.inf)
    total = np.zeros((len(x) + 1, len(bones)))
    np.cumsum(_log_smooth(x, n, floor), 0, out=total[1:])
    for k in np.unique(np.geomspace(3, max(len(x), 3), 40).round().astype(int)):
        if k <= len(x):
            width = np.maximum(x[k - 1 :] - x[: len(x) - k + 1], floor)
            expected = width * np.exp((total[k:] - total[:-k]) / k)
            # Of k lengths, (1) falls with mu.
            i = np.where(np.isnan(expected), np.inf, expected).argmin(0)
            mu = n * expected[i, bones]
            ratio = k * np.log(k / mu) + (n - k) * np.log(np.maximum(n - k, 1) / np.maximum(n - mu, 1))  # (1)
            surprise = np.where(mu < k, ratio - 2 * np.log(np.maximum(n, 1)), -np.inf)
            better = surprise > np.maximum(best, SURPRISE)
            at, held, best = np.where(better, i, at), np.where(better, k, held), np.maximum(surprise, best)
    first, last = _taken(x, at), _taken(x, at + held - 1)
    length = (_taken(x, at + (held - 1) // 2) + _taken(x, at + held // 2)) / 2
    mode = best > SURPRISE
    # The shortest half of a normal distribution is 1.35 standard deviations wide; most of an interval is about 3.
    spread = np.maximum((last - first) / np.where(mode, 3, 1.35), floor)
    return length, spread, np.where(mode, held / np.maximum(n, 1), 0.9), best


def _taken(x, rank):
    """x at a rank of each column, (bone,) or (rank, bone)."""
    if not len(x):
        return np.full(x.shape[1], np.nan)
    found = np.take_along_axis(x, np.clip(np.atleast_2d(rank), 0, len(x) - 1), 0)
    return found if np.ndim(rank) > 1 else found[0]


def _log_smooth(x, n, floor):
    """log b at each length: a kernel density from at most 32 ranks.

    The bandwidth is 0.3 standard deviations, and the kernel Student's with 3 degrees of freedom: with normal tails a
    lone length far out has next to no density, and two of them make a mode.
    """
    if not len(x):
        return x
    centres = _taken(x, np.round(np.linspace(0, 1, 32)[:, None] * np.maximum(n - 1, 0)).astype(int))
    bandwidth = 0.3 * np.maximum(_column(np.nanstd, x, n), 3 * floor)
    # A reciprocal and a product: NumPy's power of -2 takes ten times as long.
    part = 1 / (1 + ((x[:, None] - centres) / bandwidth) ** 2 / 3)
    return np.log(0.3676 * (part * part).mean(1) / bandwidth)


def _mixture(x, length, spread, share, unit, floor, moves=True):
    """Step 2: length, spread (bone,), p (rank, bone) and background (bone, 2); `length` stays unless it `moves`."""
    known = np.isfinite(x)
    count, values = np.maximum(known.sum(0), 1), np.where(known, x, 0)
    p = known * share
    background = _rest(x, known * 1.0, length, unit)
    for _ in range(STEPS):
        before, p = p, np.where(known, _intact(values, length, spread, share, background), 0)
        mass = np.maximum(p.sum(0), 1e-9)
        share = p.sum(0) / count  # (2)
        length = (p * values).sum(0) / mass if moves else length
        spread = np.maximum(np.sqrt((p * (values - length) ** 2).sum(0) / mass), floor)
        background = _rest(x, known - p, length, unit)  # (3)
        if np.abs(p - before).max(initial=0) < STILL:
            break
    # The mean takes one degree of freedom.
    return length, spread * np.sqrt(np.maximum(p.sum(0) / np.maximum(p.sum(0) - moves, 0.5), 1)), p, background


def _rest(x, q, length, unit):
    """Eq. 3: mean and standard deviation (bone, 2) of the lengths weighted by q (rank, bone)."""
    d = np.where(np.isfinite(x), x - length, 0)
    mass = q.sum(0) + PRIOR
    mean = (q * d).sum(0) / mass
    variance = ((q * (d - mean) ** 2).sum(0) + PRIOR * (mean**2 + unit**2)) / mass
    return np.stack([length + mean, np.sqrt(variance)], 1)


def _intact(x, length, spread, share, background):
    """Probability that each length is intact."""
    share = np.clip(share, 1e-4, 1 - 1e-6)
    odds = _log_normal(x, length, spread) - _log_normal(x, *background.T) + np.log(share / (1 - share))
    return 1 / (1 + np.exp(-np.clip(odds, -700, 700)))


def _log_likelihood(x, length, spread, share, background):
    """Of each column of the mixture."""
    share = np.clip(share, 1e-4, 1 - 1e-6)
    parts = np.log(share) + _log_normal(x, length, spread), np.log1p(-share) + _log_normal(x, *background.T)
    return np.logaddexp(*parts).sum(0)


def _log_normal(x, mean, deviation):
    """Without the constant."""
    return -np.log(deviation) - 0.5 * ((x - mean) / deviation) ** 2


def _log_student(x, mean, scale):
    """Without the constant, which differs from the normal one by 6 %."""
    return -np.log(scale) - (FREEDOM + 1) / 2 * np.log1p(((x - mean) / scale) ** 2 / FREEDOM)


def _judged(length, spread, share, background, count, unit, mode: np.ndarray | bool = True, pooled=None):
    """Step 3, and which bones are rigid, where `pooled` is the estimate without the pooling."""
    some = count > 0
    agreeing = share * count
    freedom = agreeing - 1 if pooled is None else np.full(len(count), agreeing.sum())
    table, t = np.array(STUDENT).T
    quantile = np.where(freedom > 0, np.interp(1 / np.maximum(freedom, 1), 1 / table, t), np.inf)
    # Scatter without a mode says no more of where the length is than a single measurement.
    held = np.where(mode | (spread <= WIDE * unit), np.maximum(agreeing, 1), 1)
    half = np.maximum(quantile * spread / np.sqrt(held), RESOLUTION * unit)
    interval = np.stack([np.maximum(length - half, 0), length + half], 1)
    rigid = some & (freedom > 0) & (spread <= WIDE * unit)
    alike = pooled or BoneLengths(length, spread, share, rigid, interval, background)
    good = some & (alike.spread <= WIDE * unit)
    if good.any():
        usual, scale = np.median(alike.share[good]), np.median(alike.spread[good])
        # A count has a standard deviation of its square root, and none is a frequent outcome where three are expected.
        rigid &= agreeing + 2 * np.sqrt(agreeing) + 3 >= RARE * usual * count
        rigid &= spread <= np.maximum(LOOSE * scale, STEADY * length)
        rigid &= mode | (good.sum() > some.sum() / 2)
    blank = np.where(some, 1.0, np.nan)
    return BoneLengths(
        length * blank, spread * blank, share, rigid, interval * blank[:, None], background * blank[:, None]
    )
