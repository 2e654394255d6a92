"""What the smoother found, completed in gaps and held to the bones: steps 4 to 6 of `motionrecover.robust`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import jax
import numpy as np

from motionrecover.evidence.bone_errors import drift, slack
from motionrecover.evidence.bone_lengths import BoneLengths
from motionrecover.isometry.objective import Edges
from motionrecover.isometry.projection import project
from motionrecover.programs import prepare, run
from motionrecover.runs import run_lengths
from motionrecover.skeleton import bone_lengths
from motionrecover.solver import Smoother
from motionrecover.solver.smoother import INTACT
from motionrecover.whittaker import whittaker

SHORT = 4
"""Frames. In gaps shorter than this the smoother predicts better than the other joints do."""
INDEPENDENT = 0.2
"""Share of the variance after the projection that a frame does not have in common with its neighbours. Bones of a depth
camera jitter, and a projection frame by frame makes of that jitter of quiet joints: their second differences fall to
5-15 times less with this than they were measured with, and 2-6 times without. 3 mm of noise at 30 Hz comes out at 2.72
instead of 2.75 mm; with 1, at 2.70 mm and accelerations of 0.87 of the truth's instead of 0.93."""
FREE = 1e3
"""Median bones: the standard deviation of a bone's length that holds nothing."""
TURNS = 5
"""In which kept samples are hidden from `_interpolated`, each once."""
STEADY = 9
"""Frames of the running median of variances in gaps. The regression doubts single frames, in which another joint is
thrown; the projection would move the joint in them alone."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known about some frames: arrays (frame, joint, ...)."""

    merged: np.ndarray
    """The samples, straight lines where missing."""
    trust: np.ndarray
    """In each sample; 0 where missing."""
    positions: np.ndarray
    covariance: np.ndarray
    """(frame, joint, joint) of the error of one axis. It is large, and the functions below change it in place."""
    intact: np.ndarray
    """Probability that a sample is; 0 where missing."""
    drive: np.ndarray
    """Variance of the second difference."""
    noise: np.ndarray
    """Variance of one axis of an intact sample of full trust."""

    @property
    def kept(self) -> np.ndarray:
        """Samples (frame, joint) that are used as intact."""
        return self.intact > INTACT

    @property
    def variance(self) -> np.ndarray:
        """Of the error of one axis."""
        return np.maximum(np.einsum("tjj->tj", self.covariance), 0)

    @property
    def measured(self) -> np.ndarray:
        """The kept samples, NaN for the others."""
        return np.where(self.kept[..., None], self.merged, np.nan)

    def of(self, part: slice) -> Estimate:
        """The same of some frames."""
        return Estimate(*(getattr(self, field.name)[part] for field in fields(self)))


Predict = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From positions, kept samples, and those to predict: predictions, and variances, infinite where there are none."""


def fill_gaps(found: Estimate, exact: bool, scale: float, predict: Predict) -> Estimate:
    """Steps 4 and 5: the smoother's and the other joints' predictions averaged, gaps smoothed along time.

    Of an `exact` clip, kept samples are as they came, and short gaps meet them.
    """
    kept, positions, before = found.kept, found.positions, found.variance
    if exact:
        short = ~kept & (run_lengths(~kept) < SHORT)
        if short.any():
            positions = np.where(short[..., None], _interpolated(found, scale), positions)
        positions = np.where(kept[..., None], found.merged, positions)
    positions, variance = _with_regression(positions, before, kept, found.drive, predict)
    if exact:
        variance[kept] = 0
    ratio = np.sqrt(variance / np.maximum(before, np.finfo(float).tiny))
    covariance = found.covariance
    covariance *= ratio[:, :, None]
    covariance *= ratio[:, None]
    return replace(found, positions=positions)


def hold(
    found: Estimate, bones: BoneLengths, edges: Edges, exact: bool, scale: float, block: int, seconds: dict[str, float]
) -> tuple[Estimate, np.ndarray]:
    """Step 6: positions on the bone lengths, and the variance (frame, joint) of what is left of their errors.

    `block`: frames that go through the program at a time; its times are added to `seconds`.
    """
    covariance, joints = found.covariance, found.positions.shape[1]
    measured = bone_lengths(found.measured, edges)
    held, varies = bones.rigid, np.zeros(len(bones.length))
    if len(edges) >= joints:
        varies = slack(measured, bones, joints)
    elif not exact:
        held = np.ones(len(held), bool)
        weights = np.where(found.kept, found.trust, 0)
        covariance += np.diag(drift(bones.length, found.positions, covariance, weights, edges))
    held = held & np.isfinite(bones.length)
    length, varies = np.where(held, bones.length, 0), np.where(held, varies, (FREE * scale) ** 2)
    positions, left = project_blocks(found.positions, covariance, length, varies, edges, block, seconds)
    if not exact:
        steady = whittaker(positions, INDEPENDENT * found.variance, found.drive)
        positions, left = project_blocks(steady, covariance, length, varies, edges, block, seconds)
        return replace(found, positions=positions), left
    off = np.abs(bone_lengths(positions, edges) - length) > Smoother.FLOOR * scale
    broken = (off & np.isnan(measured) & held & (varies == 0)).any(1)
    intact = found.intact
    if broken.any():
        # An outlier passed for intact, and its neighbours cannot be where its bones lead: least trusted, it moves.
        doubt = np.maximum(1 - intact[broken], 1e-6)[:, :, None] * np.eye(joints)
        loose = covariance[broken] + (Smoother.GROSS * scale) ** 2 * doubt
        positions[broken], left[broken] = project_blocks(
            positions[broken], loose, length, varies, edges, block, seconds
        )
        kept = found.kept & (np.linalg.norm(positions - found.merged, axis=-1) < Smoother.FLOOR * scale)
        intact = np.where(kept, intact, np.minimum(intact, INTACT))
    return replace(found, positions=positions, intact=intact), left


def prepare_projection(joints: int, edges: Edges, block: int) -> None:
    """Begin to compile the program of `project_blocks`, while the smoother's is made."""
    shapes = {
        "positions": (block, joints, 3),
        "covariance": (block, joints, joints),
        "bone_lengths": (len(edges),),
        "slack": (len(edges),),
    }
    arrays = {name: jax.ShapeDtypeStruct(shape, np.dtype("float64")) for name, shape in shapes.items()}
    prepare(project, arrays, {"edges": edges})


