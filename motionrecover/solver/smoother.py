"""The robust recovery of a clip: outliers, noise level and drive of the motion, found with the motion itself.

Model: x follows the joint second-difference prior of `solver.kalman` with unknown drive covariance Q and activity a;
a sample is intact or not,

    y_ts = x_ts + e_ts,   e ~ N(0, s_s^2 / c_ts I) if intact,   e ~ N(0, o^2 I) if not (a share pi),

c its confidence, s_s the joint's noise level (a depth camera is fifty times surer of a spine than of a thumb), and
two intact neighbours are at their bone's length (`solver.beliefs`). In the terms of STR (Yang et al. 2020, Eq. 7): E is
carried by whole samples; Q is the low rank, learnt with the noise in sight instead of shrunk by a fixed amount; the
second difference takes the wavelets' place. On 16 CMU clips with 3 mm of noise, wavelets shrunk by the noise level
leave 2.5 mm (shift-invariant ones 2.2), this 1.9 mm, and no parameter of it changes with the rate.

One step is one pass of expectation conditional maximisation (Meng & Rubin 1993):

    r = s^2 / c where intact, o^2 where not (1 / r the mean of both by p while annealing)
    (mean, covariance, error, error_variance, g, G) = smooth(y, r, Q, a)                              solver.kalman
    p = P(intact | y) by beliefs( log (1 - pi) / pi + log f(error) / N(error; v + o^2), bones )
        v: variance of the prediction from all other samples; f(e) = N(e; v + s^2 / c) / 2 + t_4(e; v) / 2. Student's t,
        because people hit the ground: with a normal density alone, 4 % of the samples of clean walks were taken for
        outliers. Noise has no such tails: with s in the scale of t, spikes of 10 cm in 3 mm of noise pass.
    Q = N^-1/2 (N^1/2 M N^1/2)^1/2 N^-1/2,                                                     while settling
        M = sum a Q g g^T Q / 3 + nu D,  N = sum a G + nu Q^-1: the geometric mean of M and N^-1, which is the
        minorise-maximise step for variance components (Zhou et al., "MM algorithms for variance components models",
        JCGS 28, 2019, in matrix form); ten of them do what hundreds of EM steps do. nu frames are imagined in which
        every joint is seen to be driven by itself, with variance D_ss: that of Q, drawn to the body's mean where a
        joint was hardly seen. A straight line through two samples would make its drive 0 and its error bars nothing.
    log a += log( g^T Q g / 3 tr(G Q) ) / 2, both smoothed over `ACTIVITY` frames              while settling
    pi, o^2, s^2 = shares and mean squares of the two kinds, s^2 joint by joint with the geometric mean of all joints
        counted as `USUAL` samples more; s falls no faster than to `cooling` of itself while annealing (graduated
        non-convexity, Blake & Zisserman 1987), and ends between `floor` and `noise_max`.
"""

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from motionrecover.isometry.objective import Edges, ends
from motionrecover.solver.beliefs import beliefs
from motionrecover.solver.kalman import smooth, smooth_each
from motionrecover.solver.problem import Problem
from motionrecover.solver.result import Result, Verdict

Scalar = Float[Array, ""]
Samples = Float[Array, "frame joint"]

