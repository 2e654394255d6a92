"""Clips with planted corruption and recoveries of them that took no work, for the tests of the report."""

from dataclasses import replace

import numpy as np

from motionrecover.evidence.swaps import Swap
from motionrecover.motion import Motion
from motionrecover.recovery import Recovery
from motionrecover.robust import Change
from motionrecover.skeleton import Skeleton
from motionrecover.solver import Result
from motionrecover.synthetic import synthesize

EVIL = "<script>alert(1)</script>"
SPIKE, GAP, SWAP = (70, 4), (slice(20, 40), 10), Swap(5, 9, 90, 100)


def recovery_of(clip, positions, changed, **fields):
    """A recovery without the work of one."""
    lengths = clip.skeleton.bone_lengths_of(np.nan_to_num(positions))
    known = np.isfinite(positions[..., 0])
    recovery = Recovery(
        positions=positions.astype(np.float32),
        outliers=np.zeros_like(positions),
        weights=clip.observed * 1.0,
        changed=np.where(known, changed, Change.UNKNOWN).astype(np.uint8),
        uncertainty=np.where(known, np.where(clip.observed, 0.002, 0.06), np.inf),
        observed=clip.observed,
        swaps=(),
        bone_lengths=np.median(lengths, axis=0),
        bone_intervals=np.full((lengths.shape[1], 2), np.nan),
        skeleton=clip.skeleton,
        fps=clip.fps,
        result=Result.converged,
        steps=30,
        trace=None,
        seconds={"compile": 0.0, "run": 1.0},
    )
    return replace(recovery, **fields)


def planted():
    """A clip with a spike, a gap and a swap, its recovery and the truth; the joint with the spike has an evil name."""
    body = synthesize(2, 60, 0)
    names = list(body.names)
    names[SPIKE[1]] = EVIL
    truth = Motion(body.positions, Skeleton(names, body.skeleton.edges), 60.0)
    positions = truth.positions.copy()
    positions[SPIKE] += (0.3, 0, 0)
    positions[GAP] = np.nan
    positions[90:100, [5, 9]] = positions[90:100, [9, 5]]
    clip = truth.with_positions(positions, "corrupted")
    changed = np.full(clip.observed.shape, Change.UNTOUCHED)
    changed[SPIKE] = changed[90:100, [5, 9]] = Change.REPAIRED
    changed[GAP] = Change.FILLED
    return clip, recovery_of(clip, truth.positions, changed, swaps=(SWAP,)), truth


def large(frames, joints=50):
    """A long clip of noise with one spike of one frame, and its recovery."""
    rng = np.random.default_rng(0)
    t = np.arange(frames)[:, None, None] / 120
    truth = rng.normal(0, 0.4, (joints, 3)) + 0.3 * np.sin(t * rng.uniform(0.5, 6, (joints, 1)))
    positions = truth + rng.normal(0, 0.003, truth.shape)
    positions[7001, -1] += 0.3
    skeleton = Skeleton([f"joint {k}" for k in range(joints)], [(k, k + 1) for k in range(joints - 1)])
    changed = np.full(truth.shape[:2], Change.DENOISED)
    changed[7001, -1] = Change.REPAIRED
    clip = Motion(positions, skeleton, 120.0)
    return clip, recovery_of(clip, truth, changed)
