"""The loop: counts, checks and records the steps of a solver."""

from typing import Any, Protocol

import jax
import jax.numpy as jnp
from jax import lax

from motionrecover.solver.problem import Problem
from motionrecover.solver.result import Result, Solution, Verdict


class Iteration(Protocol):
    """What the loop needs of a solver: `step.Solver` and `smoother.Smoother` have it."""

    trace: Any
    """Type of a step's information, and of the trace: one row a step."""

    def init(self, problem: Problem) -> Any:
        """The first state."""
        ...

    def step(self, problem: Problem, state: Any) -> tuple[Any, Any]:
        """The next state, and what the step tells."""
        ...

    def check(self, problem: Problem) -> Verdict:
        """Verdict on the input."""
        ...

    def terminate(self, info: Any) -> Verdict:
        """Verdict after a step."""
        ...

    def answer(self, problem: Problem, state: Any) -> tuple[Any, Any]:
        """Positions and outliers, (3, joint, frame)."""
        ...


def solve(solver: Iteration, problem: Problem, max_steps: int) -> Solution:
    """Steps until the solver says it is done, or `max_steps`.

    `vmap` over problems (and solvers) gives each clip its own verdict: a clip that is done, or broken, is frozen while
    the others go on.
    """
    # Traced once, here for the shapes of the rows and in the loop: tracing is a third of a warm start.
    step_of = jax.jit(lambda problem, state: solver.step(problem, state), inline=True)
    state = solver.init(problem)
    _, shapes = jax.eval_shape(step_of, problem, state)
    rows = jax.tree.map(lambda x: jnp.full((max_steps, *x.shape), jnp.nan, problem.positions.dtype), shapes)

    def more(carry):
        _, _, result, step = carry
        return (result == Result.running) & (step < max_steps)

    def advance(carry):
        state, rows, _, step = carry
        state, info = step_of(problem, state)
        rows = jax.tree.map(lambda row, x: row.at[step].set(x.astype(row.dtype)), rows, info)
        return state, rows, solver.terminate(info), step + 1

    carry = (state, rows, solver.check(problem), jnp.array(0))
    state, rows, result, steps = lax.while_loop(more, advance, carry)
    result = Result.where(result == Result.running, Result.max_steps, result)
    positions, outliers = solver.answer(problem, state)
    return Solution(positions, outliers, result, steps, solver.trace(**vars(rows)), state)
