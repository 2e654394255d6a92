"""Joints that trade places for a run of frames: left and right, a whole limb, two neighbours.

A tracker that exchanges two labels leaves samples that are each right and in the wrong place. To a model of outliers
they are a long run of gross errors in two joints; undone, they are data (Karashchuk et al., "Anipose", Cell Reports 36,
2021, meet them in video, and search the best of several detections along time).

Problem. For each candidate exchange (`candidates`: pairs of joints that trade places together) find the states
s_t in {0 normal, 1 exchanged} that minimise

    sum_t [s_t = 1] (b_t + e)  +  sum_t [s_t != s_{t-1}] (c_t + λ)  +  λ [s_1 = 1]  +  λ [s_T = 1]

- continuity: c_t = cross - same. `same` says how badly the two joints of a pair follow their own past, `cross` how
  badly each follows the other's: 2 log(1 + (r/σ)²) a joint, minus the log-likelihood of a Cauchy error in space, which
  an outlier cannot outvote. r is the distance to where the joint was last or would be at constant velocity, whichever
  is nearer, a frame of waiting, so that a gap makes tolerant; it counts up to `REACH`. σ is the joint's median r in the
  clip. A pair that is unseen has no opinion; until it is seen again it holds what its next sample has against a switch.
- bones: b_t = exchanged - normal. A joint costs the sum of log(1 + (d/s)²) over its bones, and no more than `OUTLIER`:
  a sample that is thrown costs the same wherever it is put. d is the deviation from the bone's length, s its robust
  deviation in the clip; a bone that is not kept to within `LOOSE` is no witness.
- λ = `SWITCH` for each end of a run; e is tiny. A run and its complement have the same ends, so where the bones are
  silent (a whole limb) the labelling of most frames wins.

That is a shortest path through two states (Viterbi, "Error bounds for convolutional codes", IEEE Trans. Information
Theory 13, 1967), found for all frames at once by prefix and suffix sums of min-plus 2 x 2 matrices (Hassan, Särkkä &
García-Fernández, "Temporal parallelization of inference in hidden Markov models", IEEE Trans. Signal Processing 69,
2021). The run that gains most is undone first, then whatever it touches is looked at again.

Everything is measured against the clip itself, so the answer turns, moves and scales with it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from motionrecover.evidence.bone_lengths import estimate_bone_lengths
from motionrecover.runs import runs_of
from motionrecover.skeleton import Skeleton, bone_lengths

# Measured on 213 clips of the CMU database at 120 and 30 Hz, clean and under `corrupt.PROTOCOLS`, and with exchanges of
# 5 to 100 frames with and without 3 mm noise and 5 % thrown samples. A third prediction in r, from the sample before
# the last, would forgive an outlier there, and lets a limb switch for one frame and back for next to nothing: dropped.
LEAST_FRAMES = 3
"""A shorter run is an outlier of two joints, and left to the solver."""
SWITCH = 10.0
"""Cost of either end of a run: chance has to offer the evidence of odds of e^20 to make one."""
SUPPORT = 8.0
"""What continuity has to say for the two ends together. Without, bones that change their length for long (a thumb of
the Kinect) or are mostly corrupted (`iid-50`) make runs on their own; with 5, one clip in 400 under `kinect`."""
OUTLIER = 4.0
"""Largest cost of a joint's bones in a frame. With a cap for each bone instead, a thrown sample is cheaper in a joint
with fewer bones: false runs in one clip of seven under `iid-20`."""
REACH = 1.0
"""Median bone lengths. A joint farther than this from all predictions is as good as anywhere."""
LOOSE = 0.15
"""Median bone lengths. Under `iid-50` three bones of four have a corrupted end, and say what suits them."""
STEADY = 0.35
"""Share of the frames in which a witness keeps its length: its s is this quantile of d, by that of a normal error."""
KEPT = 0.02
"""Median bone lengths. No bone is kept better than this, so that rigid clips do not overstate a bent one."""
STILL = 0.003
"""Median bone lengths. No joint is predicted better than this, for the same reason."""
APART = 1.0
"""A pair that is nearer than this share of its two σ together, in the median, cannot be told apart."""
TIE = 0.01
"""e: of a run and its complement, the shorter one."""


@dataclass(frozen=True, order=True)
class Swap:
    """Two joints that have each other's samples from frame `start` up to, not including, `stop`."""

    first_joint: int
    second_joint: int
    start: int
    stop: int


