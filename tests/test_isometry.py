"""The isometry term: derivatives against autodiff, the three ways to solve its Gauss-Newton system alike."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from helpers import GRAPHS, SKELETONS, TOLERANCE, TREES, clip, lengths_of

from motionrecover import Skeleton
from motionrecover.isometry import pcg, tree
from motionrecover.isometry.objective import bone_vectors, jacobian_product, residual, transpose_product

solve_tree = jax.jit(tree.solve, static_argnums=5)
solve_pcg = jax.jit(pcg.solve, static_argnums=(5, 7))


def linear_step(skeleton, frames=4, seed=0):
    """Bone vectors d, residuals f and a target s."""
    rng = np.random.default_rng(seed)
    n, s = rng.normal(size=(2, len(skeleton.names), 3, frames))
    return bone_vectors(jnp.asarray(n), skeleton.edges), jnp.asarray(rng.normal(size=(len(skeleton.edges), frames))), s


def dense(skeleton, d, f, s, weight, penalty):
    """argmin weight/2 |f + J delta|^2 + penalty/2 |delta - s|^2 from the assembled matrix."""
    j = jax.jit(jax.jacfwd(lambda v: jacobian_product(d, v, skeleton.edges)))(jnp.asarray(s)).reshape(f.size, s.size)
    system = penalty * np.eye(s.size) + weight * np.asarray(j.T @ j)
    return np.linalg.solve(system, penalty * s.ravel() - weight * np.asarray(j).T @ np.ravel(f)).reshape(s.shape)


@pytest.mark.parametrize("name", SKELETONS)
def test_jacobian_is_the_derivative_and_its_transpose_the_adjoint(name):
    edges, joints = SKELETONS[name].edges, len(SKELETONS[name].names)
    rng = np.random.default_rng(1)
    n, v = jnp.asarray(rng.normal(size=(2, joints, 3, 4)))
    lengths, r = jnp.asarray(rng.random(len(edges))), jnp.asarray(rng.normal(size=(len(edges), 4)))
    d = bone_vectors(n, edges)
    jacobian = jax.jacfwd(lambda n: residual(bone_vectors(n, edges), lengths))(n)
    product = jacobian_product(d, v, edges)
    np.testing.assert_allclose(product, jnp.einsum("htscu,scu->ht", jacobian, v), atol=1e-12)
    transposed = transpose_product(d, r, edges, joints)
    np.testing.assert_allclose((product * r).sum(), (v * transposed).sum(), rtol=TOLERANCE["adjoint"])


@pytest.mark.parametrize("name", SKELETONS)
def test_tree_and_pcg_equal_the_dense_solution(name):
    skeleton = SKELETONS[name]
    d, f, s = linear_step(skeleton)
    for weight, penalty in [(100.0, 0.5), (1e3, 0.1), (1.0, 10.0), (0.0, 1.0)]:
        expected = dense(skeleton, d, f, s, weight, penalty)
        close = {"atol": TOLERANCE["linear solve"] * np.abs(expected).max(), "rtol": 0}
        iterated, steps = solve_pcg(d, f, s, weight, penalty, skeleton.edges, 1e-13, 1000)
        np.testing.assert_allclose(iterated, expected, **close)
        assert steps < 1000
        if name in TREES:
            np.testing.assert_allclose(s - solve_tree(d, f, s, weight, penalty, skeleton.edges), expected, **close)


def test_tree_solves_a_forest_and_single_joints():
    forest = Skeleton("abcdef", [(0, 1), (3, 4), (4, 5)])  # joint 2 alone
    d, f, s = linear_step(forest)
    found = s - solve_tree(d, f, s, 10.0, 0.5, forest.edges)
    np.testing.assert_allclose(found, dense(forest, d, f, s, 10.0, 0.5), atol=1e-9)


def test_tree_is_accurate_in_float32_where_bones_are_stiff():
    """At gamma |d|^2 / rho = 1e5 the matrix of Eq. 20 has lost all digits of the weak directions; this form has not."""
    skeleton = SKELETONS["cmu25"]
    d, f, s = linear_step(skeleton)
    expected = dense(skeleton, d, f, s, 1e3, 0.01)
    single = [jnp.asarray(x, jnp.float32) for x in (d, f, s)]
    found = single[2] - solve_tree(*single, jnp.float32(1e3), jnp.float32(0.01), skeleton.edges)
    np.testing.assert_allclose(found, expected, atol=TOLERANCE["stiff float32"] * np.abs(expected).max(), rtol=0)


def test_a_hub_of_many_bones_is_left_to_pcg():
    hub = Skeleton([str(k) for k in range(20)], [(0, k) for k in range(1, 20)])
    assert not tree.suits(hub.edges, 20)
    assert tree.suits(SKELETONS["cmu25"].edges, 25)


@pytest.mark.parametrize("name", GRAPHS)
def test_tree_refuses_a_cycle(name):
    d, f, s = linear_step(GRAPHS[name])
    assert not tree.suits(GRAPHS[name].edges, len(s))
    with pytest.raises(ValueError, match="closes a cycle"):
        tree.solve(d, f, s, jnp.array(1.0), jnp.array(1.0), GRAPHS[name].edges)


def test_pcg_frames_do_not_see_each_other():
    """A frame far from converging, or not finite, leaves the others as they are alone."""
    skeleton = SKELETONS["braced"]
    d, f, s = linear_step(skeleton, frames=3)
    alone, _ = solve_pcg(d[..., :1], f[..., :1], s[..., :1], 100.0, 0.1, skeleton.edges, 1e-10, 300)
    spoiled = jnp.asarray(s).at[..., 1].multiply(1e6).at[..., 2].set(jnp.nan)
    together, _ = solve_pcg(d, f, spoiled, 100.0, 0.1, skeleton.edges, 1e-10, 300)
    np.testing.assert_allclose(together[..., :1], alone, atol=1e-9)


def test_pcg_of_zero_is_zero():
    d, f, s = linear_step(GRAPHS["triangle"])
    found, steps = solve_pcg(d, 0 * f, 0 * s, 100.0, 0.1, GRAPHS["triangle"].edges, 1e-10, 300)
    assert steps == 0
    assert (found == 0).all()


def subproblem(skeleton, weight=100.0, penalty=5.0):
    """The N-subproblem as stacked residuals: sqrt(gamma) F(N) and sqrt(rho) (N - target)."""
    positions = clip(skeleton, 3)
    lengths = jnp.asarray(lengths_of(skeleton, positions))
    noise = np.random.default_rng(0).normal(scale=0.02, size=(3, positions.shape[1], 3))
    target = jnp.asarray(positions.transpose(1, 2, 0) + noise.swapaxes(0, 1))

    def stacked(n):
        f = residual(bone_vectors(n, skeleton.edges), lengths)
        return jnp.concatenate([jnp.sqrt(weight) * f.ravel(), jnp.sqrt(penalty) * (n - target).ravel()])

    def step(n):
        d = bone_vectors(n, skeleton.edges)
        f = residual(d, lengths)
        if skeleton.is_forest:
            return target - solve_tree(d, f, target - n, weight, penalty, skeleton.edges)
        return n + solve_pcg(d, f, target - n, weight, penalty, skeleton.edges, 1e-13, 1000)[0]

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
