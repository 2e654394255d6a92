"""Bones of a marker cloud: pairs of markers that keep their distance throughout a take.

Optical markers come without a skeleton, but those on one segment of a body keep their distances, up to skin that slides
over bone. With d_ij the distances of a pair over the frames that show both, and U the median over the markers of the
distance to their `NEIGHBOURS`-th nearest one:

1. Spread. s_ij is the width of the shortest interval that holds `SHARE` of d_ij, as a standard deviation (the shorth's
   relative; Rousseeuw, "Least median of squares regression", JASA 79, 1984). A corrupted end makes a distance anything
   and does not make it narrower; a limb that moves in a quarter of the frames is still seen to move.
2. A pair is steady where s_ij <= `LOOSE` min(d_ij, U): a share of the distance itself, and no more for a pair across
   the body, whose distance varies little in proportion whatever the two do.
3. Edges. Each marker is tied to its `NEIGHBOURS` steadiest partners, which makes a segment of as many markers rigid.
   The minimum spanning forest of s_ij (Kruskal, Proc. AMS 7, 1956) ties what those leave apart and steady pairs join.

A marker without a steady pair gets no edge. How well an edge keeps its length, and whether it is to be held to it, is
for `evidence.bone_lengths`. Everything is relative to the distances of the take and counted in its frames: the edges do
not depend on unit, rate, position, heading, or on the order of the markers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NEIGHBOURS = 4
"""Distances from three others place a marker, but for its mirror image; from four, without."""
SHARE = 0.75
WIDTH = 2.3
"""Standard deviations that hold `SHARE` of a normal distribution."""
LOOSE = 0.1
TOGETHER = 0.25
"""Of the frames: a pair seen together in fewer, or in fewer than `LEAST_FRAMES`, says nothing."""
LEAST_FRAMES = 6
RESOLUTION = 1e-5
"""Of U: spreads below are rounding errors, and such pairs count by their distance."""
MOST_FRAMES = 2000
"""More are thinned evenly."""
AT_ONCE = 2**14
"""Distances."""


@dataclass(frozen=True, eq=False)
class RigidGraph:
    """The edges (i, j), i < j, sorted, and why each is one."""

    edges: tuple[tuple[int, int], ...]
    length: np.ndarray
    """(edge,): median distance."""
    spread: np.ndarray
    """(edge,): s, robust standard deviation of the distance."""
    frames: np.ndarray
    """(edge,): frames that show both."""


def infer_graph(positions: np.ndarray, observed: np.ndarray | None = None) -> RigidGraph:
    """Edges between the markers of positions (frame, marker, 3), in any unit, NaN where missing.

    `observed` (frame, marker): False marks further missing samples. Raises `ValueError` for misshapen arrays.
    """
    positions = np.asarray(positions, np.float64)
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise ValueError(f"received positions of shape {positions.shape}: give (frame, marker, 3)")
    frames, markers, _ = positions.shape
    seen = np.all(np.isfinite(positions), axis=-1)
    if observed is not None:
        if np.shape(observed) != seen.shape:
            raise ValueError(
                f"received observed of shape {np.shape(observed)}: the take has (frame, marker) = {seen.shape}"
            )
        seen &= np.asarray(observed, bool)
    first, second = np.triu_indices(markers, 1)
    count = seen.astype(np.float32)  # exact up to 16 million frames
    together = (count.T @ count)[first, second].astype(int)
    measured = positions if observed is None else np.where(seen[..., None], positions, np.nan)
    length, spread = spreads(measured, first, second)
    usable = (together >= max(LEAST_FRAMES, TOGETHER * frames)) & (length > 0)
    unit = _unit(length, usable, first, second, markers)
    steady = np.flatnonzero(usable & (spread <= LOOSE * np.minimum(length, unit)))
    order = steady[np.lexsort((length[steady], np.maximum(spread[steady], RESOLUTION * unit)))]
    kept = np.array(sorted(_chosen(first[order].tolist(), second[order].tolist(), order.tolist(), markers)), int)
    edges = tuple(zip(first[kept].tolist(), second[kept].tolist(), strict=True))
    return RigidGraph(edges, length[kept], spread[kept], together[kept])


def spreads(positions: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median and s (pair,) of the distances between the markers `first` and `second` of positions (frame, marker, 3).

    NaN and infinite for a pair that is never seen together. Some pairs at a time, for the sake of memory.
    """
    thin = positions[:: -(-len(positions) // MOST_FRAMES) or 1]
    length, spread = np.full(len(first), np.nan), np.full(len(first), np.inf)
    some = max(1, AT_ONCE // max(1, len(thin)))
    for pairs in np.array_split(np.arange(len(first)), range(some, len(first), some)):
        with np.errstate(over="ignore", invalid="ignore"):
            d = np.linalg.norm(thin[:, second[pairs]] - thin[:, first[pairs]], axis=-1)
        d = np.sort(np.where(np.isfinite(d), d, np.nan), 0)
        count = np.isfinite(d).sum(0)
        pairs, d, count = pairs[count > 0], d[:, count > 0], count[count > 0]
        last = np.ceil(SHARE * count).astype(int) - 1 + np.arange(len(d))[:, None]
        width = np.where(last < count, np.take_along_axis(d, np.minimum(last, len(d) - 1), 0) - d, np.inf)
        spread[pairs] = width.min(0, initial=np.inf) / WIDTH
        length[pairs] = np.take_along_axis(d, (count[None] - 1) // 2, 0)[0]
    return length, spread


def _unit(length, usable, first, second, markers):
    """U."""
    distance = np.full((markers, markers), np.inf)
    distance[first[usable], second[usable]] = distance[second[usable], first[usable]] = length[usable]
    if markers < 2:
        return 1.0
    kth = np.sort(distance, 1)[:, min(NEIGHBOURS, markers - 1) - 1]
    return float(np.median(kth[np.isfinite(kth)])) if np.isfinite(kth).any() else 1.0


def _chosen(first, second, pairs, markers):
    """Step 3 of pairs in order of their spread."""
    partners = [0] * markers
    group = list(range(markers))
    chosen = []
    for i, j, pair in zip(first, second, pairs, strict=True):
        apart = group[i] != group[j]
        if apart or min(partners[i], partners[j]) < NEIGHBOURS:
            chosen.append(pair)
        if apart:
            group = [group[i] if g == group[j] else g for g in group]
        partners[i] += 1
        partners[j] += 1
    return chosen