def undo(samples: np.ndarray, swaps: Iterable[Swap]) -> np.ndarray:
    """Samples (frame, joint, ...) of any kind, a copy with the swaps taken back. Doing it twice changes nothing."""
    out = np.array(samples)
    for swap in swaps:
        run, pair = slice(swap.start, swap.stop), [swap.first_joint, swap.second_joint]
        out[run, pair] = out[run, pair[::-1]]
    return out


def find_swaps(positions: np.ndarray, skeleton: Skeleton, bone_lengths: np.ndarray | None = None) -> list[Swap]:
    """The swaps in positions (frame, joint, 3), NaN where missing: what `undo` is to take back, sorted.

    `bone_lengths` (bone,) in the unit of the positions, NaN where unknown; left out, they are estimated. No two of the
    swaps share a joint in a frame, so their order does not matter. Without bones nothing has a scale, and nothing is
    found.

    What cannot be found: swaps shorter than `LEAST_FRAMES`; of joints nearer than the error of their prediction; of
    whole limbs for more than half of the clip, where the rest is taken for exchanged; and those that start or stop in
    a gap so long that no past tells the two joints apart.
    """
    positions = np.array(positions, np.float64)
    positions[~np.isfinite(positions).all(-1)] = np.nan
    if bone_lengths is None:
        bone_lengths = estimate_bone_lengths(skeleton.bone_lengths_of(positions)).length
    lengths = np.asarray(bone_lengths, np.float64)
    size = _quantile(lengths[lengths > 0])
    if not (size > 0 and len(positions) >= LEAST_FRAMES):
        return []
    deviation = np.abs(skeleton.bone_lengths_of(positions) - lengths)
    spread = np.maximum([_quantile(column, STEADY) / 0.454 for column in deviation.T], KEPT * size)
    spread = np.where(spread < LOOSE * size, spread, np.inf)  # NaN, for a bone without length or frame, is no witness
    past = _past(np.isfinite(positions[..., 0]))
    sigma = np.fmax([_quantile(column) for column in _misfit(positions, positions, *past).T], STILL * size)

    def apart(pair):
        i, j = pair
        distance = _quantile(np.linalg.norm(positions[:, i] - positions[:, j], axis=-1))
        return distance > APART * (sigma[i] + sigma[j])

    exchanges = [tuple(filter(apart, exchange)) for exchange in candidates(skeleton)]
    exchanges = list(dict.fromkeys(filter(None, exchanges)))
    if not exchanges:
        return []
    pairs = sorted({pair for exchange in exchanges for pair in exchange})
    members = np.array([[pair in exchange for exchange in exchanges] for pair in pairs], float)
    first, second = np.array(pairs).T

    found: list[Swap] = []
    taken = np.zeros(positions.shape[:2], bool)
    switches = np.zeros((len(positions), len(pairs)))
    runs: dict[int, tuple[float, int, int]] = {}
    touched = set(range(len(skeleton.names)))
    while True:
        stale = [p for p, pair in enumerate(pairs) if touched & set(pair)]
        switches[:, stale] = _continuity(positions, first[stale], second[stale], sigma, REACH * size)
        ends = switches @ members
        for c, exchange in enumerate(exchanges):
            if touched & {joint for pair in exchange for joint in pair}:
                runs.pop(c, None)
                # No two frames of such a candidate can reach `SUPPORT`: in a clean clip that is nearly all of them.
                if ends[:, c].min() <= -SUPPORT / 2:
                    bones = _bones(positions, skeleton, lengths, spread, exchange)
                    blocked = taken[:, np.ravel(exchange)].any(1)
                    seen = np.isfinite(positions[:, exchange, 0]).all(-1).any(-1)
                    if (run := _best_run(ends[:, c], bones, seen, blocked)) is not None:
                        runs[c] = run
        if not runs:
            return sorted(found)
        c = max(runs, key=runs.__getitem__)
        _, start, stop = runs[c]
        swaps = [Swap(i, j, start, stop) for i, j in exchanges[c]]
        positions = undo(positions, swaps)
        found += swaps
        moved = set(np.ravel(exchanges[c]).tolist())
        taken[start:stop, sorted(moved)] = True
        touched = moved.union(*(bone for bone in skeleton.edges if moved & set(bone)))


