"""Missing samples of a joint, predicted from the other joints and from time, with variances.

Problem. A joint is unknown for a run of frames, its gap, and known elsewhere. For each joint and each group of gaps:

1. Frame. R_t, c_t: rotation and centre of the other joints in frame t, fitted to their mean shape by weighted
   Procrustes (Kabsch, Acta Cryst. A32, 1976), with weights that fall with the number of bones in between. The joint's
   own position in it, y_t = R_t' (x_t - c_t), is the target; the other joints' local positions, centred, weighted alike
   and scaled to unit mean square, are the input u_t. Fewer than three other joints define no rotation: R_t = I.
2. Gaussian process regression (Rasmussen & Williams, "Gaussian Processes for Machine Learning", 2006, Eqs. 2.23-2.26)
   of y - mean(y) on u and t, learnt from at most `TRAIN` known frames:
       k = 1 + a_u <u, u'> + a_e exp(-|u - u'|²/2l²) + a_t m(|t - t'|/τ) + ν [t = t']
   with m the Matern kernel of smoothness 5/2 and τ a multiple of the longest gap in the group. The overall amplitude
   cancels in the prediction; in the variance it is what step 3 finds.
3. Hidden blocks. For a block b as long as the longest gap, out of K^-1 and α = K^-1 y alone (the block form of the
   leave-one-out formulas, Eqs. 5.10-5.12):
       r_b = y_b - prediction without b = C α_b,      C = ((K^-1)_bb)^-1 = its covariance
   The candidate's error is the mean over `BLOCKS` blocks of rms r_b; the mean of |r|²/3C_ii is its amplitude.
4. Poses. Of a human body, poses of other people predict the joint too (evidence.pose_prior). In longer gaps each
   candidate comes a second time, learnt from y less that prediction: what the clip itself never shows is then what
   people do, and not its mean.
5. Average. In each frame candidates, three frames times six kernels, with poses twice that, count by error^-4 times
   their variance there to the power of -2: far from what a candidate has learnt from, others know more. The variance is
   their averaged variance plus their disagreement, scaled so that |r|²/3v of the average over the hidden blocks is 1
   on average, and by what a block shorter than the gap and a handful of samples leave unseen.

Nothing is in metres or seconds, so the answer turns, moves and scales with the clip, and a joint's number is nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from motionrecover.evidence.local_shape import inputs, rigid_frames
from motionrecover.evidence.pose_prior import Blocks, blocks_of, leave_out, mean_from_poses, present
from motionrecover.runs import frames_away, runs_of

# Chosen on 16 clips of the CMU database with two draws of gap3x240 and gap3x60 at 120 Hz and gap3x15 at 30 Hz, mean
# errors in the gaps. On 23 clips, most of them others, with two other draws: 28.9, 8.5 and 6.1 mm, linear
# interpolation 163, 68 and 54; half of the errors below 0.7 to 0.8 of the standard deviation an axis, nine tenths below
# 1.7 to 2.1.
TRAIN = 128
"""Frames to learn from at most: with 200 long gaps come out the same; with 64 scattered short ones are half as
bad again."""
EDGE = 6
"""Frames on either side of a gap that are learnt from first."""
LEAST = 2
"""A joint with fewer known samples is not predicted, nor is another one predicted from it. From two known samples in
300 frames of a walk or run the error is 4 to 110 mm, and that of interpolation mostly 200 to 1000 mm."""
BLOCKS = 9
"""Hidden blocks, evenly spread."""
DOUBT = 0.01
"""Least trust in a guess. A guess d frames from the nearest known sample has trust (1 + d)^-2, since the error of
interpolation grows as the square of time. With 0.05 for every guess, gaps of 240 frames get 6 % worse."""
POWER = 4
"""Of the weights by error; 3 and 6 are as good. Stacking, the convex combination with the least error on the hidden
blocks, is 2 to 16 % worse: it believes nine blocks too much."""
SURE = 2
"""Of the weights by variance, which are a frame's own: on 40 clips, with one draw, 21 joints at 120 Hz have 8.0 mm of
error in gap3x60 and 15.1 in gap3x240; with 0 (the same weights in all frames) 8.8 and 16.2, with 1 in the latter 15.2,
with 3 8.1 and 15.3; with 2 and without the weights by error 16.5 (3) in the latter."""
LONG = 12
"""Frames. Shorter gaps are left to the clip itself."""
ALIKE = 6
"""Joints that poses must have beside the predicted one."""
NOISE = 0.1
"""Of the regression on poses, whose prediction the clip corrects. In 10 clips with two draws of gap3x240 (21 joints,
this regression alone) the error is 23.6 mm without poses, 20.0 with them, 19.9 with 0.3; with a linear kernel on the
poses 20.6, and 21.4 with 0.01; with the prediction as a linear term of the kernel in place of a mean, 24.0 to 25.1."""


class _Kernel(NamedTuple):
    """Amplitudes of the three parts of k, their scales, and the noise ν."""

    linear: float
    exponential: float
    time: float
    length: float
    """l, in rms of the input."""
    gaps: float
    """τ in lengths of the longest gap. Tied to the gap it gives 20.6, 7.3 and 5.2 mm (gap3x240, gap3x60; gap3x15 at
    30 Hz), at 30 to 200 frames 21.2, 7.9 and 5.2; tied to the clip or the joint's speed some protocol gets worse."""
    noise: float


