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

Given A, the N-, C- and E-steps do not see each other, so this is ADM with two blocks, (N, C, E) and A. Without the
isometry term it converges for any constant penalty (Boyd et al., "Distributed Optimization and Statistical Learning
via ADMM", 2011, Sec. 3.2). A growing penalty forces the constraints to hold whatever the answer; hence `rho_max`, and
hence a verdict on both residuals.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from motionrecover import wavelets
from motionrecover.isometry import pcg, tree
from motionrecover.isometry.objective import bone_vectors, residual, transpose_product
from motionrecover.prox import singular_value_threshold, soft_threshold
from motionrecover.skeleton import is_forest
from motionrecover.solver.problem import Problem
from motionrecover.solver.result import Result, Trace

Positions = Float[Array, "3 joint frame"]
Coefficients = Float[Array, "3 joint coefficient"]
Scalar = Float[Array, ""]


class State(eqx.Module):
    """The seven variables and three penalties, and two by-products of a step that the next one needs again.

    Variables of a term that is left out are empty.
    """

    a: Positions
    e: Positions
    n: Positions
    c: Coefficients
    z1: Positions
    z2: Positions
    z3: Coefficients
    penalty: Float[Array, "3"]
    wa: Coefficients
    """W A."""
    gradient: Positions
    """gamma J^T F at N."""


class Info(eqx.Module):
    """What one step tells; the fields are those of `Trace`."""

    primal_residual: Scalar
    dual_residual: Scalar
    nuclear: Scalar
    outlier: Scalar
    isometry: Scalar
    smoothness: Scalar
    rank: Scalar
    penalty: Scalar
    inner_steps: Scalar


class Solver(eqx.Module):
    """Weights of the terms, penalties and tolerance: arrays, so that changing one does not compile anew."""

    outlier_weight: Scalar
    """lambda: higher explains less of the data as outliers."""
    isometry_weight: Scalar
    """gamma, in 1 / length^3: higher keeps bones more rigid."""
    smoothness_weight: Scalar
    """mu: higher gives smoother, slower motion."""
    penalty: Float[Array, "3"]
    """rho_1..3 of the first step, in 1 / length: higher enforces agreement sooner and stays nearer the start."""
    penalty_growth: Float[Array, "3"]
    """eta_1..3: 1 keeps the penalties; higher ends sooner and farther from the optimum."""
    penalty_max: Scalar
    """rho_max: where the growth ends, and convergence to a stationary point can begin."""
    tolerance: Scalar
    """Both residuals must fall below it."""
    isometry: bool = eqx.field(static=True)
    """Whether the model has the isometry term."""
    smoothness: bool = eqx.field(static=True)
    """Whether the model has the wavelet term."""
    zero_start: bool = eqx.field(static=True)
    """Start from A = 0 as printed, not from A = D."""
    wavelet: str = eqx.field(static=True)
    level: int = eqx.field(static=True)

    trace: ClassVar[type] = Trace

    def init(self, problem: Problem) -> State:
        """Line 2 of Algorithm 1: E = Z = 0, N = D, and A = D (or 0 where `zero_start`)."""
        d = problem.positions
        zero, empty = jnp.zeros_like(d), d[..., :0]
        a = zero if self.zero_start else d
        n, z2, gradient = (d, zero, self._linearise(problem, d)[1]) if self.isometry else (empty, empty, empty)
        wa = self._wavedec(problem, a) if self.smoothness else empty
        c = jnp.zeros_like(wa)
        return State(a, zero, n, c, zero, z2, c, self.penalty, wa, gradient)

    def step(self, problem: Problem, state: State) -> tuple[State, Info]:
        """One pass through lines 4-17.

        The dual residual is the distance of the new point from stationarity. The A-step is exact, so A and the new
        multipliers satisfy its condition; the E- and C-steps saw the old A, which leaves rho_1 (A - A_old) and
        rho_3 W (A - A_old); the N-step is one Gauss-Newton step, which leaves gamma J^T F(N) + Z_2. It is measured
        against |lambda w|, the largest norm that Z_1 can have at a solution, the primal residual against |D|: both are
        then free of units and of the length of the clip.
        """
        d, w = problem.positions, problem.weights
        rho1, rho2, rho3 = state.penalty
        n, z2, c, z3, gradient = state.n, state.z2, state.c, state.z3, state.gradient
        inner_steps = jnp.array(0)

        if self.isometry:
            right = -z2 - rho2 * (n - state.a) - gradient
            delta, inner_steps = self._solve(problem, n, right, rho2)
            n = n + delta
        if self.smoothness:
            c = soft_threshold(state.wa - z3 / rho3, self.smoothness_weight / rho3)
        e = soft_threshold(d - state.a - state.z1 / rho1, self.outlier_weight * w / rho1)

        h, rho = rho1 * (d - e) - state.z1, rho1
        if self.isometry:
            h, rho = h + rho2 * n + z2, rho + rho2
        if self.smoothness:
            h, rho = h + self._waverec(problem, rho3 * c + z3), rho + rho3
        a, values = singular_value_threshold(h / rho, 1 / rho)
        values = jnp.maximum(values - 1 / rho, 0)

        change = jnp.sum((a - state.a) ** 2)
        gap1 = e - d + a
        z1 = state.z1 + rho1 * gap1
        primal, dual = jnp.sum(gap1**2), rho1**2 * change
        isometry = smoothness = jnp.zeros_like(primal)
        wa = state.wa
        if self.isometry:
            gap2 = n - a
            z2 = z2 + rho2 * gap2
            isometry, gradient = self._linearise(problem, n)
            primal, dual = primal + jnp.sum(gap2**2), dual + jnp.sum((gradient + z2) ** 2)
        if self.smoothness:
            wa = self._wavedec(problem, a)
            gap3 = c - wa
            z3 = z3 + rho3 * gap3
            primal, dual = primal + jnp.sum(gap3**2), dual + rho3**2 * change
            smoothness = self.smoothness_weight * jnp.abs(c).sum()

        info = Info(
            primal_residual=_relative(primal, jnp.sum(d**2)),
            dual_residual=_relative(dual, jnp.sum((self.outlier_weight * w) ** 2)),
            nuclear=values.sum(),
            outlier=self.outlier_weight * jnp.abs(w * e).sum(),
            isometry=isometry,
            smoothness=smoothness,
            rank=(values > 0).sum(),
            penalty=rho1,
            inner_steps=inner_steps,
        )
        penalty = jnp.minimum(state.penalty * self.penalty_growth, self.penalty_max)
        return State(a, e, n, c, z1, z2, z3, penalty, wa, gradient), info

    def check(self, problem: Problem) -> Result:
        """Verdict before the first step: on the input."""
        finite = jnp.isfinite(problem.positions).all() & jnp.isfinite(problem.weights).all()
        finite = finite & jnp.isfinite(problem.bone_lengths).all()
        result = Result.where((problem.weights > 0).any(), Result.running, Result.nothing_observed)
        return Result.where(finite, result, Result.non_finite_input)

    def terminate(self, info: Info) -> Result:
        """Verdict after a step."""
        done = (info.primal_residual < self.tolerance) & (info.dual_residual < self.tolerance)
        finite = jnp.isfinite(info.primal_residual) & jnp.isfinite(info.dual_residual)
        result = Result.where(done, Result.converged, Result.running)
        return Result.where(finite, result, Result.non_finite)

    def answer(self, problem: Problem, state: State) -> tuple[Positions, Positions]:
        """A and E."""
        return state.a, state.e

    def _wavedec(self, problem, x):
        return wavelets.wavedec(x, self.wavelet, self.level, problem.frames)

    def _waverec(self, problem, c):
        return wavelets.waverec(c, problem.positions.shape[-1], self.wavelet, self.level, problem.frames)

    def _linearise(self, problem, n):
        """gamma / 2 E_iso(N) over the valid frames, and its gradient gamma J^T F."""
        d = bone_vectors(n, problem.edges)
        f = jnp.where(jnp.arange(n.shape[-1]) < problem.frames, residual(d, problem.bone_lengths), 0)
        gradient = self.isometry_weight * transpose_product(d, f, problem.edges, n.shape[1])
        return self.isometry_weight / 2 * jnp.sum(f**2), gradient

    def _solve(self, problem, n, right, rho):
        """Eq. 20: by elimination on a forest, by conjugate gradients on any other graph."""
        d, joints = bone_vectors(n, problem.edges), n.shape[1]
        if is_forest(problem.edges, joints):
            return tree.solve(d, right, self.isometry_weight, rho, problem.edges), jnp.array(0)
        # 1e-3: one Gauss-Newton step is itself inexact, and the next one starts from its remainder.
        return pcg.solve(d, right, self.isometry_weight, rho, problem.edges, 1e-3, 3 * joints)


def _relative(square, scale_square):
    """sqrt(square / scale_square), and sqrt(square) where there is no scale."""
    return jnp.sqrt(square / jnp.where(scale_square > 0, scale_square, 1))
