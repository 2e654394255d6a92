"""The guide term: by its definition, without it bit for bit the published model, and through the front door."""

from dataclasses import replace
from types import SimpleNamespace

import cvxpy as cp
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import SKELETONS, TOLERANCE, clip, hit, lengths_of, problem_of

from motionrecover import recover
from motionrecover.intake import matrix_from
from motionrecover.presets import PUBLISHED
from motionrecover.solver import Guide, Result, solve
from motionrecover.wavelets import wavedec

run, step = eqx.filter_jit(solve), eqx.filter_jit(lambda solver, problem, state: solver.step(problem, state))
FRAMES = 8
STR = PUBLISHED["str_yang2020"]
CONVEX = replace(STR, isometry_weight=None, wavelet="db2", guide_weight=3.0)
CHAIN = SKELETONS["chain"]


def guided(trust=None, seed=1):
    """A problem with a guide that is off by centimetres, trusted by `trust` or by any numbers from 0 to 1."""
    rng, truth = np.random.default_rng(seed), clip(CHAIN, FRAMES, seed)
    problem = problem_of(CHAIN, hit(truth, 0.2, seed), lengths_of(CHAIN, truth), stored=FRAMES)
    away = np.asarray(problem.positions) + rng.normal(scale=0.05, size=problem.positions.shape)
    trust = rng.random((5, FRAMES)) if trust is None else np.full((5, FRAMES), trust)
    guide = Guide(jnp.asarray(away), jnp.asarray(trust))
    return eqx.tree_at(lambda p: p.guide, problem, guide, is_leaf=lambda leaf: leaf is None)


def matrix(positions):
    """3T x S of (3, joint, frame)."""
    return matrix_from(np.asarray(positions).transpose(2, 1, 0))


def trust_matrix(problem):
    return np.repeat(np.asarray(problem.guide.weights).T, 3, axis=0)


def one_norm(x):
    return np.abs(x).sum()


