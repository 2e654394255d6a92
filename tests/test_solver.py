"""The solver: convergence, optima known from elsewhere, symmetries of the model, batches."""

from dataclasses import replace
from functools import partial

import cvxpy as cp
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import SKELETONS, TOLERANCE, clip, hit, lengths_of, problem_of
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.reference import algorithm1
from motionrecover.intake import matrix_from, positions_from
from motionrecover.presets import PUBLISHED
from motionrecover.solver import Result, Solver, solve
from motionrecover.wavelets import wavedec

run = eqx.filter_jit(solve)
STORED = 24
"""Frames stored for every catalogue problem, so that they share programs."""


def constant_penalties(solver: Solver) -> Solver:
    """The same solver with the penalties where its growth ends, from the first step on."""
    return eqx.tree_at(lambda s: s.penalty, solver, jnp.asarray(solver.penalty_max))


def with_tolerance(solver: Solver, tolerance: float) -> Solver:
    return eqx.tree_at(lambda s: s.tolerance, solver, jnp.asarray(tolerance, solver.tolerance.dtype))


def answer(solution, problem):
    """Positions (frame, joint, 3) of the valid frames."""
    return np.asarray(solution.positions).transpose(2, 1, 0)[: int(problem.frames)]


def catalogue_problem(name, frames, fraction, seed, **changes):
    truth = clip(SKELETONS[name], frames, seed)
    return problem_of(SKELETONS[name], hit(truth, fraction, seed), lengths_of(SKELETONS[name], truth), **changes)


@pytest.mark.parametrize("preset", PUBLISHED)
@pytest.mark.parametrize("name", ["chain", "star", "cmu25", "braced"])
@settings(max_examples=8)
@given(frames=st.integers(3, STORED), fraction=st.sampled_from([0.0, 0.05, 0.2, 0.8]), seed=st.integers(0, 999))
def test_constant_penalties_converge(name, preset, frames, fraction, seed):
    """Both residuals fall under the tolerance, from any clip, and stay finite on the way."""
    problem = catalogue_problem(name, frames, fraction, seed, stored=STORED)
    solver = with_tolerance(constant_penalties(PUBLISHED[preset].solver(problem)), TOLERANCE["residual"])
    solution = run(solver, problem, 20000)
    assert Result(int(solution.result)) == Result.converged
    last = int(solution.steps) - 1
    assert solution.trace.primal_residual[last] < TOLERANCE["residual"]
    assert solution.trace.dual_residual[last] < TOLERANCE["residual"]


@pytest.mark.parametrize("preset", ["lowrank_wang2016", "convex str"])
def test_convex_case_reaches_the_objective_of_an_interior_point_solver(preset):
    """Without the isometry term: minimise |A|_* + lambda |D - A|_1 + mu |W A|_1, here by Clarabel on the same data."""
    frames = 8
    problem = catalogue_problem("chain", frames, 0.2, 1, stored=frames)
    name = PUBLISHED.get(preset) or replace(PUBLISHED["str_yang2020"], isometry_weight=None, wavelet="db2")
    solver = with_tolerance(name.solver(problem), 1e-8)
    solution = run(solver, problem, 20000)

    d = matrix_from(np.asarray(problem.positions).transpose(2, 1, 0))
    w = np.kron(np.asarray(wavedec(jnp.eye(frames), "db2", 2)).T, np.eye(3))
    a = cp.Variable(d.shape)
    objective = cp.normNuc(a) + float(solver.outlier_weight) * cp.sum(cp.abs(d - a))
    if solver.smoothness:
        objective += float(solver.smoothness_weight) * cp.sum(cp.abs(w @ a))
    expected = cp.Problem(cp.Minimize(objective)).solve(solver=cp.CLARABEL)

    found = matrix_from(answer(solution, problem))
    value = np.linalg.norm(found, "nuc") + float(solver.outlier_weight) * np.abs(d - found).sum()
    if solver.smoothness:
        value += float(solver.smoothness_weight) * np.abs(w @ found).sum()
    np.testing.assert_allclose(value, expected, rtol=TOLERANCE["objective"])
    # The trace tells the same value at the split variables.
    np.testing.assert_allclose(solution.trace.objective[int(solution.steps) - 1], value, rtol=TOLERANCE["objective"])