# Ten times more or less noise in a pair of them changes the errors by at most 8 %, mostly for the worse. A product of
# the exponential and the Matern kernel as a further term, of amplitude 0.3, is 7 to 9 % worse.
KERNELS = (
    _Kernel(0, 0, 0.3, 1, 2, 1e-4),
    _Kernel(1, 0, 0.03, 1, 4, 1e-6),
    _Kernel(1, 0, 0.3, 1, 4, 1e-3),
    _Kernel(1, 1, 0.03, 4, 4, 1e-6),
    _Kernel(1, 1, 0.03, 1, 4, 1e-6),
    _Kernel(0.1, 1, 0.3, 1, 4, 1e-3),
)
FRAMES = ((0.35, 1.0), (0.8, 1.0), (2.0, 3.0))
"""Bones over which the weight of a joint falls by e, in the fit of the frame and in the input."""


def bone_distance(edges: Iterable[Sequence[int]], joints: int) -> np.ndarray:
    """Number of bones (joint, joint) on the shortest way between joints; `joints`, more than any way, without one."""
    distance = np.full((joints, joints), float(joints))
    np.fill_diagonal(distance, 0)
    for i, j in edges:
        distance[i, j] = distance[j, i] = 1
    for k in range(joints):  # Floyd, Comm. ACM 5, 1962
        distance = np.minimum(distance, distance[:, k : k + 1] + distance[k])
    return distance


def predict_missing(
    positions: np.ndarray,
    known: np.ndarray,
    distance: np.ndarray,
    only: np.ndarray | None = None,
    poses: np.ndarray | None = None,
    times: np.ndarray | None = None,
    frames: Sequence[tuple[float, float]] = FRAMES,
    kernels: Sequence[_Kernel] = KERNELS,
    sure: float = SURE,
) -> tuple[np.ndarray, np.ndarray]:
    """Predictions (frame, joint, 3) of the samples that are not `known`, and their variance (frame, joint) an axis.

    `positions` (frame, joint, 3) are complete: where `known` (frame, joint) is false they hold a first guess, which is
    used with little trust as input to the joints beside it. A second call with the predictions as guess gains a
    tenth where six long gaps coincide, and nothing to speak of elsewhere. `distance` (joint, joint) is that of
    `bone_distance`. `only` (frame, joint) says which of the unknown samples to predict; all, if not given.
    `poses` (pose, joint, 3): a body of these proportions in poses of other people, NaN where it has no such joint.
    `times` (frame,) in frames, if they are not in a row. Fewer `frames` and `kernels` are faster and less exact;
    `sure`: see `SURE`.

    Known samples keep their position with variance 0. What is not predicted (not asked for, or a joint with fewer than
    `LEAST` known samples) keeps its guess with infinite variance. Raises `ValueError` for misshapen arrays and for
    positions that are not finite. Memory is that of a few (frame, `TRAIN`) matrices, time linear in the frames.
    """
    positions, known = np.asarray(positions, np.float64), np.asarray(known, bool)
    distance = np.asarray(distance, np.float64)
    wanted = ~known if only is None else np.asarray(only, bool) & ~known
    if positions.ndim != 3 or positions.shape[2] != 3 or not known.shape == wanted.shape == positions.shape[:2]:
        raise ValueError(
            f"received positions of shape {positions.shape} and masks of shapes {known.shape} and {wanted.shape}: "
            "give (frame, joint, 3) and (frame, joint)"
        )
    joints = positions.shape[1]
    if distance.shape != (joints, joints):
        raise ValueError(f"received distances of shape {distance.shape}: give one for each pair of {joints} joints")
    if not np.isfinite(positions).all():
        raise ValueError("received positions that are not finite: give a first guess for every missing sample")

    times = np.arange(len(known)) if times is None else times
    trust, usable = trust_of(known), known.sum(0) >= LEAST
    alike = np.zeros(joints, bool) if poses is None else present(poses)
    predictions, variance = positions.copy(), np.where(known, 0.0, np.inf)
    for joint in np.flatnonzero(usable & wanted.any(0)):
        others = np.flatnonzero(usable & (np.arange(joints) != joint))
        away = np.minimum(distance[joint, others], joints)
        away -= away.min(initial=joints)
        gaps = runs_of(~known[:, joint])
        for group in _groups([gap for gap in gaps if wanted[slice(*gap), joint].any()]):
            train = _training_frames(known[:, joint], group)
            query = np.concatenate([np.flatnonzero(wanted[a:b, joint]) + a for a, b in group])
            rows = np.concatenate([train, query])
            gap = max(b - a for a, b in group)
            people = None
            if poses is not None and gap >= LONG and alike[joint] and alike[others].sum() >= ALIKE:
                people = poses[:, joint], poses[:, others]
            predictions[query, joint], variance[query, joint] = _regress(
                positions[train, joint],
                positions[np.ix_(rows, others)],
                trust[np.ix_(rows, others)],
                away,
                times[rows].astype(np.float64),
                gap,
                people,
                frames,
                kernels,
                sure,
            )
    return predictions, variance


