"""The `robust` preset: what the clip itself shows about noise, outliers, bones and motion, put together.

    1. Runs of swapped joints are put right (evidence.swaps).
    2. Bones get their length, and how well it is kept (evidence.bone_lengths); the drive its first guess.
    3. Outliers, noise level and drive are found with the motion (solver.smoother), in windows that overlap.
    4. Samples without an intact one for some frames are also predicted from the other joints (evidence.regression);
       the two predictions are averaged by their variances. The smoother is sure beside intact samples, the regression
       in the middle of a gap. In shorter gaps of a clip without noise a spline of the joint's own samples counts beside
       the smoother.
    5. Inside gaps these are smoothed along time (whittaker): a regression knows frames and no paths. Without it, joints
       jump by up to 5 cm in gaps of a noisy clip.
    6. Positions move onto the bone lengths, uncertain ones first (isometry.projection). A clip without noise shows
       which bones are rigid, and only those are held. In a noisy one all bones of a tree are: that a length varies is
       the noise's doing. There a length is the median in the smoothed positions, by how much the bones still vary says
       how uncertain the joints are beyond what smoothing finds (evidence.bone_errors), and the outcome is smoothed and
       projected once more. Bones that close cycles, as between markers of a segment, are held as fast as they vary.
    7. What nothing speaks for stays NaN.

Lengths enter only as multiples of the median bone, times as frames of the clip: units, frame rate, origin and heading
do not matter. Everything is float64: variances of missing and of noiseless samples are nine orders of magnitude apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import partial

import jax
import numpy as np

from motionrecover import windows
from motionrecover.body import Body
from motionrecover.estimate import Estimate, fill_gaps, hold, prepare_projection
from motionrecover.evidence import regression
from motionrecover.evidence.bone_errors import smoothed_lengths
from motionrecover.evidence.bone_lengths import BoneLengths, estimate_bone_lengths, scale_about, symmetric
from motionrecover.evidence.pose_prior import Poses, median_distances, proportioned
from motionrecover.evidence.regression import bone_distance, predict_missing
from motionrecover.evidence.rest_pose import begins_at_rest
from motionrecover.intake import Intake
from motionrecover.presets import Robust
from motionrecover.programs import bucket, run
from motionrecover.runs import run_lengths
from motionrecover.skeleton import bone_lengths
from motionrecover.solver import Result, Smoother, Solution, solve

BODY = 3
"""Intact joints that place a body in space."""
LONG = 10
"""Frames. Over a longer run with fewer than `BODY` intact joints nothing says what the others did."""
POSES = 400
"""That take part in gaps, mirror images among them. With 800, three gaps of 240 frames come out the same."""
NOISY, ALL = 0.2, 0.7
"""Noise above this many median bones that, with the outliers, is this share of all that varies leaves no motion to see.
A walker whose every sample is displaced by 25 cm is still found to 6 cm, and stays below the second."""


class Change(IntEnum):
    """What happened to a sample."""

    UNTOUCHED = 0
    DENOISED = 1
    REPAIRED = 2
    FILLED = 3
    UNKNOWN = 4


@dataclass(frozen=True, eq=False)
class Restored:
    """The answer on the solver's joints, arrays (frame, joint, ...)."""

    positions: np.ndarray
    """NaN where unknown."""
    variance: np.ndarray
    """Of the error of one axis."""
    intact: np.ndarray
    """Probability that a sample is; 0 where missing and where all that is measured is noise."""
    noise: float
    """Standard deviation of a measured sample on one axis."""
    exact: bool
    """Whether the clip has no noise to remove: intact samples are then as they came."""
    bones: BoneLengths
    solutions: list[Solution]


def restore(
    clip: Intake,
    preset: Robust,
    given: bool,
    mirrored: Sequence[tuple[int, int]],
    poses: Poses | None,
    max_steps: int,
    seconds: dict[str, float],
    workers: int,
    progress: Callable[[int, int], None] | None,
) -> Restored:
    """Steps 2 to 7, for a clip whose joints are all observed somewhere.

    `given`: the bone lengths are not estimates. `mirrored`: pairs of bones whose estimates are drawn together.
    `poses` of other people with the clip's joints, where it is known what these are.
    `workers`, `progress`: see `windows.solved`.
    """
    observed = clip.merged_weights > 0
    data = np.where(observed[..., None], clip.merged, np.nan)
    lengths = bone_lengths(data, clip.edges)
    bones = scale_about(lengths, clip.edge_lengths) if given else symmetric(estimate_bone_lengths(lengths), mirrored)
    body = Body.of(data, lengths, bones)
    scale, exact = body.scale, body.exact
    at_rest = exact and begins_at_rest(data, lengths, bones.length, Smoother.FLOOR * scale)
    if at_rest:
        clip = replace(clip, merged_weights=np.where(np.arange(len(data))[:, None] > 0, clip.merged_weights, 0))
        observed, data[0] = clip.merged_weights > 0, np.nan
    told = body.evidence(lengths)
    with jax.enable_x64(True):
        window = preset.window or len(data)
        spans = windows.split(len(data), window, min(preset.overlap, window - 1))
        stored = bucket(spans[0].stop - spans[0].start, preset.window)
        found, solutions = _in_windows(clip, spans, stored, body, told, max_steps, seconds, workers, progress)
        intact = np.where(observed & ~hopeless(data, solutions, spans, scale), found.intact, 0)
        noise = np.median([solution.state.noise for solution in solutions])
        exact = exact or noise < (2 * Smoother.FLOOR * scale) ** 2
        found = replace(found, intact=intact)
        found = fill_gaps(found, exact, scale, partial(_predicted, edges=clip.edges, poses=poses))
        if not given:
            bones = estimate_bone_lengths(bone_lengths(found.measured, clip.edges))
            if not exact:
                weights = np.where(found.kept, found.trust, 0)
                bones = smoothed_lengths(bones, found.positions, weights, clip.edges)
            bones = symmetric(bones, mirrored)
        found, left = hold(found, bones, clip.edges, exact, scale, stored, seconds)
    positions, intact, kept = found.positions, found.intact, found.kept
    if at_rest:
        positions[0], left[0], intact[0], kept[0] = clip.merged[0], 0, 1, True
    # What the other joints predict is near its bones' lengths to begin with: there the bones correct little.
    lost = lost_frames(kept)
    return Restored(
        positions=np.where((lost & ~kept)[..., None], np.nan, positions),
        variance=np.where(kept, left, np.where(lost, np.inf, found.variance)),
        intact=intact,
        noise=max(float(np.sqrt(noise)), Smoother.FLOOR * scale),
        exact=exact,
        bones=bones,
        solutions=solutions,
    )