def test_planted_low_rank_and_sparse_truth_is_found():
    """Exact recovery where theory promises it: lambda = 1 / sqrt(rows) (Candes et al., "Robust principal component
    analysis?", J. ACM 58(3), 2011, Theorem 1.1)."""
    rng = np.random.default_rng(0)
    frames, joints = 60, 40
    truth = positions_from(rng.normal(size=(3 * frames, 2)) @ rng.normal(size=(2, joints)))
    sparse = np.where(rng.random(truth.shape) < 0.05, rng.uniform(-5, 5, truth.shape), 0)
    skeleton = SKELETONS["chain"]
    problem = problem_of(skeleton, truth, np.ones(4), stored=frames)
    problem = eqx.tree_at(lambda p: p.positions, problem, jnp.asarray((truth + sparse).transpose(2, 1, 0)))
    solver = replace(PUBLISHED["lowrank_wang2016"], outlier_weight=1 / np.sqrt(3), reach=1.0).solver(problem)
    solution = run(with_tolerance(solver, 1e-8), problem, 5000)
    assert solution.result == Result.converged
    error = np.linalg.norm(answer(solution, problem) - truth) / np.linalg.norm(truth)
    assert error < TOLERANCE["planted"]
    assert solution.trace.rank[int(solution.steps) - 1] == 2


@pytest.mark.parametrize("initialisation", ["data", "printed"])
def test_equals_the_plain_reference_step_by_step(initialisation):
    frames, steps = 80, 12  # the shortest length at which PyWavelets does not warn of boundary effects
    problem = catalogue_problem("cmu25", frames, 0.2, 0, stored=frames)
    preset = replace(PUBLISHED["str_yang2020"], initialisation=initialisation, tolerance=0.0)
    solver = preset.solver(problem)
    solution = run(solver, problem, steps)
    d = matrix_from(np.asarray(problem.positions).transpose(2, 1, 0))
    a, e, energy = algorithm1(
        d,
        problem.edges,
        problem.bone_lengths,
        lam=1 / np.sqrt(frames),
        gamma=100.0,
        mu=0.01,
        rho=solver.penalty,
        eta=1.3,
        rho_max=solver.penalty_max,
        steps=steps,
        A0=0 * d if initialisation == "printed" else d,
        rtol=1e-12,
    )
    np.testing.assert_allclose(matrix_from(answer(solution, problem)), a, atol=TOLERANCE["reference"])
    outliers = np.asarray(solution.outliers).transpose(2, 1, 0)
    np.testing.assert_allclose(matrix_from(outliers), e, atol=TOLERANCE["reference"])
    np.testing.assert_allclose(solution.trace.objective, energy, rtol=1e-6)


def test_float32_follows_float64():
    exact = catalogue_problem("cmu25", STORED, 0.1, 0, stored=STORED)
    single = catalogue_problem("cmu25", STORED, 0.1, 0, stored=STORED, dtype=np.float32)
    preset = replace(PUBLISHED["str_yang2020"], tolerance=0.0)
    answers = [answer(run(preset.solver(p), p, 400), p) for p in (exact, single)]
    assert answers[1].dtype == np.float32
    np.testing.assert_allclose(answers[1], answers[0], atol=TOLERANCE["float32"])


