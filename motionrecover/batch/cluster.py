"""The executor on many machines: the workers of a Dask scheduler (Rocklin, "Dask: Parallel computation with blocked
algorithms and task scheduling", Proc. 14th Python in Science Conf., 2015).

Each worker does one clip at a time and has the next one at hand: the driver, the scheduler and the network hold `AHEAD`
jobs a worker, however long the archive. The clip of a worker that dies goes to others; after how many it fails is for
the scheduler to say (`distributed.scheduler.allowed-failures`). It blames the clip that waited there too, so a clip
that failed thus is given once more. When the connection to the scheduler is lost, the jobs at hand are given to the
one that answers at the same address, as soon as it has workers.
"""

from __future__ import annotations

import logging
import os
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from motionrecover.batch.workers import ONE_THREAD, TRIES, A, J, Task, WorkerLost

if TYPE_CHECKING:
    from distributed import Client, Future

AHEAD = 2
"""Jobs a worker: the one that it does and the next."""
LOOK = 1.0
"""Seconds between two looks at which workers there are."""
_one_at_a_time = threading.Lock()


@dataclass(frozen=True)
class Dask:
    """The workers of the scheduler at an address, such as `tcp://host:8786`.

    Workers find the files of jobs under the paths that they have here, so these are absolute. Where workers offer a
    resource `GPU`, each job asks for one, and workers without it get none.

    Raises `ConnectionError` in one sentence where there is no scheduler or no worker for `patience` seconds,
    `ValueError` for what is no address, and `ImportError` without Dask here or motionrecover there.
    """

    address: str
    patience: float = 300.0

    def __call__(self, work: Callable[[J], A], jobs: Iterable[J]) -> Generator[tuple[J, A | Exception], None, None]:
        """See `Executor`. What workers are at when the generator is closed ends there by itself."""
        left, again, more = map(Task, jobs), deque[Task](), True
        environment = ONE_THREAD | {name: os.environ[name] for name in ("XLA_FLAGS",) if name in os.environ}
        with _quiet(), closing(_Connection(self, _Work(work, environment))) as connection:
            while True:
                try:
                    for _ in range(connection.room()):
                        task = again.popleft() if again else next(left, None)
                        if task is None:
                            more = False
                            break
                        connection.give(task)
                    if not more and not again and not connection.at_hand:
                        return
                    task, answer = connection.ended()
                except _Lost:
                    again.extend(connection.at_hand.values())
                    connection.open()
                    continue
                except Empty:
                    continue
                if isinstance(answer, WorkerLost):
                    task.tries += 1
                    if task.tries < TRIES:
                        again.append(task)
                        continue
                yield task.job, answer


class _Lost(Exception):
    """The scheduler does not answer any more."""


class _Connection:
    """A connection to a scheduler, and the jobs that it was given."""

    def __init__(self, asked: Dask, work: _Work):
        self._asked, self._work = asked, work
        self._client: Client | None = None
        self.open()

    def open(self) -> None:
        """Connect; jobs given before are forgotten."""
        from distributed import Client

        self.close()
        self.at_hand: dict[Future, Task] = {}
        self._ended: SimpleQueue[Future] = SimpleQueue()
        self._looked, self._count, self._needs = -LOOK, 0, None
        self._seen = time.monotonic()
        self._listens()
        try:
            self._client = Client(self._asked.address, timeout=self._asked.patience, set_as_default=False)
        except OSError as error:
            raise self._nothing("scheduler") from error

    def close(self) -> None:
        """Let go of the scheduler; what no worker has begun is not done."""
        if self._client is not None:
            with suppress(Exception):  # of a connection that is lost
                self._client.close(timeout=1)
            self._client = None

    def room(self) -> int:
        """How many more jobs the workers take. Raises `ConnectionError` when there was no worker for too long."""
        assert self._client is not None
        now = time.monotonic()
        if now - self._looked >= LOOK:
            if self._client.status != "running":
                raise _Lost
            workers = self._over(self._client.scheduler_info)["workers"].values()
            with_gpu = [worker for worker in workers if worker["resources"].get("GPU")]
            self._needs = {"GPU": 1} if with_gpu else None
            self._looked, self._count = now, len(with_gpu or workers)
            self._seen = now if workers else self._seen
        if now - self._seen > self._asked.patience:
            raise self._nothing("worker")
        return AHEAD * self._count - len(self.at_hand)

    def give(self, task: Task) -> None:
        """Have a job done."""
        assert self._client is not None
        key = f"motionrecover-{secrets.token_hex(16)}"
        future = self._client.submit(self._work, task.job, key=key, resources=self._needs)
        self.at_hand[future] = task
        future.add_done_callback(self._ended.put)

    def ended(self) -> tuple[Task, Any]:
        """A job with its answer, as soon as there is one. Raises `Empty` after `LOOK` seconds without."""
        future = self._ended.get(timeout=LOOK)
        if future.status == "cancelled":
            raise _Lost
        done = future.status == "finished"
        # An answer that was lost with its worker is waited for, in vain where there is none any more.
        answer = self._over(partial(future.result if done else future.exception, timeout=self._asked.patience))
        return self.at_hand.pop(future), answer if done else _told(answer)

    def _over(self, ask: Callable[[], Any]) -> Any:
        """What the scheduler answers. Raises `_Lost` where it does not."""
        try:
            return ask()
        except (CancelledError, OSError) as error:
            raise _Lost from error

    def _listens(self) -> None:
        """Wait until something listens at the address: Dask's client leaves threads behind where nothing does."""
        from distributed.comm.addressing import get_address_host_port

        try:
            place = get_address_host_port(self._asked.address)
        except ValueError as error:
            raise ValueError(
                f"received scheduler {self._asked.address!r}: give an address such as tcp://host:8786"
            ) from error
        while True:
            try:
                socket.create_connection(place, timeout=self._asked.patience).close()
                return
            except OSError as error:
                if time.monotonic() - self._seen > self._asked.patience:
                    raise self._nothing("scheduler") from error
                time.sleep(min(LOOK, self._asked.patience))

    def _nothing(self, what: str) -> ConnectionError:
        return ConnectionError(
            f"{self._asked.address} had no Dask {what} for {self._asked.patience:g} s: check the address, start one "
            f"(dask {what}), and run the same batch again"
        )


@dataclass(frozen=True)
class _Work:
    """What workers call: one job at a time, also where a worker has several threads."""

    work: Callable
    environment: dict[str, str]

    def __call__(self, job: Any) -> Any:
        with _one_at_a_time:
            for name, value in self.environment.items():
                os.environ.setdefault(name, value)  # in time for XLA, which reads them when it first compiles
            try:
                return self.work(job)
            except Exception as error:
                return error


def _told(error: BaseException) -> Exception:
    """Why a job has no answer. Raises `ImportError` where no other job would have one."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return WorkerLost("workers died over it, again and again (out of memory, perhaps)")
    if isinstance(cause := error.__cause__ or error, ImportError):
        raise ImportError(
            f"the Dask cluster cannot run this ({cause}): install the same motionrecover there"
        ) from error
    return error if isinstance(error, Exception) else RuntimeError(str(error))


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask's log off: what matters is told by answers and errors."""
    try:
        import distributed  # sets its log up
    except ImportError as error:
        raise ImportError("a scheduler needs Dask: pip install motionrecover[cluster]") from error
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] == distributed.__name__]
    loggers = [logger for logger in map(logging.getLogger, names) if not logger.disabled]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        for logger in loggers:
            logger.disabled = False
