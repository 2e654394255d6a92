"""The same 40 iterations of `str_yang2020`, computed in other ways.

Each contender is prepared for a `Task` and gives a call that returns the recovered positions (frame, joint, 3). What it
compiles is compiled before the call is timed.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.reference import algorithm1, soft, wavedec, waverec
from motionrecover import corrupt, intake, wavelets
from motionrecover.presets import PUBLISHED, Preset
from motionrecover.recovery import recover
from motionrecover.solver import Solver
from motionrecover.synthetic import synthesize

STEPS = 40
IN_WINDOWS = replace(PUBLISHED["str_yang2020"], tolerance=0.0)
"""As it is used, but for the steps, which are as many everywhere."""
PRESET = replace(IN_WINDOWS, window=None)
"""The whole clip at once, as in the paper, and all the steps."""


@dataclass(frozen=True)
class Task:
    """A made-up motion of 25 joints at 120 Hz, 20 % of its samples displaced, and what the iteration needs of it."""

    frames: int
    steps: int = STEPS

    @cached_property
    def _motion(self):
        return synthesize(self.frames / 120, 120)

    @cached_property
    def truth(self) -> np.ndarray:
        """Positions (frame, joint, 3) in metres."""
        return np.asarray(self._motion.positions, np.float64)

    @cached_property
    def data(self) -> np.ndarray:
        """The corrupted positions."""
        return corrupt.joints(self.truth, 0.2, seed=0)[0]

    @property
    def skeleton(self):
        """Of the motion."""
        return self._motion.skeleton

    @cached_property
    def lengths(self) -> np.ndarray:
        """True bone lengths (bone,)."""
        return np.median(self.skeleton.bone_lengths_of(self.truth), 0)

    @cached_property
    def origin(self) -> np.ndarray:
        """Of the coordinates that the solver works in."""
        return np.median(self.data.reshape(-1, 3), 0)

    @cached_property
    def matrix(self) -> np.ndarray:
        """D, 3T x S."""
        return intake.matrix_from(self.data - self.origin)

    @cached_property
    def solver(self) -> Solver:
        """Weights and penalties of the preset."""
        taken = intake.take_in(self.data, self.skeleton, bone_lengths=self.lengths)
        with jax.enable_x64(True):
            problem, _ = taken.problem(slice(0, self.frames), self.frames, np.dtype(np.float64))
            return PRESET.solver(problem)

    def settings(self) -> tuple[np.ndarray, ...]:
        """lambda, gamma, mu, rho, eta, rho_max in float64."""
        s = self.solver
        names = (s.outlier_weight, s.isometry_weight, s.smoothness_weight, s.penalty, s.penalty_growth, s.penalty_max)
        return tuple(np.asarray(x, np.float64) for x in names)

    def positions(self, matrix: np.ndarray) -> np.ndarray:
        """A matrix of the solver's coordinates as positions."""
        return intake.positions_from(np.asarray(matrix)) + self.origin


Call = Callable[[], np.ndarray]


def ours(task: Task) -> Call:
    """`recover`: the front door, float32."""
    return lambda: ours_timed(task)[0]


def ours_timed(task: Task, dtype: str = "float32", preset: Preset = PRESET) -> tuple[np.ndarray, dict[str, float]]:
    """The answer of `recover`, and its seconds."""
    found = recover(
        task.data, task.skeleton, preset=preset, bone_lengths=task.lengths, max_steps=task.steps, dtype=dtype
    )
    return found.positions, found.seconds


def reference(task: Task) -> Call:
    """`benchmarks.reference`: NumPy, PyWavelets and SciPy's sparse conjugate gradients, float64."""
    edges, settings = task.skeleton.edges, task.settings()
    return lambda: task.positions(algorithm1(task.matrix, edges, task.lengths, *settings, steps=task.steps)[0])


def numpy_frames(task: Task) -> Call:
    """NumPy over all frames at once, float64: the systems of Eq. 20 by batched `np.linalg.solve`, the SVD by LAPACK."""
    return lambda: task.positions(_in_numpy(task, _dense_step))


def numpy_elimination(task: Task) -> Call:
    """Our algorithm in NumPy, float64: elimination of bones, singular values from the Gram matrix."""
    return lambda: task.positions(_in_numpy(task, _eliminated_step, gram=True))