FREEDOM = 4.0
"""Degrees of freedom of the predictions' tails."""
ACTIVITY = 5.0
"""Frames: standard deviation of the window in which the activity is measured. 4 to 10 frames give errors within 1 %."""
INTACT = 0.5
"""A sample is used as intact above this probability."""
SETTLE = 3
"""Steps after annealing that Q and a are given before standing still counts as convergence."""
PRIOR = 2.0
"""Frames that the prior of Q counts for, nu. With S of them, errors in 3 mm of noise grow by 3 %."""
USUAL = 20.0
"""Samples that the usual noise counts for in a joint's."""
CAP = 3.0
"""One frame counts in Q as if its drive were at most this many times what the model expects: an accepted outlier must
not teach the model that such jumps are human."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class SmootherState:
    """What is believed about the clip after a step; `noise` of a joint and `outlier` are variances of one axis."""

    positions: Float[Array, "frame joint 3"]
    covariance: Float[Array, "frame joint joint"]
    intact: Samples
    drive: Float[Array, "joint joint"]
    activity: Float[Array, " frame"]
    noise: Float[Array, " joint"]
    outlier: Scalar
    outlier_share: Scalar
    step: Int[Array, ""]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class SmootherInfo:
    """What one step tells; as a trace, one row a step, NaN from `Solution.steps` on. Lengths in the data's unit."""

    change: Scalar
    """Root mean square of what the step moved intact samples, relative to the noise."""
    noise: Scalar
    """Root mean square of s."""
    outlier: Scalar
    """o."""
    outlier_share: Scalar
    """pi."""

    shown: ClassVar[tuple[str, ...]] = ("noise", "outlier", "outlier_share", "change")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Smoother:
    """Start and limits of the recovery of one clip. All arrays, so that other values compile nothing anew."""

    evidence: Float[Array, "frame bone"]
    """Log density ratio that both ends of a bone are intact."""
    drive: Float[Array, " joint"]
    """First guess of the diagonal of Q."""
    scale: Scalar
    """Size of the body: its median bone length. All lengths below are relative to it."""
    outlier_share: Scalar
    """First guess of pi."""
    noise_max: Scalar
    """What the bones' own spread allows: a body whose bones keep their length was not measured with noise."""
    tolerance: Scalar
    """`SmootherInfo.change` must fall below it."""
    anneal: int = field(metadata={"static": True}, default=15)
    """Steps in which the noise level comes down. 30 of them: same within 1 %, at 80 % displaced 2 to 5 % worse."""
    beliefs: SmootherState | None = None
    """Where to go on from; of frames whose `intact` is NaN only the bones tell. Left out, that is so of all frames."""

    trace: ClassVar[type] = SmootherInfo

    HOT: ClassVar[float] = 0.6
    """s of the first step: displaced samples look like noise, and the body's rough path shows."""
    COLD: ClassVar[float] = 4e-3
    """s that the annealing comes down to if the data allow."""
    FLOOR: ClassVar[float] = 8e-4
    """Smallest s. A quarter of it teaches Q the recording's own jitter: gaps of 240 frames get 3 % worse, and single
    missing samples 7 % better."""
    GROSS: ClassVar[float] = 0.16
    """Smallest o: what is off by less is noise. Without it, clean clips grow outliers of a millimetre."""
    FREE: ClassVar[float] = 2.0
    """Standard deviation of where the body is before its first frame."""
    MISSING: ClassVar[float] = 1e5
    """Standard deviation of a missing sample and of padding: they say nothing, to the last digits."""

    def init(self, problem: Problem) -> SmootherState:
        """Beliefs from the bones alone; everything observed is smoothed as far as `HOT` goes."""
        y = problem.positions.transpose(2, 1, 0)
        frames, joints, _ = y.shape
        observed = problem.weights.T > 0
        alone = jnp.full(observed.shape, jnp.log((1 - self.outlier_share) / self.outlier_share))
        intact = judged(alone, observed, self.evidence, problem.edges)
        hot = (self.HOT * self.scale) ** 2
        if self.beliefs is not None:
            known = ~jnp.isnan(self.beliefs.intact)
            return replace(self.beliefs, intact=jnp.where(known, self.beliefs.intact, intact))
        return SmootherState(
            positions=y,
            covariance=jnp.zeros((frames, joints, joints), y.dtype),
            intact=intact,
            drive=jnp.diag(self.drive),
            activity=jnp.ones(frames, y.dtype),
            noise=jnp.full(joints, hot),
            outlier=hot,
            outlier_share=self.outlier_share,
            step=jnp.array(0),
        )

    def step(self, problem: Problem, state: SmootherState) -> tuple[SmootherState, SmootherInfo]:
        """One pass of the updates in the module's docstring."""
        y, confidence = problem.positions.transpose(2, 1, 0), problem.weights.T
        frames = len(y)
        observed = confidence > 0
        confidence = jnp.maximum(confidence, 1e-3)
        settling = state.step >= self.anneal

        intact = state.intact
        noise = state.noise / confidence
        outlier = jnp.maximum(jnp.maximum(state.outlier, 4 * state.noise), (self.GROSS * self.scale) ** 2)
        softly = 1 / (intact / noise + (1 - intact) / outlier)
        r = jnp.where(settling, jnp.where(intact > INTACT, noise, outlier), softly)
        r = jnp.where(observed, r, (self.MISSING * self.scale) ** 2)
        # The first two frames have no second difference; padding has no score.
        driven = (jnp.arange(frames) >= 2) & (jnp.arange(frames) < problem.frames)
        far = (self.FREE * self.scale) ** 2

        # Joint by joint is the same where Q is diagonal, as it is until the first of `settle`, in a tenth of the time.
        together = (state.drive != jnp.diag(jnp.diag(state.drive))).any()
        s = lax.cond(together, smooth, smooth_each, y, r, state.drive, state.activity, far)

        def settle():
            return _drive(state.drive, state.activity, s, driven), _activity(state.activity, state.drive, s, driven)

        drive, activity = lax.cond(settling, settle, lambda: (state.drive, state.activity))
        variance = jnp.diagonal(s.covariance, axis1=1, axis2=2)

        prediction = jnp.maximum(s.error_variance - r, 1e-3 * variance)
        square = jnp.sum(s.error**2, -1)
        odds = jnp.log((1 - state.outlier_share) / state.outlier_share)
        odds = odds + log_intact(square, prediction, noise) - log_normal(square, prediction + outlier)
        intact = judged(odds, observed, self.evidence, problem.edges)

        weight = jnp.where(observed, intact, 0)
        doubt = jnp.where(observed, 1 - intact, 0)
        residual = jnp.sum((y - s.mean) ** 2, -1) / 3 + variance
        share = jnp.clip(doubt.sum() / jnp.maximum(observed.sum(), 1), 1e-3, 0.95)
        found = jnp.minimum(_noise(weight, confidence * residual), self.noise_max**2)
        cooling = (self.COLD / self.HOT) ** (2 / self.anneal)
        least = (self.FLOOR * self.scale) ** 2
        slowly = jnp.where(settling, 0, cooling * state.noise)
        new = SmootherState(
            positions=s.mean,
            covariance=s.covariance,
            intact=intact,
            drive=drive,
            activity=activity,
            noise=jnp.maximum(jnp.maximum(found, slowly), least),
            outlier=jnp.sum(doubt * residual) / jnp.maximum(doubt.sum(), 1e-9),
            outlier_share=share,
            step=state.step + 1,
        )
        # Missing samples go on creeping with Q long after everything that was measured stands still.
        moved = jnp.sum((s.mean - state.positions) ** 2, -1) / new.noise
        info = SmootherInfo(
            change=jnp.where(
                state.step >= self.anneal + SETTLE,
                jnp.sqrt(jnp.sum(weight * moved) / jnp.maximum(weight.sum(), 1e-9)),
                jnp.inf,
            ),
            noise=jnp.sqrt(new.noise.mean()),
            outlier=jnp.sqrt(new.outlier),
            outlier_share=share,
        )
        return new, info

    def check(self, problem: Problem) -> Verdict:
        """Verdict before the first step: on the input."""
        finite = jnp.isfinite(problem.positions).all() & jnp.isfinite(problem.weights).all()
        result = Result.where((problem.weights > 0).any(), Result.running, Result.nothing_observed)
        return Result.where(finite, result, Result.non_finite_input)

    def terminate(self, info: SmootherInfo) -> Verdict:
        """Verdict after a step."""
        result = Result.where(info.change < self.tolerance, Result.converged, Result.running)
        return Result.where(jnp.isfinite(info.noise), result, Result.non_finite)

    def answer(self, problem: Problem, state: SmootherState) -> tuple[Array, Array]:
        """The motion, and what sets the samples apart from it that are not intact."""
        a = state.positions.transpose(2, 1, 0)
        out = (state.intact.T <= INTACT) & (problem.weights > 0)
        return a, jnp.where(out, problem.positions - a, 0)


