"""Algorithm 1 of Yang et al. 2020 (STR): ADM under the augmented Lagrangian, with terms that can be left out.

Yang, Guo, Li, Wang, Lai & Wu, "Spatio-Temporal Reconstruction for 3D Motion Recovery", IEEE TCSVT 30(6), 2020.

Problem (Eq. 8), with weights w_ts in [0, 1] on the samples (w = 1 in the paper):

    min |A|_* + lambda |w E|_1 + mu |C|_1 + gamma/2 E_iso(N)    s.t.  D = A + E,  N = A,  C = W A

Updates (k -> k + 1, multipliers Z_1..3, penalties rho_1..3; the numbers are the lines of Algorithm 1):

    N <- N + (gamma J^T J + rho_2 I)^-1 (-Z_2 - rho_2 (N - A) - gamma J^T F(N))            4, 5   Eq. 20
    C <- soft(W A - Z_3 / rho_3, mu / rho_3)                                               6      Eq. 11
    E <- soft(D - A - Z_1 / rho_1, lambda w / rho_1)                                       7      Eq. 12
    A <- svt((rho_1 H_1 + rho_2 H_2 + rho_3 H_3) / rho, 1 / rho),  rho = sum rho_i         8-11   Eq. 14
         H_1 = D - E - Z_1 / rho_1,  H_2 = N + Z_2 / rho_2,  H_3 = W^T (C + Z_3 / rho_3)
    Z_1 += rho_1 (E - D + A),  Z_2 += rho_2 (N - A),  Z_3 += rho_3 (C - W A)               12-14
    rho_i <- min(eta_i rho_i, rho_max)                                                     15-17

Written with what the three proxes take away,

    K_1 = D - A - Z_1 / rho_1 - E,    K_2 = A - Z_2 / rho_2 - N,    K_3 = W A - Z_3 / rho_3 - C,

(K_1 and K_3 are clipped, K_2 = J^T y with one force y a bone: `isometry.tree`) lines 8-14 become, since W^T W = I,

    A_new <- svt(A + (rho_1 K_1 - rho_2 K_2 - rho_3 W^T K_3) / rho, 1 / rho),    M = A_new - A
    Z_1 <- rho_1 (M - K_1),    Z_2 <- -rho_2 (M + K_2),    Z_3 <- -rho_3 (W M + K_3)

which reads and writes less, and adds no rounding to multipliers from step to step. That is what the code does.

The guide term, which is not in the paper, draws A towards positions F of somebody else, with trust B in [0, 1]:

    + beta/2 |B (A - F)|^2

With B = 1 it joins the squares of Eq. 14 as H_4 = F with rho_4 = beta. Any other B would take the closed form from the
A-step; there the term is replaced by the square above it that touches it at the last A, which has the same weight beta
everywhere (Hunter & Lange, "A tutorial on MM algorithms", Am. Stat. 58(1), 2004):

    H_4 = A + B^2 (F - A)

Without beta the code is that of the paper.

Given A, the N-, C- and E-steps do not see each other, so this is ADM with two blocks, (N, C, E) and A. Without the
isometry term it converges for any constant penalty (Boyd et al., "Distributed Optimization and Statistical Learning
via ADMM", 2011, Sec. 3.2). A growing penalty forces the constraints to hold whatever the answer; hence `rho_max`, and
hence a verdict on both residuals.
"""

from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from motionrecover import wavelets
from motionrecover.isometry import pcg, tree
from motionrecover.isometry.objective import bone_vectors, residual, transpose_product
from motionrecover.kernel import one_kernel
from motionrecover.prox import clip, singular_value_threshold
from motionrecover.solver.problem import Problem
from motionrecover.solver.result import Result, Trace, Verdict