def candidates(skeleton: Skeleton) -> list[tuple[tuple[int, int], ...]]:
    """What may trade places: tuples of pairs of joints that do so together.

    The left/right pairs of `Skeleton.mirror`, each alone and with all pairs beyond it (an arm from the elbow on), and
    the two joints of each bone.
    """
    mirror, other = skeleton.mirror, skeleton.other_side
    neighbours: list[list[int]] = [[] for _ in skeleton.names]
    for i, j in skeleton.edges:
        neighbours[i].append(j)
        neighbours[j].append(i)
    # Bones to the nearest joint that has no other side: what is beyond a joint is farther than it.
    ring = [joint for joint in range(len(skeleton.names)) if other[joint] == joint]
    depth = dict.fromkeys(ring, 0)
    while ring:
        ring = [k for joint in ring for k in neighbours[joint] if depth.setdefault(k, depth[joint] + 1) > depth[joint]]
        ring = list(dict.fromkeys(ring))
    limbs = []
    for left, _ in mirror:
        limb = [left]
        for joint in limb:  # grows while it is read
            beyond = [k for k in neighbours[joint] if other[k] != k and depth.get(k, 0) > depth.get(joint, 0)]
            limb += [k for k in beyond if k not in limb and other[k] not in limb]
        limbs.append(tuple((joint, other[joint]) for joint in limb))
    bones = [((i, j),) for i, j in skeleton.edges if other[i] != j]
    return list(dict.fromkeys([*(((pair),) for pair in mirror), *limbs, *bones]))


def _past(seen):
    """For samples (frame, column): the frames of the last two seen before, -1 without."""
    frames = np.arange(len(seen))[:, None]
    last = np.maximum.accumulate(np.where(seen, frames, -1), 0)
    last = np.concatenate([np.full_like(last[:1], -1), last[:-1]])
    return last, np.where(last >= 0, np.take_along_axis(last, np.maximum(last, 0), 0), -1)


def _misfit(now, before, last, earlier):
    """r (frame, column): how far, a frame, `now` is from what the frames `last` and `earlier` of `before` predict.

    NaN where either has no sample.
    """
    frames = np.arange(len(now))[:, None]

    def at(index):
        return np.where((index >= 0)[..., None], np.take_along_axis(before, np.maximum(index, 0)[..., None], 0), np.nan)

    one, elapsed = at(last), (frames - last)[..., None]
    moved = (one - at(earlier)) / np.maximum(last - earlier, 1)[..., None] * elapsed
    return np.fmin(*(np.linalg.norm(now - place, axis=-1) for place in (one, one + moved))) / elapsed[..., 0]


def _continuity(positions, first, second, sigma, reach):
    """c (frame, pair): what it costs to follow the other's past instead of one's own, from this frame on."""
    a, b = positions[:, first], positions[:, second]
    past = _past(np.isfinite(a[..., 0]) & np.isfinite(b[..., 0]))

    def cost(now, before, joints):
        return 2 * np.log1p((np.minimum(_misfit(now, before, *past), reach) / sigma[joints]) ** 2)

    switch = cost(a, b, first) + cost(b, a, second) - cost(a, a, first) - cost(b, b, second)
    # In a gap, only what speaks against a switch counts: what speaks for it would count again at the gap's end.
    frames, count = np.arange(len(switch))[:, None], len(switch)
    following = np.minimum.accumulate(np.where(np.isnan(switch), count, frames)[::-1])[::-1]
    held = np.take_along_axis(np.concatenate([switch, np.zeros_like(switch[:1])]), following, 0)
    return np.where(following == frames, held, np.maximum(held, 0))