def judged(odds: Samples, observed: Samples, evidence: Float[Array, "frame bone"], edges: Edges) -> Samples:
    """Probability that a sample is intact, from its own log odds and those of its bones; 0 where missing.

    The bones' word goes round in float32: log odds to a millionth, in a quarter of the time.
    """
    i, j = ends(edges)
    together = jnp.where(observed[:, i] & observed[:, j], evidence, 0)
    alone = jnp.where(observed, odds, 0)
    joint = beliefs(alone.astype(jnp.float32), together.astype(jnp.float32), edges)
    return jnp.where(observed, jax.nn.sigmoid(joint.astype(odds.dtype)), 0)


def log_intact(square, prediction, noise):
    """Log of f: whichever of the noise and a sudden move explains the error, less 1.5 log(2 pi)."""
    return jnp.logaddexp(log_normal(square, prediction + noise), _log_t(square, prediction)) - jnp.log(2.0)


def _log_t(square, variance):
    """Log density of Student's t with `FREEDOM` in three dimensions, less 1.5 log(2 pi)."""
    constant = math.lgamma((FREEDOM + 3) / 2) - math.lgamma(FREEDOM / 2) - 1.5 * math.log(FREEDOM / 2)
    return constant - 1.5 * jnp.log(variance) - (FREEDOM + 3) / 2 * jnp.log1p(square / (FREEDOM * variance))


