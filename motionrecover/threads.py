"""Threads: one for BLAS, whose work is many small matrices, and one a processor for windows and clips.

OpenBLAS splits a product of a few thousand numbers, and its threads then wait for one another: with two of them a clip
of 300 frames took `robust` 1.3 s, with one 0.5 s. Sums come out in the same order on one processor and on many, too: an
answer is the same bit for bit in a process with many threads and in a worker with one.

Compiled programs have one thread each and let others run, so windows of a clip, or clips, go side by side.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")
A = TypeVar("A")

BLAS_THREADS = "OPENBLAS_NUM_THREADS"
"""The environment's word on it, which a library takes when it is loaded. Where it says 1, none needs to be loaded to be
told: SciPy takes 0.1 s."""
AHEAD = 2
"""Items a worker that are taken before the next answer is: a long one does not stop the workers behind it."""


@contextmanager
def one_blas_thread() -> Generator[None]:
    """Of all BLAS libraries in this process, one thread each.

    BLAS knows one number of threads for a process. Of several threads of a program that ask for this at a time, the
    first decides when it ends: where they begin and end on their own, one that holds it around them all keeps it up.
    """
    from threadpoolctl import threadpool_limits

    if os.environ.get(BLAS_THREADS) != "1":
        import scipy.linalg.cython_blas  # noqa: F401  SciPy brings a BLAS of its own, which XLA uses too

    with threadpool_limits(1, user_api="blas"):
        yield


def processors() -> int:
    """Number of those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_order(function: Callable[[T], A], items: Iterable[T], workers: int) -> Generator[A]:
    """`function` of each item, in order, each as soon as it and those before it are done, by so many threads.

    With one, it is called here. Items are taken as they are needed and may be endless. When the generator is closed,
    what has begun ends, and nothing more begins.
    """
    if workers == 1:
        yield from map(function, items)
        return
    pool, waiting = ThreadPoolExecutor(workers), deque[Future[A]]()
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            while waiting and (waiting[0].done() or len(waiting) >= AHEAD * workers):
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