Positions = Float[Array, "joint 3 frame"]
Coefficients = Float[Array, "joint 3 coefficient"]
Scalar = Float[Array, ""]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class State:
    """The seven variables and three penalties, and W A, which a step leaves to the next.

    Variables of a term that is left out are empty. A joint is a row of 3 T numbers: bones take whole rows, the
    singular value threshold multiplies from the left, filters run along the row.
    """

    d: Positions
    """D, in the order of the variables."""
    scale: Float[Array, "2"]
    """|D| and |lambda w|, and 1 where they are 0: what the residuals are relative to."""
    a: Positions
    e: Positions
    n: Positions
    z1: Positions
    z2: Positions
    z3: Coefficients
    penalty: Float[Array, "3"]
    wa: Coefficients


class Split(NamedTuple):
    """What the N-, C- and E-steps leave to the A-step and to the multipliers; None of a term that is left out."""

    k1: Positions
    e: Positions
    k2: Positions | None
    n: Positions | None
    k3: Coefficients | None
    c: Coefficients | None
    away: Positions | None
    """F - A."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Info:
    """What one step tells; the fields are those of `Trace`."""

    primal_residual: Scalar
    dual_residual: Scalar
    nuclear: Scalar
    outlier: Scalar
    isometry: Scalar
    smoothness: Scalar
    guide: Scalar
    rank: Scalar
    penalty: Scalar
    inner_steps: Scalar


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Solver:
    """Weights of the terms, penalties and tolerance: arrays, so that changing one does not compile anew."""

    outlier_weight: Scalar
    """lambda: higher explains less of the data as outliers."""
    isometry_weight: Scalar
    """gamma, in 1 / length^3: higher keeps bones more rigid."""
    smoothness_weight: Scalar
    """mu: higher gives smoother, slower motion."""
    guide_weight: Scalar
    """beta, in 1 / length: higher stays nearer the guide."""
    penalty: Float[Array, "3"]
    """rho_1..3 of the first step, in 1 / length: higher enforces agreement sooner and stays nearer the start."""
    penalty_growth: Float[Array, "3"]
    """eta_1..3: 1 keeps the penalties; higher ends sooner and farther from the optimum."""
    penalty_max: Scalar
    """rho_max: where the growth ends, and convergence to a stationary point can begin."""
    tolerance: Scalar
    """Both residuals must fall below it."""
    isometry: bool = field(metadata={"static": True})
    """Whether the model has the isometry term."""
    smoothness: bool = field(metadata={"static": True})
    """Whether the model has the wavelet term."""
    guided: bool = field(metadata={"static": True})
    """Whether the model has the guide term; the problem then has a guide."""
    zero_start: bool = field(metadata={"static": True})
    """Start from A = 0 as printed, not from A = D."""
    wavelet: str = field(metadata={"static": True})
    level: int = field(metadata={"static": True})

    trace: ClassVar[type] = Trace

    def init(self, problem: Problem) -> State:
        """Line 2 of Algorithm 1: E = Z = 0, N = D, and A = D (or 0 where `zero_start`)."""
        d = problem.positions.swapaxes(0, 1)
        zero, empty = jnp.zeros_like(d), d[..., :0]
        a = zero if self.zero_start else d
        n, z2 = (d, zero) if self.isometry else (empty, empty)
        wa = self._wavedec(problem, a) if self.smoothness else empty
        scale = jnp.sqrt(jnp.stack([_square(d), _square(self.outlier_weight * problem.weights)]))
        scale = jnp.where(scale > 0, scale, 1)
        return State(d, scale, a, zero, n, zero, z2, jnp.zeros_like(wa), self.penalty, wa)

    def step(self, problem: Problem, state: State) -> tuple[State, Info]:
        """One pass through lines 4-17.

        The dual residual is the distance of the new point from stationarity. The A-step is exact, so A and the new
        multipliers satisfy its condition; the E- and C-steps saw the old A, which leaves rho_1 (A - A_old) and
        rho_3 W (A - A_old); the N-step is one Gauss-Newton step, which leaves gamma J^T F(N) + Z_2; the square above
        the guide term leaves beta (1 - B^2) (A - A_old). It is measured
        against |lambda w|, the largest norm that Z_1 can have at a solution, the primal residual against |D|: both are
        then free of units and of the length of the clip.
        """
        rho = self._weights(state.penalty)
        # Conjugate gradients sum along axes, and cannot be part of a kernel.
        eliminates = not self.isometry or tree.suits(problem.edges, len(state.d))
        split_of = one_kernel(Solver._split) if eliminates else Solver._split
        h, split, inner_steps = split_of(self, problem, replace(state, scale=None, e=None), rho)
        new, values = singular_value_threshold(h, 1 / rho)
        known = replace(state, scale=None, e=None, n=None, z1=None, z2=None, z3=None)
        multipliers, wa, rows = one_kernel(Solver._gather)(self, problem, known, split, new)
        values = jnp.maximum(values - 1 / rho, 0)
        info = self._told(state, {name: jnp.sum(row) for name, row in rows.items()}, values, inner_steps)
        after = {name: x for name, x in {**multipliers, "wa": wa, "n": split.n}.items() if x is not None}
        penalty = jnp.minimum(state.penalty * self.penalty_growth, self.penalty_max)
        return replace(state, a=new, e=split.e, penalty=penalty, **after), info

    def _weights(self, penalty):
        """rho, and the weight of the guide term with it."""
        rho1, rho2, rho3 = penalty
        rho = rho1 + rho2 if self.isometry else rho1
        rho = rho + rho3 if self.smoothness else rho
        return rho + self.guide_weight if self.guided else rho

    def _split(self, problem, state, rho):
        """Lines 4-8, as K: what the A-step thresholds, and the three proxes."""
        a, n = state.a, None
        rho1, rho2, rho3 = state.penalty
        k2 = c = k3 = away = inner_steps = None

        x = state.d - a - state.z1 * (1 / rho1)
        k1 = clip(x, self.outlier_weight * problem.weights[:, None] / rho1)
        e = x - k1
        h = rho1 * k1
        if self.isometry:
            p = a - state.z2 * (1 / rho2)
            n, inner_steps = self._bend(problem, state.n, p, rho2)
            k2 = p - n
            h = h - rho2 * k2
        if self.smoothness:
            x = state.wa - state.z3 * (1 / rho3)
            k3 = clip(x, self.smoothness_weight / rho3)
            c = x - k3
            h = h - rho3 * self._waverec(problem, k3)
        if self.guided and problem.guide is not None:
            away = problem.guide.positions.swapaxes(0, 1) - a
            h = h + self.guide_weight * problem.guide.weights[:, None] ** 2 * away
        return a + h * (1 / rho), Split(k1, e, k2, n, k3, c, away), inner_steps

    def _gather(self, problem, state, split, new):
        """Lines 12-14, W A, and the sums over joints that the residuals and the objective are made of."""
        rho1, rho2, rho3 = state.penalty
        multipliers, wa = {}, None
        moved = new - state.a
        multipliers["z1"] = rho1 * (moved - split.k1)
        rows = {
            "moved": _over_joints(moved**2),
            "explained": _over_joints((split.e - state.d + new) ** 2),
            "outlier": _over_joints(jnp.abs(problem.weights[:, None] * split.e)),
        }
        if self.isometry:
            multipliers["z2"] = z2 = -rho2 * (moved + split.k2)
            f, gradient = self._linearise(problem, split.n)
            if problem.edges:
                rows["isometry"] = _over_joints(f**2)
            rows["bent"] = _over_joints((split.n - new) ** 2)
            rows["force"] = _over_joints((gradient + z2) ** 2)
        if self.smoothness:
            wa = self._wavedec(problem, new)
            multipliers["z3"] = rho3 * (state.wa - wa - split.k3)
            rows["smoothness"] = _over_joints(jnp.abs(split.c))
            rows["smoothed"] = _over_joints((split.c - wa) ** 2)
        if self.guided and problem.guide is not None:
            trust = problem.guide.weights[:, None] ** 2
            rows["pulled"] = _over_joints(((1 - trust) * moved) ** 2)
            rows["guide"] = _over_joints(trust * (split.away - moved) ** 2)
        return multipliers, wa, rows

    def _told(self, state, sums, values, inner_steps):
        """What a step tells, of sums over all frames."""
        rho1, _, rho3 = state.penalty
        zero = jnp.zeros_like(rho1)
        primal = sums["explained"] + sums.get("bent", zero) + sums.get("smoothed", zero)
        dual = rho1**2 * sums["moved"] + sums.get("force", zero)
        if self.smoothness:
            dual = dual + rho3**2 * sums["moved"]
        if self.guided:
            dual = dual + self.guide_weight**2 * sums["pulled"]
        return Info(
            primal_residual=jnp.sqrt(primal) / state.scale[0],
            dual_residual=jnp.sqrt(dual) / state.scale[1],
            nuclear=values.sum(),
            outlier=self.outlier_weight * sums["outlier"],
            isometry=self.isometry_weight / 2 * sums.get("isometry", zero),
            smoothness=self.smoothness_weight * sums.get("smoothness", zero),
            guide=self.guide_weight / 2 * sums.get("guide", zero),
            rank=(values > 0).sum(),
            penalty=rho1,
            inner_steps=jnp.array(0) if inner_steps is None else inner_steps,
        )

    def check(self, problem: Problem) -> Verdict:
        """Verdict before the first step: on the input."""
        finite = jnp.isfinite(problem.positions).all() & jnp.isfinite(problem.weights).all()
        finite = finite & jnp.isfinite(problem.bone_lengths).all()
        result = Result.where((problem.weights > 0).any(), Result.running, Result.nothing_observed)
        return Result.where(finite, result, Result.non_finite_input)

    def terminate(self, info: Info) -> Verdict:
        """Verdict after a step."""
        done = (info.primal_residual < self.tolerance) & (info.dual_residual < self.tolerance)
        finite = jnp.isfinite(info.primal_residual) & jnp.isfinite(info.dual_residual)
        result = Result.where(done, Result.converged, Result.running)
        return Result.where(finite, result, Result.non_finite)

    def answer(
        self, problem: Problem, state: State
    ) -> tuple[Float[Array, "3 joint frame"], Float[Array, "3 joint frame"]]:
        """A and E."""
        return state.a.swapaxes(0, 1), state.e.swapaxes(0, 1)

    def _wavedec(self, problem, x):
        return wavelets.wavedec(x, self.wavelet, self.level, problem.frames)

    def _waverec(self, problem, c):
        return wavelets.waverec(c, problem.positions.shape[-1], self.wavelet, self.level, problem.frames)

    def _bones(self, problem, n):
        """Bone vectors of N, and F; 0 in the padding."""
        d = bone_vectors(n, problem.edges)
        return d, jnp.where(jnp.arange(n.shape[-1]) < problem.frames, residual(d, problem.bone_lengths), 0)

    def _linearise(self, problem, n):
        """F, and the gradient gamma J^T F."""
        d, f = self._bones(problem, n)
        gradient = self.isometry_weight * transpose_product(d, f, problem.edges, len(n))
        return f, gradient

    def _bend(self, problem, n, p, rho):
        """One step of Eq. 20 from N towards the prox of the isometry term at P, and the inner steps it took.

        By elimination where it suits, else by conjugate gradients.
        """
        d, f = self._bones(problem, n)
        if tree.suits(problem.edges, len(n)):
            return p - tree.solve(d, f, p - n, self.isometry_weight, rho, problem.edges), None
        # 1e-3: one Gauss-Newton step is itself inexact, and the next one starts from its remainder.
        delta, steps = pcg.solve(d, f, p - n, self.isometry_weight, rho, problem.edges, 1e-3, 3 * len(n))
        return n + delta, steps


def _square(x):
    """|x|^2."""
    return jnp.sum(x * x)


def _over_joints(x):
    """The sum over the first axis, one after the other: sums along an axis are a library's, and no part of a kernel."""
    return sum((x[k] for k in range(1, len(x))), x[0])
