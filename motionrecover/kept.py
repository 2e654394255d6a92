"""Compiled programs in a folder, for other processes.

JAX's persistent compilation cache keeps what XLA makes of a program, and finds it by the program: each process traces
and lowers it again first, which takes longer than to load what was kept. Here it is found by what the program is made
from: the package's own code, the function, the shapes of its arrays, the versions and the processor.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import warnings
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jaxlib.version
from jax.experimental import serialize_executable


def name(function: Callable, structure: Any, shapes: Hashable, static: Hashable, options: Hashable) -> str | None:
    """The name of a program's file; None for one that cannot be told by its text, such as with a function inside."""
    settings = [getattr(jax.config, setting) for setting in ("jax_enable_x64", "jax_default_matmul_precision")]
    text = repr((_surroundings(), function.__module__, function.__qualname__, shapes, static, options, settings))
    text += str(structure)
    return None if " at 0x" in text else f"{hashlib.sha256(text.encode()).hexdigest()}.program"


def save(file: Path, program: jax.stages.Compiled, returned: Any) -> None:
    """Keep a program from a list of leaves to another, and the structure of what that one is; a warning if it fails."""
    from motionrecover.io.atomic import write_beside

    try:
        binary, arguments, answers = serialize_executable.serialize(program)
        # Structures do not pickle, what has them does.
        answer = jax.tree.unflatten(returned, range(answers.num_leaves))
        stored = pickle.dumps((binary, arguments.num_leaves, answer))
        with write_beside(file, overwrite=True) as temporary:
            temporary.write_bytes(hashlib.sha256(stored).digest() + stored)
    except (OSError, ValueError, jax.errors.JaxRuntimeError) as error:
        warnings.warn(f"a compiled program is not kept in the cache: {error}", stacklevel=1)


def load(file: Path) -> tuple[Callable, Any] | None:
    """What was kept in a file; None where there is none, and, with a warning, where it is damaged."""
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        return None
    stored = content[32:]
    if hashlib.sha256(stored).digest() != content[:32]:
        warnings.warn(f"{file} in the cache is damaged: it is compiled anew", stacklevel=1)
        return None
    binary, count, answer = pickle.loads(stored)
    returned = jax.tree.structure(answer)
    arguments = jax.tree.structure((([0] * count,), {}))
    with ThreadPoolExecutor(1) as pool:
        lapack = pool.submit(_find_lapack)
        program = serialize_executable.deserialize_and_load(
            binary, arguments, jax.tree.structure([0] * returned.num_leaves), execution_devices=jax.devices()[:1]
        )
        lapack.result()
    return program, returned


@cache
def _find_lapack() -> None:
    """JAX finds LAPACK, in SciPy, when it first lowers what calls it; a binary that calls it before that crashes.

    Importing SciPy takes 0.1 s, and so does linking a binary, which does not need Python.
    """
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), "float32"))


@cache
def _surroundings() -> tuple[str, ...]:
    """Everything outside a program that its binary depends on."""
    code = hashlib.sha256()
    package = Path(__file__).parent
    for file in sorted(package.rglob("*.py")):
        code.update(f"{file.relative_to(package)}\0{file.stat().st_size}\0".encode() + file.read_bytes())
    device = jax.devices()[0]
    versions = jax.__version__, jaxlib.version.__version__, device.client.platform_version
    return code.hexdigest(), *versions, device.device_kind, _processor(), os.environ.get("XLA_FLAGS", "")


def _processor() -> str:
    """What this machine's processor can do: code for another one may not run."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    told = {line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))}
    return platform.machine() + "".join(sorted(told))