def test_without_weight_or_guide_it_is_the_published_model_bit_for_bit():
    problem, without = guided(), eqx.tree_at(lambda p: p.guide, guided(), None)
    answers = [run(p.solver(q), q, 50) for p, q in ((replace(STR, guide_weight=0.0), problem), (STR, without))]
    for a, b in zip(*(jax.tree.leaves((each.positions, each.outliers, each.trace)) for each in answers), strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    drawn = run(STR.solver(problem), problem, 50)
    assert np.abs(drawn.positions - answers[0].positions).max() > 1e-3


@pytest.mark.parametrize("trust", [1.0, None])
def test_a_step_minimises_what_it_says(trust):
    """A of one step, against an interior-point solver on its definition: the squares of the A-step, and the one above
    the guide term, which for B = 1 is the term itself."""
    problem = guided(trust)
    solver = CONVEX.solver(problem)
    state = run(solver, problem, 3).state
    after, _ = step(solver, problem, state)

    # Line by line from the docstring of `solver.step`; the copies C and E are those of the step.
    rho1, _, rho3 = np.asarray(state.penalty)
    beta, b = float(solver.guide_weight), trust_matrix(problem)
    d, old, e, z1 = (matrix(x.swapaxes(0, 1)) for x in (state.d, state.a, after.e, state.z1))
    w = np.asarray(wavedec(jnp.eye(FRAMES), "db2", 2)).T
    c = np.asarray(state.wa - state.z3 / rho3)
    mu = float(solver.smoothness_weight)
    c = np.sign(c) * np.maximum(np.abs(c) - mu / rho3, 0)
    h3 = matrix(((c + np.asarray(state.z3) / rho3) @ w).swapaxes(0, 1))
    f = matrix(problem.guide.positions)
    targets = ((rho1, d - e - z1 / rho1), (rho3, h3), (beta, old + b**2 * (f - old)))

    a = cp.Variable(d.shape)
    cost = cp.normNuc(a) + sum(weight / 2 * cp.sum_squares(a - h) for weight, h in targets)
    cp.Problem(cp.Minimize(cost)).solve(solver=cp.CLARABEL)
    np.testing.assert_allclose(matrix(after.a.swapaxes(0, 1)), a.value, atol=TOLERANCE["brute force"] ** 0.5)


def test_the_convex_case_reaches_the_objective_of_an_interior_point_solver():
    problem = guided()
    solver = CONVEX.solver(problem)
    solver = eqx.tree_at(lambda s: (s.penalty, s.tolerance), solver, (solver.penalty_max, jnp.asarray(1e-8)))
    solution = run(solver, problem, 20000)
    assert Result(int(solution.result)) == Result.converged

    w, b, f = np.kron(np.asarray(wavedec(jnp.eye(FRAMES), "db2", 2)).T, np.eye(3)), trust_matrix(problem), None
    d, f = matrix(problem.positions), matrix(problem.guide.positions)
    weights = tuple(float(x) for x in (solver.outlier_weight, solver.smoothness_weight, solver.guide_weight))

    def cost(a, nuclear, absolute, squares):
        return (
            nuclear(a)
            + weights[0] * absolute(d - a)
            + weights[1] * absolute(w @ a)
            + weights[2] / 2 * squares(cp.multiply(b, a - f) if isinstance(a, cp.Variable) else b * (a - f))
        )

    a = cp.Variable(d.shape)
    expected = cp.Problem(cp.Minimize(cost(a, cp.normNuc, lambda x: cp.sum(cp.abs(x)), cp.sum_squares))).solve(
        solver=cp.CLARABEL
    )
    found = cost(
        matrix(solution.positions),
        lambda x: np.linalg.norm(x, "nuc"),
        lambda x: np.abs(x).sum(),
        lambda x: (x**2).sum(),
    )
    np.testing.assert_allclose(found, expected, rtol=TOLERANCE["objective"])
    np.testing.assert_allclose(solution.trace.objective[int(solution.steps) - 1], found, rtol=TOLERANCE["objective"])


def test_a_joint_that_no_frame_shows_goes_where_the_guide_says():
    body, truth = SKELETONS["cmu25"], clip(SKELETONS["cmu25"], 40, 2)
    data = truth.copy()
    data[:, 5] = np.nan
    lengths = lengths_of(body, truth)
    with pytest.raises(ValueError, match="never observed"):
        recover(data, body, preset="str_yang2020", bone_lengths=lengths)
    strict = replace(STR, guide_weight=1000.0)
    found = recover(data, body, preset=strict, bone_lengths=lengths, guide=truth)
    assert np.linalg.norm(found.positions - truth, axis=-1)[:, 5].mean() < 0.01
    assert not found.observed[:, 5].any()
    alone = np.zeros(truth.shape[:2])
    alone[:, 5] = 1
    errors = [
        np.linalg.norm(
            recover(
                data, body, preset=strict, bone_lengths=lengths, guide=truth + 0.1, guide_confidence=confidence
            ).positions
            - truth,
            axis=-1,
        ).mean()
        for confidence in (alone, None)
    ]
    assert errors[0] < 0.05 < errors[1]


class Shifted:
    """Stands in for a refiner: the truth, 5 cm off at first and nearer with every call."""

    def __init__(self, truth):
        self.truth, self.calls = truth, []

    def __call__(self, data, skeleton, *, fps, observed=None, keep_observed=None):
        self.calls.append((np.isnan(data).any(), keep_observed))
        return SimpleNamespace(positions=self.truth + 0.05 / len(self.calls) ** 4)


def test_a_refiner_as_guide_is_asked_again_in_each_round():
    body, truth = SKELETONS["star"], clip(SKELETONS["star"], 30, 3)
    data = truth.copy()
    data[:, 2] = np.nan
    errors = []
    for rounds in (1, 2):
        refiner = Shifted(truth)
        found = recover(
            data,
            body,
            preset="str_yang2020",
            bone_lengths=lengths_of(body, truth),
            fps=60,
            guide=refiner,
            guide_rounds=rounds,
        )
        assert refiner.calls == [(True, None), (False, False)][:rounds]
        errors.append(np.linalg.norm(found.positions - truth, axis=-1)[:, 2].mean())
    assert errors[1] < errors[0]
    with pytest.raises(ValueError, match="without fps"):
        recover(data, body, preset="str_yang2020", guide=Shifted(truth))
    with pytest.raises(ValueError, match="option of the published models"):
        recover(data, body, guide=truth)
    with pytest.raises(ValueError, match="guide of 29 frames"):
        recover(data, body, preset="str_yang2020", guide=truth[1:])