def verdict(restored: Restored) -> Result:
    """The worst of the windows', or that samples stay unknown."""
    results = [Result(int(solution.result)) for solution in restored.solutions]
    for result in (Result.nothing_observed, Result.non_finite_input, Result.non_finite):
        if result in results:
            return result
    if np.isnan(restored.positions).any():
        return Result.partly_unknown
    return next((r for r in results if r != Result.converged), Result.converged)


def _in_windows(clip, spans, stored, body, told, max_steps, seconds, workers, progress):
    """The windows' estimates blended, and their solutions without covariance."""
    found, covariances, probabilities, drives, levels, solutions = [], [], [], [], [], []

    meanwhile = partial(prepare_projection, clip.merged.shape[1], clip.edges, stored)

    def solution_of(span):
        with jax.enable_x64(True):  # a thread has a setting of its own
            problem, origin = clip.problem(span, stored, np.dtype("float64"))
            drive = body.drive(clip.merged[span], clip.merged_weights[span] > 0)
            solver = body.smoother(told[span], stored, drive, tolerance=0.02)
            arrays, static = {"solver": solver, "problem": problem}, {"max_steps": max_steps}
            return run(solve, arrays, static, seconds, meanwhile), origin

    for span, (solution, origin) in zip(spans, windows.solved(solution_of, spans, workers, progress), strict=True):
        size, state = span.stop - span.start, solution.state
        found.append(np.asarray(state.positions)[:size] + origin)
        covariances.append(np.asarray(state.covariance)[:size])
        probabilities.append(np.asarray(state.intact)[:size])
        drives.append(np.asarray(state.activity)[:size, None] * np.diag(state.drive))
        levels.append(np.tile(state.noise, (size, 1)))
        solutions.append(replace(solution, state=replace(state, covariance=None)))
    # By precision, too: a gap that reaches beyond a window is known to the other.
    least = (0.01 * Smoother.FLOOR * body.scale) ** 2
    share = windows.shares(spans, [1 / np.maximum(np.einsum("tjj->tj", P), least) for P in covariances])
    positions, intact, drive, noise = (windows.blend(x, spans, share) for x in (found, probabilities, drives, levels))
    covariance = np.zeros((len(positions), *covariances[0].shape[1:]))
    for span, w in zip(spans, share, strict=True):
        root = np.sqrt(w)
        covariance[span] += root[:, :, None] * root[:, None] * covariances.pop(0)
    return Estimate(clip.merged, clip.merged_weights, positions, covariance, intact, drive, noise), solutions


def _predicted(positions, kept, gaps, edges, poses):
    """What the other joints say of gaps: see `estimate.Predict`."""
    people = None
    if poses is not None and run_lengths(~kept).max() >= regression.LONG:
        distances = median_distances(np.where(kept[..., None], positions, np.nan))
        people = proportioned(poses.thinned(POSES), distances).positions
    return predict_missing(positions, kept, bone_distance(edges, positions.shape[1]), gaps, people)


def hopeless(data, solutions, spans, scale):
    """Windows, as frames (frame, 1), in which what is measured is noise."""
    hopeless = np.zeros((len(data), 1), bool)
    for span, solution in zip(spans, solutions, strict=True):
        state = solution.state
        share, noise = float(state.outlier_share), float(np.mean(state.noise))
        unexplained = (1 - share) * noise + share * float(state.outlier)
        part = data[span]
        seen = np.isfinite(part[..., 0])
        count = np.maximum(seen.sum(0), 1)
        away = np.where(seen[..., None], part - np.nansum(part, 0) / count[:, None], 0)
        varies = np.sum(away**2) / (3 * max(seen.sum() - len(count), 1))
        # In a few frames nothing can be told from noise by time.
        hopeless[span] |= len(part) > LONG and noise > (NOISY * scale) ** 2 and unexplained > ALL * varies
    return hopeless


def lost_frames(kept):
    """Frames (frame, 1) of long runs with too few intact joints."""
    few = kept.sum(1, keepdims=True) < min(BODY, kept.shape[1])
    return run_lengths(few) > LONG if kept.any() else np.ones_like(few)
