"""The isometry term: derivatives against autodiff, the three ways to solve its Gauss-Newton system alike."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from helpers import GRAPHS, SKELETONS, TOLERANCE, TREES, clip, lengths_of

from motionrecover.isometry import pcg, tree
from motionrecover.isometry.objective import bone_vectors, jacobian_product, residual, transpose_product

solve_tree = jax.jit(tree.solve, static_argnums=4)
solve_pcg = jax.jit(pcg.solve, static_argnums=(4, 6))


def linear_system(skeleton, frames=4, seed=0):
    """Bone vectors d and a right-hand side b."""
    rng = np.random.default_rng(seed)
    n, b = rng.normal(size=(2, 3, len(skeleton.names), frames))
    return bone_vectors(jnp.asarray(n), skeleton.edges), jnp.asarray(b)


def dense(skeleton, d, b, weight, penalty):
    """(penalty I + weight J^T J)^-1 b from the assembled matrix."""
    size = b.size
    j = jax.jit(jax.jacfwd(lambda v: jacobian_product(d, v, skeleton.edges)))(b).reshape(-1, size)
    return np.linalg.solve(penalty * np.eye(size) + weight * np.asarray(j.T @ j), np.asarray(b).ravel()).reshape(
        b.shape
    )


@pytest.mark.parametrize("name", SKELETONS)
def test_jacobian_is_the_derivative_and_its_transpose_the_adjoint(name):
    edges, joints = SKELETONS[name].edges, len(SKELETONS[name].names)
    rng = np.random.default_rng(1)
    n, v = jnp.asarray(rng.normal(size=(2, 3, joints, 3)))
    lengths, r = jnp.asarray(rng.random(len(edges))), jnp.asarray(rng.normal(size=(len(edges), 3)))
    d = bone_vectors(n, edges)
    jacobian = jax.jacfwd(lambda n: residual(bone_vectors(n, edges), lengths))(n)
    product = jacobian_product(d, v, edges)
    np.testing.assert_allclose(product, jnp.einsum("htcsu,csu->ht", jacobian, v), atol=1e-12)
    transposed = transpose_product(d, r, edges, joints)
    np.testing.assert_allclose((product * r).sum(), (v * transposed).sum(), rtol=TOLERANCE["adjoint"])


@pytest.mark.parametrize("name", SKELETONS)
def test_tree_and_pcg_equal_the_dense_solution(name):
    skeleton = SKELETONS[name]
    d, b = linear_system(skeleton)
    for weight, penalty in [(100.0, 0.5), (1e3, 0.1), (1.0, 10.0), (0.0, 1.0)]:
        expected = dense(skeleton, d, b, weight, penalty)
        close = {"atol": TOLERANCE["linear solve"] * np.abs(expected).max(), "rtol": 0}
        iterated, steps = solve_pcg(d, b, weight, penalty, skeleton.edges, 1e-13, 1000)
        np.testing.assert_allclose(iterated, expected, **close)
        assert steps < 1000
        if name in TREES:
            np.testing.assert_allclose(solve_tree(d, b, weight, penalty, skeleton.edges), expected, **close)


def test_tree_solves_a_forest_and_single_joints():
    edges = ((0, 1), (3, 4), (4, 5))  # joint 2 alone
    d = bone_vectors(jnp.asarray(np.random.default_rng(0).normal(size=(3, 6, 2))), edges)
    b = jnp.asarray(np.random.default_rng(1).normal(size=(3, 6, 2)))
    found, _ = solve_pcg(d, b, 10.0, 0.5, edges, 1e-14, 1000)
    np.testing.assert_allclose(solve_tree(d, b, 10.0, 0.5, edges), found, atol=1e-9)


@pytest.mark.parametrize("name", GRAPHS)
def test_tree_refuses_a_cycle(name):
    d, b = linear_system(GRAPHS[name])
    with pytest.raises(ValueError, match="closes a cycle"):
        tree.solve(d, b, jnp.array(1.0), jnp.array(1.0), GRAPHS[name].edges)


def test_pcg_frames_do_not_see_each_other():
    """A frame far from converging, or not finite, leaves the others as they are alone."""
    skeleton = GRAPHS["braced"]
    d, b = linear_system(skeleton, frames=3)
    alone, _ = solve_pcg(d[..., :1], b[..., :1], 100.0, 0.1, skeleton.edges, 1e-10, 300)
    spoiled = b.at[..., 1].multiply(1e6).at[..., 2].set(jnp.nan)
    together, _ = solve_pcg(d, spoiled, 100.0, 0.1, skeleton.edges, 1e-10, 300)
    np.testing.assert_allclose(together[..., :1], alone, atol=1e-9)


def test_pcg_of_zero_is_zero():
    d, b = linear_system(GRAPHS["triangle"])
    found, steps = solve_pcg(d, 0 * b, 100.0, 0.1, GRAPHS["triangle"].edges, 1e-10, 300)
    assert steps == 0
    assert (found == 0).all()


def subproblem(skeleton, weight=100.0, penalty=5.0):
    """The N-subproblem as stacked residuals: sqrt(gamma) F(N) and sqrt(rho) (N - target)."""
    positions = clip(skeleton, 3)
    lengths = jnp.asarray(lengths_of(skeleton, positions))
    target = jnp.asarray(
        positions.transpose(2, 1, 0) + np.random.default_rng(0).normal(scale=0.02, size=(3, positions.shape[1], 3))
    )

    def stacked(n):
        f = residual(bone_vectors(n, skeleton.edges), lengths)
        return jnp.concatenate([jnp.sqrt(weight) * f.ravel(), jnp.sqrt(penalty) * (n - target).ravel()])

    def step(n):
        d = bone_vectors(n, skeleton.edges)
        f = residual(d, lengths)
        right = -penalty * (n - target) - weight * transpose_product(d, f, skeleton.edges, n.shape[1])
        if skeleton.is_forest:
            return n + solve_tree(d, right, weight, penalty, skeleton.edges)
        return n + solve_pcg(d, right, weight, penalty, skeleton.edges, 1e-13, 1000)[0]

    return stacked, jax.jit(step), target


@pytest.mark.parametrize("name", ["chain", "braced"])
def test_one_step_equals_jaxopt(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import jaxopt
    stacked, step, start = subproblem(SKELETONS[name])
    oracle = jaxopt.GaussNewton(lambda v: stacked(v.reshape(start.shape)), jit=False, implicit_diff=False)
    state = oracle.init_state(start.ravel())
    expected, _ = oracle.update(start.ravel(), state)
    np.testing.assert_allclose(step(start).ravel(), expected, atol=TOLERANCE["one step"])


@pytest.mark.parametrize("name", ["chain", "star", "braced"])
def test_steps_end_at_the_minimiser_of_optimistix(name):
    stacked, step, start = subproblem(SKELETONS[name])
    oracle = optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12)
    expected = optx.least_squares(lambda n, _: stacked(n), oracle, start, max_steps=500).value
    found = start
    for _ in range(60):
        found = step(found)
    np.testing.assert_allclose(found, expected, atol=TOLERANCE["minimiser"])
