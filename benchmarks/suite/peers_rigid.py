"""Peer that sees rigid bodies: gaps filled from donor joints that keep their distance, as Vicon Nexus does."""

from __future__ import annotations

import warnings

import gapfill
import numpy as np

from benchmarks.suite.peers_time import SHORT_GAP, cubic, despike, nothing

PASSES = 2
"""After the first pass every joint can be a donor, filled where it was missing."""


def rigid_donors(positions: np.ndarray, fps: float) -> np.ndarray:
    """Rigid-body gap filling with the package `gapfill` (Jung 2020), function `recover_marker_rbt`.

    Smolka & Lukasik, "The rigid body gap filling algorithm", HSI 2016. Spikes are set missing and gaps up to 0.1 s are
    filled by a spline before, as its users do. Each joint takes as donors the three joints whose distance to it varies
    least over the frames where both are seen: their rotation and translation since either side of the gap carry
    the joint, and the two answers fade into each other. The next three in that order fill what the first leave, and
    straight lines the rest. A second pass has the filled joints as donors too.
    """
    known = cubic(despike(positions), SHORT_GAP * fps)
    missing = np.any(np.isnan(known), axis=-1)
    donors_from = out = known
    for _ in range(PASSES):
        out = known.copy()
        for joint in np.flatnonzero(missing.any(0)):
            target = known[:, joint].copy()
            for donors in _clusters(known, joint):
                if not np.isnan(target).any():
                    break
                with warnings.catch_warnings():
                    # Its divisions leave vectors of length 0 unset; donors are never at one place.
                    warnings.simplefilter("ignore", UserWarning)
                    gapfill.recover_marker_rbt(target, donors_from[:, donors].transpose(1, 0, 2))
            out[:, joint] = target
        donors_from = out = nothing(out, fps)
    return out


def _clusters(positions: np.ndarray, joint: np.intp) -> list[np.ndarray]:
    """Donors for a joint: the three that keep their distance best, then the next three down the order."""
    distances = np.linalg.norm(positions - positions[:, [joint]], axis=-1)
    seen = np.isfinite(distances)
    seen[:, joint] = False
    usable = np.flatnonzero(seen.sum(0) > 1)
    spread = np.array([np.std(distances[seen[:, donor], donor]) for donor in usable])
    order = usable[np.argsort(spread)]
    return [order[k : k + 3] for k in range(len(order) - 2)]