def _regress(
    target: np.ndarray,
    others: np.ndarray,
    trust: np.ndarray,
    away: np.ndarray,
    times: np.ndarray,
    gap: int,
    people: tuple[np.ndarray, np.ndarray] | None,
    frames: Sequence[tuple[float, float]],
    kernels: Sequence[_Kernel],
    sure: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Predictions (query, 3) and variance (query,): steps 1 to 5 for one group of gaps, `gap` frames the longest.

    `others` (row, other, 3), `trust` (row, other) and `times` (row,) hold the training frames first and the frames
    asked for after them; `target` (train, 3) are the joint's positions in the former, `away` (other,) the bones to it
    from each of the others, less those to the nearest. `people`: the joint (pose, 3) and the others
    (pose, other, 3) in poses of other people.
    """
    from scipy.linalg import solve_triangular  # a fifth of a second to import

    learnt = len(target)
    (at, there), hidden = _blocks(times[:learnt], gap)
    sizes = there.sum(1)
    late = np.abs(times[:, None] - times[:learnt])
    in_time = {gaps: _matern(late / (gaps * gap)) for gaps in {kernel.gaps for kernel in kernels}}
    errors, predicted, variances, residuals, expected = [], [], [], [], []
    for near, reach in frames:
        fall = np.maximum(np.exp(-away / near), 1e-12)
        weights = fall * trust
        rotations, centres, shapes = rigid_frames(others, weights, learnt)
        # Joints that are guessed in this very gap tell little: without their trust, long gaps get a third worse.
        share = np.exp(-away / reach) * trust[learnt:].mean(0)
        linear, squares = inputs(shapes, share, learnt)
        far = np.maximum(squares[:, None] + squares[:learnt] - 2 * linear, 0)
        offsets = [centres]
        if people is not None:
            offsets.append(mean_from_poses(*people, others, fall, share, trust, NOISE)[0])
        for kernel in kernels:
            K = 1 + kernel.linear * linear + kernel.time * in_time[kernel.gaps]
            if kernel.exponential:
                K += kernel.exponential * np.exp(-far / (2 * kernel.length**2))
            # By factors: the variance, a small difference of large numbers, keeps two more digits than with K^-1.
            root = np.linalg.cholesky(K[:learnt] + kernel.noise * np.eye(learnt))
            factor = solve_triangular(root, np.eye(learnt), lower=True, check_finite=False)
            inverse, asked = factor.T @ factor, K[learnt:]
            prior = 1 + kernel.linear * squares[learnt:] + kernel.exponential + kernel.time
            spread = np.maximum(prior - ((asked @ factor.T) ** 2).sum(1), 0) + kernel.noise
            for offset in offsets:
                local = np.einsum("ti,tij->tj", target - offset[:learnt], rotations[:learnt])
                mean = local.mean(0)
                local -= mean
                coefficients = inverse @ local
                if len(sizes):
                    residual, doubt = leave_out(inverse, coefficients, (at, there))
                    square = (residual**2).sum(2)
                    error = np.sqrt(square.sum(1) / sizes).mean()
                    amplitude = ((square / (3 * doubt)).sum(1) / sizes).mean()
                    residuals.append(np.einsum("tj,tij->ti", residual[there], rotations[at[there]]))
                    expected.append(amplitude * doubt[there])
                else:
                    error, amplitude = np.sqrt((local**2).sum(1).mean()), (local**2).mean()
                errors.append(error)
                variances.append(amplitude * spread)
                turned = np.einsum("tj,tij->ti", asked @ coefficients + mean, rotations[learnt:])
                predicted.append(turned + offset[learnt:])

    tiny = np.finfo(np.float64).tiny
    # An error of exactly 0, of a joint that stands still, would leave no weight for the others.
    odds = ((max(errors) + tiny) / np.maximum(errors, 1e-6 * max(errors) + tiny)) ** POWER
    answer, variance = _mixture(odds, predicted, variances, sure)
    if residuals:
        residual, claimed = _mixture(odds, residuals, expected, sure)
        # A block hides at most half of what is known. Where gaps are longer, variances grow with the ratio: for gaps
        # of 240 in 300 frames the mean of error²/variance is 2.4 without it. Of few samples the residuals are few, too:
        # with two it is 3 without the last factor.
        variance *= ((residual**2).sum(1) / (3 * claimed + tiny)).mean() * max(1.0, gap / hidden) * (1 + 4 / learnt)
    return answer, variance


def _mixture(
    odds: np.ndarray, means: list[np.ndarray], variances: list[np.ndarray], sure: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (sample, 3) and variance (sample,) an axis of a mixture of candidates, which count by `odds` (candidate,)
    and by how sure they are of the sample."""
    every, spread, tiny = np.array(means), np.array(variances), np.finfo(np.float64).tiny
    weights = odds[:, None] * ((spread.min(0) + tiny) / (spread + tiny)) ** sure
    weights /= weights.sum(0)
    mean = np.einsum("ct,cti->ti", weights, every)
    return mean, (weights * (spread + ((every - mean) ** 2).mean(2))).sum(0)


def _matern(x: np.ndarray) -> np.ndarray:
    """Matern kernel of smoothness 5/2 (Rasmussen & Williams 2006, Eq. 4.17) at distances x over the scale."""
    a = np.sqrt(5) * x
    return (1 + a + a * a / 3) * np.exp(-a)


def trust_of(known: np.ndarray) -> np.ndarray:
    """Trust (frame, joint) in a sample: 1 if known, else by the frames to the nearest known one, at least `DOUBT`."""
    return np.maximum((1 + frames_away(known)) ** -2.0, DOUBT)


def _groups(gaps: list[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    """Successive gaps that share one fit: so many that a good part of their edges is learnt from.

    One fit for 100 short gaps in 1200 frames has 2.1 mm of error, such groups 1.0 mm; half as many gaps in a group cost
    twice the time and make it 0.9 mm.
    """
    most = TRAIN // EDGE
    return [gaps[k : k + most] for k in range(0, len(gaps), most)]


def _training_frames(known: np.ndarray, gaps: list[tuple[int, int]]) -> np.ndarray:
    """At most `TRAIN` known frames: those at the edges of gaps, up to half of them, and others evenly spread."""
    frames = np.flatnonzero(known)
    if len(frames) <= TRAIN:
        return frames
    beside = np.zeros(len(known), bool)
    for start, stop in gaps:
        beside[max(0, start - EDGE) : stop + EDGE] = True
    edges = _thin(np.flatnonzero(beside & known), TRAIN // 2)
    rest = np.setdiff1d(frames, edges)
    return np.union1d(edges, _thin(rest, TRAIN - len(edges)))


def _thin(frames: np.ndarray, most: int) -> np.ndarray:
    """At most so many of the frames, evenly spread."""
    return frames if len(frames) <= most else frames[np.linspace(0, len(frames) - 1, most).round().astype(int)]


def _blocks(times: np.ndarray, gap: int) -> tuple[Blocks, float]:
    """The blocks of times (train,) to hide, and how long those are: the gap, or half of the known span."""
    span = times[-1] - times[0]
    hidden = min(float(gap), span / 2)
    starts = times[0] + np.linspace(0, span - hidden, BLOCKS)
    blocks = [np.flatnonzero((times >= start - 1e-6) & (times <= start + hidden + 1e-6)) for start in starts]
    return blocks_of([block for block in blocks if 0 < len(block) <= 0.8 * len(times)]), hidden
