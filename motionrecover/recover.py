"""The front door: a corrupted clip in, the recovered clip and everything known about it out."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import jax
import numpy as np

from motionrecover import intake, windows
from motionrecover.presets import Preset, find
from motionrecover.skeleton import Skeleton
from motionrecover.solver import Result, Trace, solve

TRUST = 0.01
"""Metres. A sample that was moved farther counts as changed, and less than fully trusted."""


class RecoveryError(RuntimeError):
    """The solver gave a verdict that leaves no usable answer."""


@dataclass(frozen=True, eq=False)
class Recovery:
    """Answer of `recover`. Arrays are NumPy, in the units of the input."""

    positions: np.ndarray
    """A as (frame, joint, 3)."""
    outliers: np.ndarray
    """E (frame, joint, 3): what the model takes for gross error in observed samples; 0 where nothing was observed."""
    weights: np.ndarray
    """(frame, joint) in [0, 1]: how far each sample was trusted. Confidence times the Huber weight of the distance it
    was moved, 1 up to 1 cm and 1 cm / distance beyond (Huber, "Robust Statistics", 1981, Sec. 7.3); 0 where missing."""
    observed: np.ndarray
    """(frame, joint): True where the input held a sample with some confidence."""
    bone_lengths: np.ndarray
    """(bone,): the lengths used, given or estimated."""
    skeleton: Skeleton
    fps: float | None
    result: Result
    """Verdict; `message` is its sentence."""
    steps: int
    trace: Trace
    """One row a step, over all windows."""
    seconds: dict[str, float]
    """`compile` and `run`, apart. `compile` is 0 when a program for these shapes was at hand."""

    def __repr__(self) -> str:
        frames, joints, _ = self.positions.shape
        return f"Recovery({frames} frames, {joints} joints, {self.steps} steps: {self.message})"

    @property
    def matrix(self) -> np.ndarray:
        """A as the papers' motion matrix (3 frames, joints)."""
        return intake.matrix_from(self.positions)

    @property
    def message(self) -> str:
        """The verdict in a sentence."""
        return Result[self.result]

    @property
    def converged(self) -> bool:
        """Whether both residuals fell below the tolerance."""
        return bool(self.result == Result.converged)


def recover(
    D: Any,
    skeleton: Skeleton,
    *,
    preset: str | Preset = "str_yang2020",
    observed: Any = None,
    confidence: Any = None,
    bone_lengths: Any = None,
    fps: float | None = None,
    max_steps: int | None = None,
    dtype: Any = None,
    throw: bool = True,
    verbose: bool = False,
) -> Recovery:
    """Recover the motion behind corrupted joint positions.

    `D`: (frame, joint, 3), or the motion matrix (3 frames, joints) of Yang et al. 2020, Eq. 1; NumPy or JAX, in
    metres; NaN marks missing samples. `preset`: a name in `presets.PRESETS` or a `Preset`. `observed` (frame, joint):
    False marks further missing samples. `confidence` (frame, joint) in [0, 1] scales the trust in each sample; 0 makes
    it missing. `bone_lengths` (bone,) in metres; left out, they are estimated from D, which is safe from 6 frames on
    and while less than half of each bone's frames are corrupted. `fps`: frames a second, kept in the answer; the three
    published models do not depend on it. `max_steps`: in place of the preset's. `dtype`: float32 (the default) or
    float64. `throw`: raise `RecoveryError` when the verdict is that there is no usable answer, instead of returning it
    with the verdict. `verbose`: print the trace.

    Raises `ValueError`, in one sentence, for input that cannot be used: see `intake.take_in`.
    """
    preset = find(preset)
    dtype = np.dtype("float32" if dtype is None else dtype)
    if dtype.name not in ("float32", "float64"):
        raise ValueError(f"received dtype {dtype}: give float32 or float64")
    if fps is not None and not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"received a frame rate of {fps}: give frames a second, above 0")
    steps = preset.max_steps if max_steps is None else max_steps
    if steps < 1:
        raise ValueError(f"received max_steps {max_steps}: give at least 1")
    printed = preset.initialisation == "printed"
    clip = intake.take_in(
        D,
        skeleton,
        observed,
        confidence,
        bone_lengths,
        needs_bones=preset.isometry_weight is not None,
        centre=not printed,
        fill_reach=preset.fill_reach,
        min_frames=preset.min_frames,
    )
    frames = len(clip.data)
    window = frames if printed or preset.window is None else preset.window
    spans = windows.split(frames, window, min(preset.overlap, window - 1))
    stored = bucket(min(frames, window))
    positions, outliers, solutions, seconds = [], [], [], {"compile": 0.0, "run": 0.0}
    for span in spans:
        solution, origin = _run(clip, span, stored, preset, dtype, steps, seconds)
        if throw and _useless(solution.result):
            raise RecoveryError(Result[solution.result])
        size = span.stop - span.start
        positions.append(clip.restore(solution.positions, size) + origin.astype(dtype))
        outliers.append(clip.restore(solution.outliers, size))
        solutions.append(solution)
    worst = max(solutions, key=lambda solution: (_useless(solution.result), not _converged(solution.result)))
    answer = windows.blend(positions, spans)
    if _useless(worst.result):
        answer = np.full_like(answer, np.nan)
    seen = clip.weights > 0
    # A joint merged with others has the group's E, plus what sets its own samples apart from the group's.
    apart = clip.data - clip.merged[:, clip.groups]
    moved = np.linalg.norm(np.nan_to_num(clip.data) - answer, axis=-1)
    recovery = Recovery(
        positions=answer,
        outliers=np.where(seen[..., None], windows.blend(outliers, spans) + apart, 0).astype(dtype),
        weights=np.where(seen, clip.weights * TRUST / np.maximum(moved, TRUST), 0),
        observed=seen,
        bone_lengths=clip.bone_lengths,
        skeleton=skeleton,
        fps=fps,
        result=worst.result,
        steps=max(int(solution.steps) for solution in solutions),
        trace=_merge([jax.tree.map(np.asarray, solution.trace) for solution in solutions]),
        seconds=seconds,
    )
    if verbose:
        _print_trace(recovery)
    return recovery


