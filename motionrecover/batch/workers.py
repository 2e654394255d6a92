"""The executor, which calls a function for every job somewhere, and the local one: processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol, TypeVar

J = TypeVar("J")
A = TypeVar("A")

TRIES = 2
"""Processes that may die over one job."""
ONE_THREAD: dict[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NPROC"), "1")
"""Environment of a worker, read when its libraries are loaded: `NPROC` by XLA, the others by BLAS. N processes with
threads for N processors each would wait for one another."""


class Executor(Protocol):
    """Where the work is done: pass another one to `batch.run` to do it elsewhere."""

    def __call__(self, work: Callable[[J], A], jobs: Iterable[J]) -> Generator[tuple[J, A | Exception], None, None]:
        """Each job with what `work` returned for it, or the exception it ended with, in any order, as soon as it is
        there. `work`, jobs and answers can be pickled. Jobs are taken from the iterable as there is room for them.
        When the generator is closed, no job is begun any more; one that cannot be ended finds its batch gone (`Claim`)
        before it writes."""
        ...


class WorkerLost(RuntimeError):
    """The process that did a job died, again and again."""


@dataclass(frozen=True)
class Processes:
    """As many processes on this machine, started when there is a job for them, each with a job at a time.

    A job whose process dies is given to a new process, and after `TRIES` it has failed. The processes end with the
    one that started them, however that ends. A program that is no package needs `if __name__ == "__main__"`.
    """

    workers: int

    def __post_init__(self):
        if self.workers < 1:
            raise ValueError(f"received {self.workers} workers: give at least 1")

    def __call__(self, work: Callable[[J], A], jobs: Iterable[J]) -> Generator[tuple[J, A | Exception], None, None]:
        """See `Executor`."""
        left, again = map(Task, jobs), deque[Task]()
        idle: list[_Worker] = []
        busy: dict[Connection, tuple[_Worker, Task]] = {}
        try:
            while True:
                while len(busy) < self.workers:
                    task = again.popleft() if again else next(left, None)
                    if task is None:
                        break
                    worker = idle.pop() if idle else _Worker(work)
                    busy[worker.connection] = worker, task
                    worker.give(task.job)
                if not busy:
                    return
                for connection in wait(list(busy)):
                    worker, task = busy.pop(connection)  # pyright: ignore[reportArgumentType]
                    try:
                        answer = worker.connection.recv()
                    except (EOFError, OSError):
                        answer = worker.lost()
                        task.tries += 1
                        if task.tries < TRIES:
                            again.append(task)
                            continue
                    except Exception as error:  # an answer that cannot be unpickled
                        answer = error
                        idle.append(worker)
                    else:
                        idle.append(worker)
                    yield task.job, answer
        finally:
            for worker, _ in busy.values():
                worker.process.kill()
            for worker in (*idle, *(worker for worker, _ in busy.values())):
                worker.end()


@dataclass
class Task:
    """A job, and how often it was lost with its worker."""

    job: Any
    tries: int = 0


class _Worker:
    """A process that waits for jobs at the other end of a connection."""

    def __init__(self, work: Callable):
        context = multiprocessing.get_context("spawn")
        self.connection, far = context.Pipe()
        self.process = context.Process(target=_serve, args=(far, work), daemon=True)
        with _environment(ONE_THREAD):
            self.process.start()
        far.close()

    def give(self, job: Any) -> None:
        # Of a process that is dead already, the end of its connection tells.
        with suppress(OSError):
            self.connection.send(job)

    def lost(self) -> WorkerLost:
        self.end()
        code = self.process.exitcode or 0
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        why = " (out of memory, perhaps: try fewer workers)" if how.endswith("SIGKILL") else ""
        return WorkerLost(f"{TRIES} processes died over it, the last one {how}{why}")

    def end(self) -> None:
        self.connection.close()
        self.process.join()


def _serve(connection: Connection, work: Callable) -> None:
    """The life of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that started this one
    os.dup2(2, 1)  # stdout is for its words alone
    sys.stdout = sys.stderr
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            job = connection.recv()
            try:
                answer = work(job)
            except Exception as error:
                answer = error
            connection.send(answer)


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


@contextmanager
def _environment(names: dict[str, str]) -> Iterator[None]:
    """The environment that processes started meanwhile have."""
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(names)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
