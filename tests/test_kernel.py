"""One kernel of several operations: the same answers, and in fact one kernel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import SKELETONS, TOLERANCE, clip, hit, lengths_of, problem_of
from jax import lax

from motionrecover import kernel
from motionrecover.presets import PUBLISHED
from motionrecover.solver import solve


def walk(x, step):
    """A recursion along rows, something beside it, and an argument that is left unused."""
    _, found = lax.scan(lambda at, row: (at + step["size"] * row, at * row), x[0], x)
    return {"found": found, "double": 2 * x}


def arguments(*batch):
    rng = np.random.default_rng(0)
    return jnp.asarray(rng.normal(size=(*batch, 5, 7))), {"size": jnp.float64(0.5), "unused": jnp.float64(3)}


def test_this_jax_makes_one_kernel_of_it():
    assert kernel.available()
    text = jax.jit(kernel.one_kernel(walk)).lower(*arguments()).compile().as_text()
    entry = text[text.index("ENTRY") :]
    assert entry.count(" call(") == 1
    assert " while(" not in entry


def test_equals_the_function():
    found, expected = jax.jit(kernel.one_kernel(walk))(*arguments()), walk(*arguments())
    for name in expected:
        np.testing.assert_allclose(found[name], expected[name], rtol=TOLERANCE["adjoint"])


def test_under_vmap_equals_the_function():
    x, step = arguments(3)
    found = jax.jit(jax.vmap(kernel.one_kernel(walk), (0, None)))(x, step)
    for row, *answer in zip(x, found["found"], found["double"], strict=True):
        expected = walk(row, step)
        np.testing.assert_allclose(answer, [expected["found"], expected["double"]], rtol=TOLERANCE["adjoint"])


@pytest.mark.parametrize("name", ["bone", "cmu25", "braced"])
def test_the_solver_finds_the_same_without_it(name, monkeypatch):
    skeleton = SKELETONS[name]
    truth = clip(skeleton, 9, 0)
    problem = problem_of(skeleton, hit(truth, 0.2, 0), lengths_of(skeleton, truth), stored=12)
    solver = PUBLISHED["str_yang2020"].solver(problem)
    found = jax.jit(solve, static_argnums=2)(solver, problem, 5)
    monkeypatch.setattr(kernel, "available", lambda: False)
    expected = jax.jit(lambda *x: solve(*x, 5))(solver, problem)
    np.testing.assert_allclose(found.positions, expected.positions, atol=TOLERANCE["reference"])
