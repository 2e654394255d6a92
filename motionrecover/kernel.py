"""Parts of a program that a CPU runs as one kernel.

XLA runs a program on a CPU as a sequence of small kernels: each reads and writes memory, none knows of the next, and
between them lie some tenths of a microsecond. In an iteration over a short clip, or a recursion along frames, that is
most of the time. A small loop it compiles into one native function instead, by a call with an attribute; the same
attribute on a call of ours makes one kernel of what we choose. 40 iterations of `str_yang2020` on 272 frames then take
0.7 of the time, the smoother's recursion joint by joint a seventh.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
from jax.custom_batching import custom_vmap

Function = TypeVar("Function", bound=Callable)


def available() -> bool:
    """Whether programs can be told so: the attribute is XLA's own affair, and known to work with this JAX only."""
    return jax.default_backend() == "cpu" and jax.__version_info__[:2] == (0, 10)


def one_kernel(function: Function) -> Function:
    """`function` of arrays and trees of them, as one kernel where that is `available`.

    It may hold loops and whatever goes entry by entry, but close over nothing traced. Products of matrices, sums along
    an axis and LAPACK are calls of libraries, and refused when compiled. Inside another kernel, answers are computed
    once, and not anew for every reader. Under `vmap` it is the function as it stands: where a clip has its own length,
    filling its edge is a scatter, which is refused as well.
    """
    if not available():
        return function
    from jax.experimental.xla_metadata import set_xla_metadata  # experimental: another JAX may not have it

    def inside(*arguments):
        with set_xla_metadata(xla_cpu_small_call=None, inlineable=None):
            # XLA aborts the process over an argument that plays no part in the answers.
            return function(*arguments), arguments

    @custom_vmap
    def call(*arguments):
        with set_xla_metadata(xla_cpu_small_call="true", inlineable="false"):
            return jax.jit(inside)(*arguments)[0]

    @call.def_vmap
    def _(size, batched, *arguments):
        axes = jax.tree.map(lambda mapped: 0 if mapped else None, tuple(batched))
        answer = jax.vmap(function, axes, axis_size=size)(*arguments)
        return answer, jax.tree.map(lambda _: True, answer)

    return call  # pyright: ignore[reportReturnType]