def _in_numpy(task, bend, gram=False):
    lam, gamma, mu, rho, eta, rho_max = task.settings()
    D, edges, lengths = task.matrix, np.asarray(task.skeleton.edges), task.lengths
    A, N = D.copy(), D.copy()
    Z1, Z2, Z3 = np.zeros_like(D), np.zeros_like(D), np.zeros_like(D)
    WA = wavedec(A, PRESET.wavelet, PRESET.level)
    for _ in range(task.steps):
        frames = N.reshape(-1, 3, N.shape[1])
        N = bend(frames, (A - Z2 / rho[1]).reshape(frames.shape), edges, lengths, gamma, rho[1]).reshape(D.shape)
        C = soft(WA - Z3 / rho[2], mu / rho[2])
        E = soft(D - A - Z1 / rho[0], lam / rho[0])
        H3 = waverec(C + Z3 / rho[2], PRESET.wavelet, PRESET.level)
        H = (rho[0] * (D - E) - Z1 + rho[1] * N + Z2 + rho[2] * H3) / rho.sum()
        if gram:
            values, V = np.linalg.eigh(H.T @ H)
            values = np.sqrt(np.maximum(values, 1e-300))
            A = H @ ((V * np.maximum(1 - 1 / rho.sum() / values, 0)) @ V.T)
        else:
            U, s, Vt = np.linalg.svd(H, full_matrices=False)
            A = (U * np.maximum(s - 1 / rho.sum(), 0)) @ Vt
        WA = wavedec(A, PRESET.wavelet, PRESET.level)
        Z1, Z2, Z3 = Z1 + rho[0] * (E - D + A), Z2 + rho[1] * (N - A), Z3 + rho[2] * (C - WA)
        rho = np.minimum(eta * rho, rho_max)
    return A


def _dense_step(n, p, edges, lengths, gamma, rho):
    """One Gauss-Newton step from n towards the prox at p, (frame, 3, joint): T systems of 3S unknowns."""
    (i, j), (frames, _, joints), bones = edges.T, n.shape, len(edges)
    d = n[:, :, i] - n[:, :, j]
    J = np.zeros((frames, bones, 3, joints))
    h = np.arange(bones)
    J[:, h, :, i] = 2 * d.transpose(2, 0, 1)
    J[:, h, :, j] = -2 * d.transpose(2, 0, 1)
    J = J.reshape(frames, bones, -1)
    F = (d**2).sum(1) - lengths**2
    system = gamma * J.transpose(0, 2, 1) @ J + rho * np.eye(3 * joints)
    right = rho * (p - n).reshape(frames, -1, 1) - gamma * J.transpose(0, 2, 1) @ F[..., None]
    return n + np.linalg.solve(system, right).reshape(n.shape)


def _eliminated_step(n, p, edges, lengths, gamma, rho):
    """The same step by the elimination of `isometry.tree`, an entry of all frames at a time."""
    from motionrecover.isometry.tree import elimination

    pairs, updates = elimination(tuple(map(tuple, edges.tolist())), n.shape[2])
    i, j = edges.T
    k, l, sign = np.array(pairs).T
    d = np.ascontiguousarray((n[:, :, i] - n[:, :, j]).transpose(2, 1, 0))
    dp = (p[:, :, i] - p[:, :, j]).transpose(2, 1, 0)
    square = (d * d).sum(1)
    right = gamma * (2 * (d * dp).sum(1) - square - lengths[:, None] ** 2)
    coupling = 4 * gamma * sign[:, None] * (d[k] * d[l]).sum(1)
    rows = np.concatenate([8 * gamma * square + rho, right, coupling])
    for target, x, y, pivot in updates:
        rows[target] -= rows[x] * rows[y] / rows[pivot]
    y = rows[len(edges) : 2 * len(edges)] / rows[: len(edges)]
    push = 2 * (d * y[:, None]).transpose(2, 1, 0)
    out = p.copy()
    np.subtract.at(out, (slice(None), slice(None), i), push)
    np.add.at(out, (slice(None), slice(None), j), push)
    return out