def _bones(positions, skeleton, lengths, spread, exchange):
    """b (frame,): what the bones of the joints cost more when these are exchanged; 0 for a bone without both ends."""
    turned = np.arange(len(skeleton.names))
    for i, j in exchange:
        turned[[i, j]] = j, i
    edges = np.array(skeleton.edges)
    # A bone that takes its own place says nothing, nor does one that is no witness.
    witness = (np.sort(turned[edges], 1) != np.sort(edges, 1)).any(1) & np.isfinite(spread)
    edges, lengths, spread = edges[witness], lengths[witness], spread[witness]

    def costs(ends):
        return np.log1p(((bone_lengths(positions, ends) - lengths) / spread) ** 2)

    normal, exchanged = costs(edges), costs(turned[edges])
    unknown = np.isnan(normal) | np.isnan(exchanged)
    normal, exchanged = np.where(unknown, 0, normal), np.where(unknown, 0, exchanged)
    more = np.zeros(len(positions))
    for joint in np.ravel(exchange):
        mine = (edges == joint).any(1)
        more += np.minimum(exchanged[:, mine].sum(1), OUTLIER) - np.minimum(normal[:, mine].sum(1), OUTLIER)
    return more


def _best_run(ends, bones, seen, blocked):
    """(gain, start, stop) of the exchanged run on the shortest path that gains most, None without one."""
    exchanged = runs_of(_states(ends, bones))
    total, ends = np.append(0, np.cumsum(bones)), np.append(ends, 0)
    ends[0] = 0
    best = None
    for start, stop in exchanged:
        support = -(ends[start] + ends[stop])
        gain = support - (total[stop] - total[start]) - 2 * SWITCH
        # Nothing says on which side of an end that lies in a gap the gap is, so it is left as it came.
        known = start + np.flatnonzero(seen[start:stop])
        run = slice(known[0], known[-1] + 1) if len(known) else slice(0, 0)
        usable = run.stop - run.start >= LEAST_FRAMES and support >= SUPPORT and not blocked[run].any()
        if usable and gain > (best[0] if best else 0):
            best = float(gain), int(run.start), int(run.stop)
    return best


def _states(ends, bones):
    """Whether a frame is exchanged on the shortest path."""
    count = len(ends)
    stay, switch = np.zeros((2, count)), ends + SWITCH
    stay[1] = bones + TIE
    step = np.array([[stay[0], switch + stay[1]], [switch, stay[1]]])  # from, to, frame
    step[:, :, 0] = np.stack([[0, SWITCH + stay[1, 0]]] * 2)
    until, after = step.copy(), step.copy()
    reach = 1
    while reach < count:
        until[..., reach:] = _min_plus(until[..., :-reach], until[..., reach:])
        after[..., :-reach] = _min_plus(after[..., :-reach], after[..., reach:])
        reach *= 2
    close = np.array([0, SWITCH])
    rest = np.concatenate([(after[..., 1:] + close[:, None]).min(1), close[:, None]], 1)
    normal, exchanged = until[0] + rest
    return exchanged < normal


def _min_plus(a, b):
    """Products (from, to, frame) of matrices whose sum is the minimum and whose product is the sum."""
    return np.minimum(a[:, :1] + b[:1], a[:, 1:] + b[1:])


def _quantile(values, share=0.5):
    """Quantile of what is no NaN; NaN where all is."""
    known = values[~np.isnan(values)]
    return np.quantile(known, share) if len(known) else np.nan
