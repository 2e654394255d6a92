"""Compiled programs: one for clips of about one length, kept for the next clip and, if asked, for the next process."""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

from motionrecover import kept

_log = logging.getLogger("motionrecover")
_finding, _counting, _switching = threading.Lock(), threading.Lock(), threading.Lock()
_folder: Path | None = None
_CACHE, _past, _before = "jax_enable_compilation_cache", 0, True

OPTIONS: dict[str, bool | int] = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_multi_thread_eigen": False,
    "xla_cpu_prefer_vector_width": 512,
}
"""Of XLA on a CPU. Without fusion emitters the smoother compiles in half the time and runs as fast. One thread a
program: programs that share threads wait for each other, for ever where two of them run on two processors. With the
widest vectors that a processor has, not 256 bits, `str_yang2020` takes 0.94 of the time."""
SLOW = 1.0
"""Seconds after which compiling is worth a line in the log."""


def bucket(frames: int, window: int | None = None) -> int:
    """Stored length for `frames` of a clip that is recovered in windows of at most `window` frames.

    The least of the window, its half, its quarter, ... that holds them: clips of whatever lengths share two or three
    programs. Without a window, `frames` rounded up to one of eight sizes an octave (at most 1/8 more, from 8 on).
    Padding does not change an answer: see `solver.Problem`.
    """
    if window is None:
        step = max(1, 1 << max(0, (frames - 1).bit_length() - 4))
        return max(8, -(-frames // step) * step)
    while window // 2 >= max(frames, 8):
        window //= 2
    return window


def keep_in(folder: Path) -> None:
    """Keep programs in this folder too, for other processes: those of `run` (see `kept`), and all others, such as a
    network's, in JAX's persistent compilation cache.

    Where the user has that one already, it serves for all. A damaged file is made anew, with a warning.
    """
    global _folder
    if jax.config.jax_compilation_cache_dir:  # pyright: ignore[reportAttributeAccessIssue]
        return
    folder.mkdir(parents=True, exist_ok=True)
    _folder = folder
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def user_folder() -> Path:
    """Where the user's programs are kept: `motionrecover` in the user's cache folder."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "motionrecover"


@dataclass
class _Place:
    """Of a program that is there or will be: the program, from a list of leaves to another, and their structure."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    """Held while the program is made: others wait for this one, and not for all."""
    made: tuple[Callable, Any] | None = None


@lru_cache(maxsize=256)
def _place(function, structure, shapes, static) -> _Place:
    return _Place()


def made() -> int:
    """Programs that this process has compiled, or taken from where they are kept."""
    return _place.cache_info().misses


def run(
    function: Callable,
    arrays: dict[str, Any],
    static: dict[str, Any],
    seconds: dict[str, float],
    meanwhile: Callable[[], None] | None = None,
) -> Any:
    """`function` of named arrays (any pytrees) and of static values, compiled for their shapes; the answer in NumPy.

    The time of making the program, if no other thread does, and of running it is added to `seconds`. To be called under
    `jax.enable_x64`. `meanwhile` is called where the program has to be compiled, when that begins: it may `prepare`
    others.

    Raises `MemoryError` for a program that needs more memory than the device has.
    """
    leaves, key = _key(function, arrays, static)
    start = time.perf_counter()
    (program, returned), made_now = _program(key, meanwhile)
    ready = time.perf_counter()
    found = jax.device_get(program(leaves))
    with _counting:
        seconds["compile"] += (ready - start) * made_now
        seconds["run"] += time.perf_counter() - ready
    return jax.tree.unflatten(returned, found)


def prepare(function: Callable, shapes: dict[str, Any], static: dict[str, Any]) -> None:
    """Begin to compile, in a thread, what `run` will be asked for: `shapes` has `jax.ShapeDtypeStruct`s for arrays.

    Programs compile side by side on several processors. What goes wrong here, goes wrong in `run` again.
    """
    _, key = _key(function, shapes, static)
    wide = jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]

    def make() -> None:
        with suppress(Exception), jax.enable_x64(wide):
            _program(key)

    threading.Thread(target=make).start()


def _key(function, arrays, static):
    """The arrays' leaves, and what the program for them is found by."""
    leaves, structure = jax.tree.flatten(arrays)
    leaves = [leaf if isinstance(leaf, (jax.Array, jax.ShapeDtypeStruct)) else np.asarray(leaf) for leaf in leaves]
    return leaves, (function, structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves), tuple(static.items()))


def _program(key, meanwhile=None):
    """The program and the structure of its answer; and whether it was made here and now."""
    with _finding:  # two threads that miss at once would get a place each
        place = _place(*key)
    with place.lock:
        made_now = place.made is None
        place.made = place.made or _compile(*key, meanwhile=meanwhile)
        return place.made, made_now


def _compile(function, structure, shapes, static, meanwhile):
    """The program from a list of leaves of this structure and these shapes to another, and the structure of that."""
    file = _file(function, structure, shapes, static)
    if file and (found := kept.load(file)):
        return found
    sizes = sorted({"x".join(map(str, shape)) for shape, _ in shapes if len(shape) > 1})
    line = f"compiling {function.__name__} for arrays of {', '.join(sizes)}: once for clips of about this length"
    timer = threading.Timer(SLOW, _log.info, [line])
    timer.start()
    returned = []

    def flat(leaves):
        answer, shape = jax.tree.flatten(function(**jax.tree.unflatten(structure, leaves), **dict(static)))
        returned.append(shape)
        return answer

    try:
        lowered = jax.jit(flat).lower([jax.ShapeDtypeStruct(*shape) for shape in shapes])
        if meanwhile:
            meanwhile()
        with _past_the_cache() if file else nullcontext():
            program = _compiled(lowered)
    finally:
        timer.cancel()
    needed, there = _needed(program), _memory()
    if needed > there:
        raise MemoryError(
            f"received arrays of {', '.join(sizes)}, for which {function.__name__} needs {needed / 1e9:.3g} GB of "
            f"memory, and there are {there / 1e9:.3g} GB: recover the clip in windows or in parts"
        )
    if file:
        kept.save(file, program, returned[0])
    return program, returned[0]


@contextmanager
def _past_the_cache() -> Generator[None]:
    """Nothing is written to JAX's cache or read from it: what comes out of it cannot be kept again, as it has lost its
    functions (jax 0.10), and calling it in another process fails.

    JAX knows one switch for all threads: the first of several that compile turns it off, the last turns it back.
    """
    global _past, _before
    with _switching:
        if _past == 0:
            _before = getattr(jax.config, _CACHE)
            _switch(False)
        _past += 1
    try:
        yield
    finally:
        with _switching:
            _past -= 1
            if _past == 0:
                _switch(_before)


def _switch(on: bool) -> None:
    jax.config.update(_CACHE, on)
    compilation_cache.reset_cache()  # or JAX does not look at the switch again


def _file(function, structure, shapes, static) -> Path | None:
    """Where the program is kept, if it is."""
    if _folder is None:
        return None
    name = kept.name(function, structure, shapes, static, tuple(OPTIONS.items()))
    return _folder / name if name else None


def _needed(program) -> int:
    """Bytes that a program uses while it runs."""
    use = program.memory_analysis()
    return use.temp_size_in_bytes + use.argument_size_in_bytes + use.output_size_in_bytes


def _memory() -> int:
    """Bytes of the device's memory."""
    device = jax.devices()[0]
    if device.platform == "cpu":
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else sys.maxsize
    return (device.memory_stats() or {}).get("bytes_limit", sys.maxsize)


def _compiled(lowered):
    """The lowered program, compiled with `OPTIONS` where they are known."""
    if jax.default_backend() == "cpu":
        try:
            return lowered.compile(compiler_options=OPTIONS)
        except jax.errors.JaxRuntimeError as error:
            if "No such compile option" not in str(error):
                raise
    return lowered.compile()