def lineax_optimistix(task: Task) -> Call:
    """Assembled from libraries in JAX, float32.

    The Gauss-Newton step of all frames by `lineax.CG` on Jacobian products of autodiff, the loop by
    `optimistix.fixed_point`, the SVD by `jnp.linalg.svd`; W is ours.
    """
    import lineax as lx
    import optimistix as optx

    def bend(n, p, residual, gamma, rho):
        f, jacobian = jax.linearize(residual, n)
        transposed = jax.linear_transpose(jacobian, n)

        def product(x):
            return gamma * transposed(jacobian(x))[0] + rho * x

        right = rho * (p - n) - gamma * transposed(f)[0]
        operator = lx.FunctionLinearOperator(product, jax.eval_shape(lambda: n), lx.positive_semidefinite_tag)
        return n + lx.linear_solve(operator, right, lx.CG(rtol=1e-4, atol=1e-4), throw=False).value

    def loop(step, state):
        solver = optx.FixedPointIteration(rtol=0.0, atol=0.0)
        return optx.fixed_point(lambda y, _: step(y), solver, state, max_steps=task.steps, throw=False).value

    return _in_jax(task, bend, loop)


def jaxopt_parts(task: Task) -> Call:
    """Assembled from jaxopt's parts, float32: its conjugate gradients and its fixed-point loop; the rest as above."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import jaxopt
        from jaxopt.linear_solve import solve_cg

    def bend(n, p, residual, gamma, rho):
        f, jacobian = jax.linearize(residual, n)
        transposed = jax.linear_transpose(jacobian, n)
        right = rho * (p - n) - gamma * transposed(f)[0]
        return n + solve_cg(lambda x: gamma * transposed(jacobian(x))[0] + rho * x, right, tol=1e-4)

    def loop(step, state):
        solver = jaxopt.FixedPointIteration(step, maxiter=task.steps, tol=0.0, implicit_diff=False)
        return solver.run(state).params

    return _in_jax(task, bend, loop)


def _in_jax(task, bend, loop):
    i, j = np.asarray(task.skeleton.edges).T

    def residual(n):
        return ((n[:, i] - n[:, j]) ** 2).sum(0) - lengths[:, None] ** 2

    def shrink(x, threshold):
        return jnp.sign(x) * jnp.maximum(jnp.abs(x) - threshold, 0)

    def step(state):
        A, N, Z1, Z2, Z3, rho = state
        N = bend(N, A - Z2 / rho[1], residual, gamma, rho[1])
        C = shrink(wavelets.wavedec(A, PRESET.wavelet, PRESET.level) - Z3 / rho[2], mu / rho[2])
        E = shrink(D - A - Z1 / rho[0], lam / rho[0])
        H3 = wavelets.waverec(C + Z3 / rho[2], D.shape[-1], PRESET.wavelet, PRESET.level)
        H = (rho[0] * (D - E) - Z1 + rho[1] * N + Z2 + rho[2] * H3) / rho.sum()
        U, s, Vt = jnp.linalg.svd(H.transpose(2, 0, 1).reshape(-1, H.shape[1]), full_matrices=False)
        A = ((U * jnp.maximum(s - 1 / rho.sum(), 0)) @ Vt).reshape(-1, 3, H.shape[1]).transpose(1, 2, 0)
        WA = wavelets.wavedec(A, PRESET.wavelet, PRESET.level)
        Z1, Z2, Z3 = Z1 + rho[0] * (E - D + A), Z2 + rho[1] * (N - A), Z3 + rho[2] * (C - WA)
        return A, N, Z1, Z2, Z3, jnp.minimum(eta * rho, rho_max)

    def call():
        with jax.enable_x64(False):
            return np.asarray(run(state)).transpose(2, 1, 0) + task.origin

    with jax.enable_x64(False):
        lam, gamma, mu, rho, eta, rho_max = (jnp.asarray(x, jnp.float32) for x in task.settings())
        D = jnp.asarray((task.data - task.origin).transpose(2, 1, 0), jnp.float32)
        lengths = jnp.asarray(task.lengths, jnp.float32)
        zero = jnp.zeros_like(D)
        state = D, D, zero, zero, jnp.zeros_like(wavelets.wavedec(D, PRESET.wavelet, PRESET.level)), rho
        run = jax.jit(lambda state: loop(step, state)[0]).lower(state).compile()
    return call


CONTENDERS: dict[str, Callable[[Task], Call]] = {
    "ours": ours,
    "reference": reference,
    "numpy": numpy_frames,
    "numpy elimination": numpy_elimination,
    "optimistix + lineax": lineax_optimistix,
    "jaxopt": jaxopt_parts,
}
"""By name, ours first."""