def project_blocks(
    positions: np.ndarray,
    covariance: np.ndarray,
    lengths: np.ndarray,
    slack: np.ndarray,
    edges: Edges,
    block: int,
    seconds: dict[str, float],
) -> list[np.ndarray]:
    """The two answers of `isometry.projection.project`, in blocks of so many frames, so that one program does."""
    out = []
    for start in range(0, len(positions), block):
        part = slice(start, start + block)
        pad = ((0, block - len(positions[part])), (0, 0), (0, 0))
        arrays = {
            "positions": np.pad(positions[part], pad),
            "covariance": np.pad(covariance[part], pad),
            "bone_lengths": lengths,
            "slack": slack,
        }
        answer = run(project, arrays, {"edges": edges}, seconds)
        out.append([np.asarray(x)[: len(positions[part])] for x in answer])
    return [np.concatenate(parts) for parts in zip(*out, strict=True)]


def _interpolated(found, scale):
    """Positions between kept samples that are exact, from two predictions averaged.

    One is the smoother's, with what kept samples are off from it interpolated: it knows what moves together. The other
    is the spline of least third differences of a joint's own samples, for what moves alone, as markers on skin: with
    10 % of the samples missing, 0.27 instead of 0.32 mm, 0.37 of 0.45, 0.04 of 0.07 and 1.25 of 1.40. They count, joint
    by joint, by error^-8 on kept samples, which are hidden a part at a time. The smoother's error on a hidden sample is
    its residual / (1 - P / s^2), P its variance with the sample (leave-one-out: Wahba, "Spline Models for Observational
    Data", 1990, Sec. 4.2). Beyond the first and last kept sample, where a spline runs away, the smoother is alone.
    """
    kept, far = found.kept, (FREE * scale) ** 2
    residual = np.where(kept[..., None], found.merged - found.positions, 0)
    start = np.where(kept[..., None], found.merged, found.positions)
    even = np.full(kept.shape, scale**2)

    def bridged(known):
        return whittaker(np.where(known[..., None], residual, 0), np.where(known, 0, far), found.drive)

    def spline(known):
        return whittaker(start, np.where(known, 0, far), even, order=3)

    left_out = residual / (1 - np.minimum(found.variance * found.trust / found.noise, 1 - 1e-6))[..., None]
    turn, errors = np.cumsum(kept, 0) % TURNS, np.zeros((2, kept.shape[1]))
    for k in range(TURNS):
        rest = kept & (turn != k)
        hidden = kept & ~rest & _between(rest)
        for which, error in enumerate((left_out - bridged(rest), start - spline(rest))):
            errors[which] += np.where(hidden, (error**2).sum(-1), 0).sum(0)
    first, second = (errors / np.maximum(errors.max(0), np.finfo(float).tiny)) ** 4
    share = np.where(_between(kept), first / np.maximum(first + second, 1), 0)
    smoothed = found.positions + bridged(kept)
    return smoothed + share[..., None] * (spline(kept) - smoothed)


def _between(known):
    """Samples (frame, joint) with a known one before and behind."""
    return np.maximum.accumulate(known, 0) & np.maximum.accumulate(known[::-1], 0)[::-1]


def _with_regression(positions, variance, kept, drive, predict):
    """Positions and variances with the regression's predictions averaged into longer gaps."""
    gaps = run_lengths(~kept) >= SHORT
    if not gaps.any():
        return positions, variance.copy()
    predicted, doubt = predict(positions, kept, gaps)
    used = gaps & np.isfinite(doubt)
    weight = np.where(used, variance / np.maximum(variance + doubt, np.finfo(float).tiny), 0)
    positions = positions + weight[..., None] * (predicted - positions)
    variance = np.where(used, weight * np.where(used, doubt, 0), variance)
    positions = np.where(gaps[..., None], whittaker(positions, variance, drive), positions)
    return positions, np.where(gaps, np.minimum(variance, _running_median(variance)), variance)


def _running_median(x):
    """Median of `STEADY` frames of x (frame, joint), mirrored at its ends."""
    padded = np.pad(x, ((STEADY // 2, STEADY // 2), (0, 0)), mode="symmetric")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, STEADY, axis=0), axis=-1)
