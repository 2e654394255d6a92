"""Compiled programs: one for clips of about one length, kept for the next clip."""

import time
from functools import lru_cache
from typing import Any

import jax

from motionrecover.solver import Problem, Solution, solve


def bucket(frames: int) -> int:
    """Stored length for a clip: `frames` rounded up to one of eight sizes an octave (at most 1/8 more, from 8 on).

    Clips of one bucket share a compiled program. Padding does not change an answer: see `solver.Problem`.
    """
    step = max(1, 1 << max(0, (frames - 1).bit_length() - 4))
    return max(8, -(-frames // step) * step)


def run(solver: Any, problem: Problem, max_steps: int, seconds: dict[str, float]) -> Solution:
    """The solution; the time of compiling and running is added to `seconds`. To be called under `jax.enable_x64`."""
    leaves, structure = jax.tree.flatten((solver, problem))
    misses, start = _compile.cache_info().misses, time.perf_counter()
    program = _compile(structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves), max_steps)
    compiled = time.perf_counter()
    solution = jax.block_until_ready(program(solver, problem))
    seconds["run"] += time.perf_counter() - compiled
    if _compile.cache_info().misses > misses:
        seconds["compile"] += compiled - start
    return solution


@lru_cache(maxsize=256)
def _compile(structure, shapes, max_steps):
    """The solver's program for arguments of this structure and these shapes."""
    arguments = jax.tree.unflatten(structure, [jax.ShapeDtypeStruct(*shape) for shape in shapes])
    return jax.jit(lambda solver, problem: solve(solver, problem, max_steps)).lower(*arguments).compile()