def bucket(frames: int) -> int:
    """Stored length for a clip: `frames` rounded up to one of eight sizes an octave (at most 1/8 more, from 8 on).

    Clips of one bucket share a compiled program. Padding does not change an answer: see `solver.Problem`.
    """
    step = max(1, 1 << max(0, (frames - 1).bit_length() - 4))
    return max(8, -(-frames // step) * step)


def _run(clip, span, stored, preset, dtype, max_steps, seconds):
    """The solution of one window and the origin of its coordinates; the time it took is added to `seconds`."""
    # float64 is allowed for float32 data too: see `prox.singular_value_threshold`.
    with jax.enable_x64(True):
        problem, origin = clip.problem(span, stored, dtype)
        arguments = (preset.solver(problem), problem)
        leaves, structure = jax.tree.flatten(arguments)
        misses, start = _compile.cache_info().misses, time.perf_counter()
        program = _compile(structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves), max_steps)
        compiled = time.perf_counter()
        solution = jax.block_until_ready(program(*arguments))
        seconds["run"] += time.perf_counter() - compiled
        if _compile.cache_info().misses > misses:
            seconds["compile"] += compiled - start
    return solution, origin


@lru_cache(maxsize=256)
def _compile(structure, shapes, max_steps):
    """The solver's program for arguments of this structure and these shapes."""
    arguments = jax.tree.unflatten(structure, [jax.ShapeDtypeStruct(*shape) for shape in shapes])
    return jax.jit(lambda solver, problem: solve(solver, problem, max_steps)).lower(*arguments).compile()


def _converged(result):
    return bool(result == Result.converged)


def _useless(result):
    return bool((result == Result.nothing_observed) | (result == Result.non_finite))


def _merge(traces):
    """One trace from those of the windows: objective parts add up, of the rest the largest counts.

    A window that ended before the others stays at its last row.
    """
    steps = [np.isfinite(trace.penalty).sum() for trace in traces]
    last = max(steps)

    def column(name):
        columns = np.stack([getattr(trace, name) for trace in traces])
        for values, count in zip(columns, steps, strict=True):
            values[count:last] = values[count - 1] if count else np.nan
        return columns.sum(0) if name in ("nuclear", "outlier", "isometry", "smoothness") else columns.max(0)

    return Trace(**{field.name: column(field.name) for field in fields(Trace)})


def _print_trace(recovery):
    """The trace at 1, 2, 5, 10, 20, 50, ... steps, the last one, and the verdict."""
    print(f"{'step':>5} {'objective':>11} {'primal':>9} {'dual':>9} {'rank':>4} {'penalty':>8}")
    trace, last = recovery.trace, recovery.steps
    for step in sorted({k * 10**p for k in (1, 2, 5) for p in range(6) if k * 10**p <= last} | {last} - {0}):
        row = step - 1
        print(
            f"{step:5d} {trace.objective[row]:11.5g} {trace.primal_residual[row]:9.2e} {trace.dual_residual[row]:9.2e} "
            f"{trace.rank[row]:4.0f} {trace.penalty[row]:8.3g}"
        )
    print(recovery.message)