@pytest.mark.parametrize("stored", [24, 33])
def test_padding_leaves_the_answer_alone(stored):
    exact = catalogue_problem("cmu25", 21, 0.1, 0, stored=21)
    padded = catalogue_problem("cmu25", 21, 0.1, 0, stored=stored)
    preset = PUBLISHED["str_yang2020"]
    a, b = (run(preset.solver(p), p, 400) for p in (exact, padded))
    np.testing.assert_allclose(answer(b, padded), answer(a, exact), atol=TOLERANCE["equivariance"])
    assert (np.asarray(b.positions)[..., 21:] == 0).all()
    np.testing.assert_allclose(b.trace.objective, a.trace.objective, rtol=1e-6)
    assert a.steps == b.steps


def stack(trees):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def test_vmap_equals_one_at_a_time_and_a_bad_clip_spoils_only_itself():
    problems = [catalogue_problem("cmu25", frames, 0.1, frames, stored=STORED) for frames in (24, 17, 24, 20, 9)]
    solvers = [PUBLISHED["str_yang2020"].solver(p) for p in problems]
    problems[2] = eqx.tree_at(lambda p: p.positions, problems[2], problems[2].positions.at[0, 3, 5].set(jnp.nan))
    problems[3] = eqx.tree_at(lambda p: p.weights, problems[3], 0 * problems[3].weights)
    batch = eqx.filter_jit(jax.vmap(partial(solve, max_steps=400)))(stack(solvers), stack(problems))
    verdicts = [Result(int(batch.result[k])) for k in range(5)]
    assert verdicts[2] == Result.non_finite_input
    assert verdicts[3] == Result.nothing_observed
    for k in (0, 1, 4):
        alone = run(solvers[k], problems[k], 400)
        assert verdicts[k] == alone.result == Result.converged
        assert batch.steps[k] == alone.steps
        np.testing.assert_allclose(batch.positions[k], alone.positions, atol=TOLERANCE["equivariance"])


def test_missing_samples_count_for_nothing():
    """Whatever stands where the weight is zero, the end is the same."""
    problem = catalogue_problem("cmu25", STORED, 0.0, 0, stored=STORED)
    gone = np.zeros(problem.weights.shape, bool)
    gone[7, 4:9] = gone[15, 18] = True
    problem = eqx.tree_at(lambda p: p.weights, problem, jnp.where(gone, 0.0, problem.weights))
    other = eqx.tree_at(lambda p: p.positions, problem, jnp.where(gone, problem.positions + 0.01, problem.positions))
    solver = with_tolerance(PUBLISHED["str_yang2020"].solver(problem), 1e-8)
    a, b = (run(solver, p, 20000) for p in (problem, other))
    np.testing.assert_allclose(answer(a, problem), answer(b, other), atol=1e-5)


def test_growing_penalties_alone_are_no_verdict():
    """With penalties that outgrow the problem the constraints hold ever better and the answer stays wrong: only the
    primal residual falls, so the verdict is not `converged`."""
    problem = catalogue_problem("cmu25", STORED, 0.2, 0, stored=STORED)
    printed = replace(PUBLISHED["str_yang2020"], initialisation="printed")
    solution = run(printed.solver(problem), problem, 400)
    assert solution.trace.primal_residual[-1] < 1e-6
    assert solution.result == Result.max_steps


def test_trace_is_nan_after_the_last_step():
    problem = catalogue_problem("chain", STORED, 0.0, 0, stored=STORED)
    solution = run(PUBLISHED["lowrank_wang2016"].solver(problem), problem, 500)
    steps = int(solution.steps)
    assert 0 < steps < 500
    for column in jax.tree.leaves(solution.trace):
        assert np.isfinite(column[:steps]).all()
        assert np.isnan(column[steps:]).all()


def test_other_weights_compile_nothing_anew():
    traces = []

    @eqx.filter_jit
    def counted(solver, problem):
        traces.append(1)
        return solve(solver, problem, 3)

    problem = catalogue_problem("chain", STORED, 0.1, 0, stored=STORED)
    for weight in (1.0, 100.0):
        counted(replace(PUBLISHED["str_yang2020"], isometry_weight=weight, penalty=weight).solver(problem), problem)
    assert len(traces) == 1