def log_normal(square, variance):
    """Log density of the normal in three dimensions, less 1.5 log(2 pi)."""
    return -1.5 * jnp.log(variance) - square / (2 * variance)


def _noise(weight, square):
    """The next s^2 (joint,), from squares (frame, joint) and how far each counts."""
    count, total = weight.sum(0), jnp.sum(weight * square, 0)
    log = jnp.log(jnp.maximum(total, 1e-30) / jnp.maximum(count, 1e-9))
    usual = jnp.exp(jnp.sum(count * log) / jnp.maximum(count.sum(), 1e-9))
    return (total + USUAL * usual) / (count + USUAL)


def _drive(drive, activity, s, driven):
    """The next Q."""
    weight = jnp.where(driven, activity, 0)
    found, expected = jnp.sum(s.score**2, (1, 2)) / 3, jnp.trace(s.information, axis1=1, axis2=2)
    capped = weight * jnp.minimum(1, CAP * expected / jnp.maximum(found, 1e-30))
    M = drive @ jnp.einsum("t,tsc,trc->sr", capped, s.score, s.score) @ drive / 3
    N = jnp.einsum("t,tsr->sr", weight, s.information)
    # Frames' worth of each joint's drive that its samples show.
    seen, own = jnp.maximum(jnp.sum(N * drive, 1), 0), jnp.diag(drive)
    pooled = jnp.sum(seen * own) / jnp.maximum(jnp.sum(seen), 1e-30)
    M += PRIOR * jnp.diag((seen * own + PRIOR * pooled) / (seen + PRIOR))
    values, vectors = jnp.linalg.eigh(drive)
    N += PRIOR * (vectors / jnp.maximum(values, 1e-12 * values[-1])) @ vectors.T
    values, vectors = jnp.linalg.eigh(N)
    root = jnp.sqrt(jnp.maximum(values, 1e-12 * values[-1]))
    half, inverse = (vectors * root) @ vectors.T, (vectors / root) @ vectors.T
    values, vectors = jnp.linalg.eigh(half @ M @ half)
    q = inverse @ (vectors * jnp.sqrt(jnp.maximum(values, 0))) @ vectors.T @ inverse
    # A clip of one or two frames shows no drive at all.
    return jnp.where(driven.any(), (q + q.T) / 2, drive)


def _activity(activity, drive, s, driven):
    """The next a, of geometric mean 1."""
    found = jnp.where(driven, jnp.einsum("tsc,sr,trc->t", s.score, drive, s.score) / 3, 0)
    expected = jnp.where(driven, jnp.einsum("tsr,rs->t", s.information, drive), 0)
    reach = jnp.arange(-30, 31)
    window = jnp.exp(-0.5 * (reach / ACTIVITY) ** 2)
    found, expected = (jnp.convolve(x, window, mode="full")[30:-30] for x in (found, expected))
    change = jnp.where(expected > 0, jnp.log(jnp.maximum(found, 1e-12 * expected) / expected) / 2, 0)
    log = jnp.log(activity) + change
    mean = jnp.sum(jnp.where(driven, log, 0)) / jnp.maximum(driven.sum(), 1)
    return jnp.exp(jnp.clip(log - mean, -6, 6))
