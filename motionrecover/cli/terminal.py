"""What the commands say: notes and progress on stderr, tables or one JSON object on stdout."""

from __future__ import annotations

import json
import logging
import math
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, redirect_stdout
from typing import Any, TypeVar

_T = TypeVar("_T")


@contextmanager
def notes() -> Iterator[None]:
    """Print each warning once, and what the package logs if asked by `show_log`, as lines `note: ...` on stderr."""
    log = logging.getLogger("motionrecover")
    handlers, level = log.handlers, log.level
    with warnings.catch_warnings():
        _show_warnings()
        try:
            yield
        finally:
            log.handlers = handlers
            log.setLevel(level)


def _show_warnings() -> None:
    said = set()

    def show(message, category, filename, lineno, file=None, line=None):
        if str(message) not in said:
            said.add(str(message))
            print("note:", " ".join(str(message).split()), file=sys.stderr)

    warnings.simplefilter("always")
    warnings.simplefilter("ignore", DeprecationWarning)
    warnings.showwarning = show


def hush(quiet: bool) -> None:
    """Print no warnings if `quiet`."""
    if quiet:
        warnings.simplefilter("ignore")


class _Notes(logging.Handler):
    """Prints what the package logs as lines `note: ...` on the stderr of the moment."""

    def emit(self, record: logging.LogRecord) -> None:
        print("note:", record.getMessage(), file=sys.stderr)


def show_log(quiet: bool) -> None:
    """Print what the package logs, such as what it compiles, unless `quiet`."""
    log = logging.getLogger("motionrecover")
    log.handlers = [] if quiet else [_Notes()]
    log.setLevel(logging.INFO)


def work(task: str, hidden: bool, call: Callable[..., _T]) -> _T:
    """What `call(progress=...)` returns; meanwhile a bar of its windows, with the time that is left, if stderr is a
    terminal and unless `hidden`.

    What the call prints goes to stderr. It runs in a thread, since compiled code would not let Ctrl-C through.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True, highlight=False, markup=False, emoji=False)
    columns = (
        *(TextColumn("{task.description}", markup=False), BarColumn(10), TextColumn("{task.fields[place]}")),
        *(TextColumn("after"), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()),
    )
    shown = not hidden and console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not shown, speed_estimate_period=math.inf) as bar:
        row = bar.add_task(task, total=None, place="")

        def progress(done: int, total: int) -> None:
            # Putting the windows together takes about as long as one of them.
            place = f"window {done + 1} of {total}" if done < total else "finishing"
            bar.update(row, completed=done, total=total + 1, place=place)

        with redirect_stdout(sys.stderr):
            pool = ThreadPoolExecutor(1)
            future = pool.submit(call, progress=progress)
            pool.shutdown(wait=False)
            return future.result()


@contextmanager
def progress(task: str, total: int, quiet: bool) -> Iterator[Callable[[int], None]]:
    """A function to say how many of `total` are done; it draws a bar with the time left, if stderr is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True, highlight=False, markup=False, emoji=False)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=quiet or not console.is_terminal) as bar:
        line = bar.add_task(task, total=total)
        yield lambda done: bar.update(line, completed=done)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows under a head, names to the left and numbers to the right; an empty head is left out."""
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, markup=False, emoji=False)
    grid = Table(box=None, pad_edge=False, show_header=any(head), padding=(0, 3, 0, 0))
    for column, title in enumerate(head):
        grid.add_column(title, justify="right" if column and any(head) else "left", overflow="fold")
    for row in rows:
        grid.add_row(*row)
    console.print(grid)


def print_json(facts: dict[str, Any]) -> None:
    """Print one JSON object; numbers that are not finite become null."""
    print(json.dumps(_finite(facts), indent=2, ensure_ascii=False, allow_nan=False))


def mm(millimetres: float) -> str:
    """A length for people."""
    return f"{millimetres:.1f} mm" if math.isfinite(millimetres) else "-"


def percent(share: float) -> str:
    """A share for people, which is zero or whole only when it is so exactly."""
    if not math.isfinite(share):
        return "-"
    if 0 < share < 0.0005:
        return "< 0.1 %"
    return "> 99.9 %" if 0.9995 < share < 1 else f"{100 * share:.1f} %"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
