"""The robust recovery of one clip: what it finds, its symmetries, padding and batches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import SKELETONS, clip, hit, lengths_of, problem_of

from motionrecover.evidence.bone_lengths import evidence, scale_about
from motionrecover.evidence.drive import estimate_drive
from motionrecover.solver import Problem, Result, Smoother, solve

run = eqx.filter_jit(solve)
FRAMES, STORED, STEPS = 80, 96, 60
CMU = SKELETONS["cmu25"]
TRUTH = clip(CMU, FRAMES)


def case(data, stored=STORED, weights=None, skeleton=CMU, size=1.0):
    """Solver and problem for complete data on a catalogue skeleton whose bones are `size` times as long."""
    lengths = size * lengths_of(skeleton, TRUTH if skeleton is CMU else data)
    problem = problem_of(skeleton, data, lengths, stored=stored)
    if weights is not None:
        pad = ((0, 0), (0, stored - len(data)))
        problem = eqx.tree_at(lambda p: p.weights, problem, jnp.asarray(np.pad(weights.T, pad)))
    measured = skeleton.bone_lengths_of(data)
    bones = scale_about(measured, lengths)
    together = np.pad(evidence(measured, bones), ((0, stored - len(data)), (0, 0)))
    scale = float(np.median(lengths))
    drive = np.maximum(estimate_drive(data, np.ones(data.shape[:2], bool)), (1e-5 * scale) ** 2)
    values = (together, drive, scale, 0.1, np.inf, 0.02)
    return Smoother(*(jnp.asarray(value, jnp.float64) for value in values)), problem


def answer(solution):
    return np.asarray(solution.state.positions)[:FRAMES]


def intact(solution):
    return np.asarray(solution.state.intact)[:FRAMES] > 0.5


@pytest.mark.parametrize("fraction", [0.05, 0.2, 0.5])
def test_it_tells_displaced_samples_from_intact_ones(fraction):
    data = hit(TRUTH, fraction)
    displaced = np.any(data != TRUTH, -1)
    solution = run(*case(data), STEPS)
    found = intact(solution)
    assert np.mean(found[displaced]) < 0.01
    assert np.mean(found[~displaced]) > 0.98
    assert float(solution.state.outlier_share) == pytest.approx(displaced.mean(), abs=0.02)


def test_it_finds_the_noise():
    noisy = TRUTH + 0.003 * np.random.default_rng(0).normal(size=TRUTH.shape)
    solution = run(*case(noisy), STEPS)
    np.testing.assert_allclose(np.sqrt(solution.state.noise), 0.003, rtol=0.2)
    centre = TRUTH.mean((0, 1)) + (noisy.mean((0, 1)) - TRUTH.mean((0, 1)))
    error = np.linalg.norm(answer(solution) + centre - TRUTH, axis=-1).mean()
    assert error < 0.6 * np.linalg.norm(noisy - TRUTH, axis=-1).mean()


def test_clean_clips_have_no_outliers():
    assert intact(run(*case(TRUTH), STEPS)).all()


def test_it_converges():
    solution = run(*case(hit(TRUTH, 0.2)), STEPS)
    assert solution.result == Result.converged
    steps = int(solution.steps)
    assert np.isfinite(np.asarray(solution.trace.noise)[:steps]).all()
    assert np.isnan(np.asarray(solution.trace.noise)[steps:]).all()


@pytest.mark.parametrize("stored", [FRAMES, 112])
def test_padding_changes_nothing(stored):
    data = hit(TRUTH, 0.2)
    here, there = (run(*case(data, length), STEPS) for length in (STORED, stored))
    np.testing.assert_allclose(answer(here), answer(there), atol=1e-9)


def test_missing_samples_count_for_nothing():
    weights = np.ones(TRUTH.shape[:2])
    weights[30:40, 5] = 0
    wild = TRUTH.copy()
    wild[30:40, 5] += 0.05
    here, there = (case(TRUTH, weights=weights), case(wild, weights=weights))
    # The same origin, bones and first guess for both.
    there = (here[0], eqx.tree_at(lambda p: p.positions, here[1], there[1].positions + _shift(here[1], there[1])))
    np.testing.assert_allclose(answer(run(*here, STEPS)), answer(run(*there, STEPS)), atol=1e-4)


def _shift(here: Problem, there: Problem):
    """Both problems are centred at the mean of their data; this undoes the difference."""
    return here.positions[:, :1, :1] - there.positions[:, :1, :1]


def test_rotation_units_and_joint_order_go_through():
    data = hit(TRUTH, 0.2)
    plain = answer(run(*case(data), STEPS))
    q, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    np.testing.assert_allclose(answer(run(*case(data @ q.T), STEPS)), plain @ q.T, atol=1e-6)
    np.testing.assert_allclose(answer(run(*case(1000 * data, size=1000), STEPS)), 1000 * plain, atol=1e-3)
    order = np.random.default_rng(1).permutation(len(CMU.names))
    place = np.argsort(order)
    solver, problem = case(data)
    edges = tuple((int(place[i]), int(place[j])) for i, j in CMU.edges)
    shuffled = Problem(problem.positions[:, order], problem.weights[order], problem.bone_lengths, problem.frames, edges)
    solver = eqx.tree_at(lambda s: s.drive, solver, solver.drive[order])
    np.testing.assert_allclose(answer(run(solver, shuffled, STEPS))[:, place], plain, atol=1e-6)


def test_a_batch_gives_each_clip_its_own_answer_and_verdict():
    cases = [case(hit(TRUTH, 0.2, seed)) for seed in (0, 1)]
    broken = eqx.tree_at(lambda p: p.positions, cases[1][1], cases[1][1].positions.at[0, 0, 0].set(jnp.nan))
    solvers, problems = (
        jax.tree.map(lambda *x: jnp.stack(x), *parts) for parts in zip(*cases, (cases[1][0], broken), strict=True)
    )
    together = eqx.filter_jit(jax.vmap(lambda s, p: solve(s, p, STEPS)))(solvers, problems)
    verdicts = [Result(int(together.result[k])) for k in range(3)]
    assert verdicts[2] == Result.non_finite_input
    alone = [run(*each, STEPS) for each in cases]
    for k, solution in enumerate(alone):
        assert verdicts[k] == solution.result
        np.testing.assert_allclose(np.asarray(together.state.positions)[k][:FRAMES], answer(solution), atol=1e-7)


def test_activity_follows_fast_moments():
    t = np.arange(FRAMES)
    kick = 0.3 * np.exp(-0.5 * ((t - 40) / 3.0) ** 2)
    data = TRUTH + kick[:, None, None] * np.array([1.0, 0, 0])
    noisy = data + 0.002 * np.random.default_rng(0).normal(size=data.shape)
    solution = run(*case(noisy), STEPS)
    activity = np.asarray(solution.state.activity)[:FRAMES]
    assert activity[38:43].mean() > 3 * np.median(activity)
