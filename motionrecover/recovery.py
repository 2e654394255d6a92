"""The front door: a corrupted clip in, the recovered clip and everything known about it out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import jax
import numpy as np

from motionrecover import finishing, intake, poses, robust, windows
from motionrecover.evidence.bone_lengths import mirrored_bones
from motionrecover.evidence.swaps import Swap, find_swaps, undo
from motionrecover.motion import Motion
from motionrecover.presets import Preset, Robust, find
from motionrecover.programs import bucket, run
from motionrecover.robust import Change
from motionrecover.runs import run_lengths
from motionrecover.skeleton import Skeleton
from motionrecover.solver import Result, Solution, solve
from motionrecover.solver.smoother import INTACT
from motionrecover.threads import one_blas_thread

TRUST = 0.01
"""Metres. A published model's sample that was moved farther counts as repaired, and less than fully trusted."""


class RecoveryError(RuntimeError):
    """The solver gave a verdict that leaves no usable answer."""


@dataclass(frozen=True, eq=False)
class Recovery:
    """Answer of `recover`. Arrays are NumPy, in the units of the input."""

    positions: np.ndarray
    """(frame, joint, 3): the motion; NaN where it stays unknown."""
    outliers: np.ndarray
    """E (frame, joint, 3): what sets observed samples apart from the motion as gross error; 0 elsewhere."""
    weights: np.ndarray
    """(frame, joint) in [0, 1]: how far each sample was trusted; 0 where missing. `robust`: confidence times the
    probability that the sample is intact, 0 where all that is measured is noise. Published models: confidence times
    the Huber weight of the distance it was moved, 1 up to 1 cm and 1 cm / distance beyond (Huber, "Robust Statistics",
    1981, Sec. 7.3)."""
    changed: np.ndarray
    """(frame, joint) of `Change`: untouched, denoised, repaired, filled or unknown."""
    uncertainty: np.ndarray
    """(frame, joint): root mean square distance to expect between the answer and the truth, infinite where unknown.
    NaN for the published models, which do not say."""
    observed: np.ndarray
    """(frame, joint): True where the input held a sample with some confidence."""
    swaps: tuple[Swap, ...]
    """Runs of swapped joints that were put right before anything else."""
    bone_lengths: np.ndarray
    """(bone,): the lengths used, given or estimated."""
    bone_intervals: np.ndarray
    """(bone, 2): where the length is with a probability of 95 %; NaN for the published models."""
    skeleton: Skeleton
    fps: float | None
    result: Result
    """Verdict; `message` is its sentence."""
    steps: int
    trace: Any
    """One row a step, over all windows: `solver.Trace` of a published model, `solver.SmootherInfo` of `robust`."""
    seconds: dict[str, float]
    """`compile` and `run`, apart, summed over windows. `compile` is 0 when a program for these shapes was at hand."""

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
        return self.result.message

    @property
    def converged(self) -> bool:
        """Whether the iteration came to its end, not only to its last step."""
        return self.result == Result.converged


@one_blas_thread()
def recover(
    D: Any,
    skeleton: Skeleton,
    *,
    preset: str | Preset | Robust = "robust",
    observed: Any = None,
    confidence: Any = None,
    bone_lengths: Any = None,
    fps: float | None = None,
    max_gap: int | None = None,
    fill_unseen: bool = False,
    plant_feet: bool = False,
    symmetric: bool = False,
    guide: Any = None,
    guide_confidence: Any = None,
    guide_rounds: int = 1,
    max_steps: int | None = None,
    dtype: Any = None,
    throw: bool = True,
    verbose: bool = False,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Recovery:
    """Recover the motion behind corrupted joint positions.

    `D`: (frame, joint, 3), or the motion matrix (3 frames, joints) of Yang et al. 2020, Eq. 1; NumPy or JAX, in
    metres (any unit for `robust`); NaN marks missing samples. `preset`: a name in `presets.PRESETS`, a `Robust` or a
    `Preset`. `observed` (frame, joint): False marks further missing samples. `confidence` (frame, joint) in [0, 1]
    scales the trust in each sample; 0 makes it missing. `bone_lengths` (bone,) in the unit of D; left out, they are
    estimated from D. `fps`: frames a second, kept in the answer; no preset depends on it. `max_steps`: in place of the
    preset's. `dtype` of the answer: float32 (the default) or float64; the published models also compute in it,
    `robust` always in float64. `throw`: raise `RecoveryError` when the verdict is that there is no usable answer,
    instead of returning it with the verdict. `verbose`: print the trace. `workers`: windows of a long clip at a time,
    each in a thread; the answer is the same. `progress(done, windows)` is called before the first window, when all
    input is checked, and after each; what it raises ends the recovery.

    Of `robust` only: `max_gap`: gaps of more frames than this stay NaN; left out, a gap is filled however long, and
    `uncertainty` says how far to trust it. `fill_unseen`: joints that no frame shows are placed instead of staying NaN,
    as in poses of other people where the names of the joints are known, else by their bones alone, with infinite
    uncertainty. `plant_feet`: feet stay in place while they stand on the ground (y up, `fps` needed): it takes foot
    slide away, and moves feet by some millimetres. `symmetric`: estimated lengths of left and right bones are drawn
    together as far as their intervals allow.

    Of the published models only: `guide`: where joints are believed to be, as D, NaN where nothing is known; the answer
    is drawn there with `guide_confidence` (frame, joint) in [0, 1] and the preset's `guide_weight`, and joints that are
    never observed may be known by it alone. A refiner (`load_refiner`) as guide is called with D, and needs `fps`; with
    `guide_rounds` above 1 it is called again with each answer, and the model is solved again with what it says.

    Raises `ValueError`, in one sentence, for input that cannot be used: see `intake.take_in`.
    """
    preset = find(preset)
    dtype = np.dtype("float32" if dtype is None else dtype)
    if dtype.name not in ("float32", "float64"):
        raise ValueError(f"received dtype {dtype}: give float32 or float64")
    if fps is not None and not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"received a frame rate of {fps}: give frames a second, above 0")
    if max_gap is not None and max_gap < 0:
        raise ValueError(f"received max_gap {max_gap}: give a number of frames from 0 up")
    steps = preset.max_steps if max_steps is None else max_steps
    if steps < 1:
        raise ValueError(f"received max_steps {max_steps}: give at least 1")
    if workers < 1:
        raise ValueError(f"received {workers} workers: give at least 1")
    arguments = D, skeleton, observed, confidence, bone_lengths
    how = workers, progress
    if isinstance(preset, Robust):
        if guide is not None:
            raise ValueError("received a guide for robust: it is an option of the published models, give one as preset")
        if plant_feet and fps is None:
            raise ValueError("received plant_feet without fps: contacts are found by speed, give frames a second")
        recovery = _robust(*arguments, preset, steps, dtype, fps, max_gap, fill_unseen, plant_feet, symmetric, *how)
    elif max_gap is not None or fill_unseen or plant_feet or symmetric:
        raise ValueError(
            f"received max_gap, fill_unseen, plant_feet or symmetric for {preset.name}: they are options of robust"
        )
    else:
        if callable(guide) and fps is None:
            raise ValueError("received a refiner as guide without fps: give frames a second")
        if guide_rounds < 1:
            raise ValueError(f"received guide_rounds {guide_rounds}: give at least 1")
        refiner: Any = guide if callable(guide) else None
        if refiner:
            guide = refiner(D, skeleton, observed=observed, fps=fps).positions
        while True:
            recovery = _published(*arguments, preset, steps, dtype, fps, guide, guide_confidence, *how)
            guide_rounds -= 1
            if refiner is None or guide_rounds == 0 or _useless(recovery.result):
                break
            guide = refiner(recovery.positions, skeleton, fps=fps, keep_observed=False).positions
    if throw and _useless(recovery.result):
        raise RecoveryError(recovery.message)
    if verbose:
        _print_trace(recovery)
    return recovery


def recover_motion(motion: Motion, **options: Any) -> Recovery:
    """`recover` for a clip, with its own skeleton, masks and rate; `options` are those of `recover`."""
    masks = {"observed": motion.observed, "confidence": motion.confidence}
    return recover(motion.positions, motion.skeleton, fps=motion.fps, **masks, **options)


def _robust(
    D,
    skeleton,
    observed,
    confidence,
    bone_lengths,
    preset,
    steps,
    dtype,
    fps,
    max_gap,
    fill_unseen,
    plant_feet,
    paired,
    workers,
    progress,
):
    """The answer of `robust`: see `motionrecover.robust`."""
    raw, trust = intake.check(D, skeleton, observed, confidence)
    if bone_lengths is not None:
        bone_lengths = intake.checked_lengths(bone_lengths, skeleton)
    swaps = find_swaps(raw, skeleton, bone_lengths)
    data, weights = undo(raw, swaps), undo(trust, swaps)
    seen = np.array([weights[:, joint].any() for joint in range(len(skeleton.names))])
    if not seen.any():
        seen[:] = True  # nothing is observed: the solver's verdict says so
    kept = np.flatnonzero(seen)
    whole = [bone for bone, edge in enumerate(skeleton.edges) if seen[list(edge)].all()]
    body = Skeleton(
        [skeleton.names[j] for j in kept],
        [np.searchsorted(kept, skeleton.edges[bone]).tolist() for bone in whole],
        None if skeleton.rest_offsets is None else np.asarray(skeleton.rest_offsets)[kept],
    )
    given = None if bone_lengths is None else bone_lengths[whole]
    clip = intake.take_in(
        data[:, kept],
        body,
        confidence=weights[:, kept],
        bone_lengths=given,
        needs_bones=False,
        fill_reach=None,
        metres=False,
    )
    place = {edge: k for k, edge in enumerate(clip.edges)}
    merged = {
        bone: place.get(tuple(sorted(clip.groups[list(edge)].tolist())))
        for bone, edge in zip(whole, body.edges, strict=True)
    }
    pairs = [(merged.get(a), merged.get(b)) for a, b in mirrored_bones(skeleton)] if paired else []
    pairs = [(a, b) for a, b in pairs if a is not None and b is not None]
    seconds = {"compile": 0.0, "run": 0.0}
    people = poses.poses_of(skeleton.names)
    # Of joints that coincide the first that is recognised stands for all.
    stand_in = None if people is None else people.of(kept).merged(clip.groups)
    restored = robust.restore(clip, preset, given is not None, pairs, stand_in, steps, seconds, workers, progress)
    verdict = robust.verdict(restored)

    positions, variance, intact = (
        np.full((len(data), len(skeleton.names), *part.shape[2:]), empty)
        for part, empty in ((restored.positions, np.nan), (restored.variance, np.inf), (restored.intact, 0.0))
    )
    positions[:, kept] = restored.positions[:, clip.groups]
    variance[:, kept] = restored.variance[:, clip.groups]
    intact[:, kept] = restored.intact[:, clip.groups]
    # Of joints that coincide the solver sees one: it can be intact where another is thrown.
    shared = np.zeros(len(seen), bool)
    shared[kept] = np.bincount(clip.groups)[clip.groups] > 1
    away = np.linalg.norm(np.nan_to_num(data - positions), axis=-1) > 6 * restored.noise
    intact[:, shared] *= ~away[:, shared]
    there = weights > 0
    trusted = there & (intact > INTACT)
    if restored.exact:
        positions = np.where(trusted[..., None], data, positions)
    lengths, intervals = np.full(len(skeleton.edges), np.nan), np.full((len(skeleton.edges), 2), np.nan)
    for bone, k in merged.items():
        lengths[bone] = 0 if k is None else restored.bones.length[k]
        intervals[bone] = 0 if k is None else restored.bones.interval[k]
    if bone_lengths is not None:
        lengths = bone_lengths.copy()
    if fill_unseen:
        rest = skeleton.rest_lengths
        known = lengths if rest is None else np.where(np.isfinite(lengths), lengths, rest)
        stored = bucket(len(data), preset.window)
        if people is not None:
            placed = finishing.place_by_poses(positions, people, skeleton.edges, known, stored, seconds)
            variance = np.where(np.isfinite(placed[1]), placed[1], variance)
            positions = placed[0]
        positions = finishing.fill_unseen(positions, skeleton.edges, known)
    if plant_feet:
        stored = bucket(len(data), preset.window)
        positions = finishing.plant_feet(positions, skeleton, lengths, fps, stored, seconds)
    if max_gap is not None:
        positions = np.where(((run_lengths(~trusted) > max_gap) & ~there)[..., None], np.nan, positions)
    unknown = np.isnan(positions[..., 0])
    if unknown[:, seen].any() and verdict == Result.converged:
        verdict = Result.partly_unknown
    moved_back = np.any(np.nan_to_num(raw) != np.nan_to_num(data), -1)
    changed = np.where(there, Change.UNTOUCHED if restored.exact else Change.DENOISED, Change.FILLED)
    changed = np.where(there & (~trusted | moved_back), Change.REPAIRED, changed)
    changed = np.where(unknown, Change.UNKNOWN, changed)
    return Recovery(
        positions=positions.astype(dtype),
        outliers=np.where((there & ~trusted & ~unknown)[..., None], np.nan_to_num(data - positions), 0).astype(dtype),
        weights=weights * intact,
        changed=changed.astype(np.uint8),
        uncertainty=np.where(unknown, np.inf, np.sqrt(3 * variance)),
        observed=there,
        swaps=tuple(swaps),
        bone_lengths=lengths,
        bone_intervals=intervals,
        skeleton=skeleton,
        fps=fps,
        result=verdict,
        steps=max(int(solution.steps) for solution in restored.solutions),
        trace=_merge(restored.solutions),
        seconds=seconds,
    )


def _published(
    D, skeleton, observed, confidence, bone_lengths, preset, steps, dtype, fps, guide, trust, workers, progress
):
    """The answer of a published model: windows, solved one by one and faded into each other."""
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
        guide=guide,
        guide_confidence=trust,
    )
    frames = len(clip.data)
    window = frames if printed or preset.window is None else preset.window
    spans = windows.split(frames, window, min(preset.overlap, window - 1))
    stored = bucket(min(frames, window), preset.window)
    positions, outliers, solutions, seconds = [], [], [], {"compile": 0.0, "run": 0.0}

    def solution_of(span):
        # float64 is allowed for float32 data too: see `prox.singular_value_threshold`.
        with jax.enable_x64(True):
            problem, origin = clip.problem(span, stored, dtype)
            arrays = {"solver": preset.solver(problem), "problem": problem}
            return run(solve, arrays, {"max_steps": steps}, seconds), origin

    for span, (solution, origin) in zip(spans, windows.solved(solution_of, spans, workers, progress), strict=True):
        size = span.stop - span.start
        positions.append(clip.restore(solution.positions, size) + origin.astype(dtype))
        outliers.append(clip.restore(solution.outliers, size))
        solutions.append(solution)
    worst = max(solutions, key=lambda solution: (_useless(solution.result), solution.result != Result.converged))
    answer = windows.blend(positions, spans)
    if _useless(worst.result):
        answer = np.full_like(answer, np.nan)
    seen = clip.weights > 0
    # A joint merged with others has the group's E, plus what sets its own samples apart from the group's.
    apart = clip.data - clip.merged[:, clip.groups]
    moved = np.linalg.norm(np.nan_to_num(clip.data) - answer, axis=-1)
    changed = np.where(seen, np.where(moved > TRUST, Change.REPAIRED, Change.DENOISED), Change.FILLED)
    return Recovery(
        positions=answer,
        outliers=np.where(seen[..., None], windows.blend(outliers, spans) + apart, 0).astype(dtype),
        weights=np.where(seen, clip.weights * TRUST / np.maximum(moved, TRUST), 0),
        changed=np.where(np.isnan(answer[..., 0]), Change.UNKNOWN, changed).astype(np.uint8),
        uncertainty=np.full(seen.shape, np.nan),
        observed=seen,
        swaps=(),
        bone_lengths=clip.bone_lengths,
        bone_intervals=np.full((len(clip.bone_lengths), 2), np.nan),
        skeleton=skeleton,
        fps=fps,
        result=Result(int(worst.result)),
        steps=max(int(solution.steps) for solution in solutions),
        trace=_merge(solutions),
        seconds=seconds,
    )


def _useless(result):
    return result in (Result.nothing_observed, Result.non_finite)


def _merge(solutions: Sequence[Solution]) -> Any:
    """One trace from those of the windows: objective parts add up, of the rest the largest counts.

    A window that ended before the others stays at its last row.
    """
    traces = [jax.tree.map(np.asarray, solution.trace) for solution in solutions]
    steps = [int(solution.steps) for solution in solutions]
    last = max(steps)

    def column(name):
        columns = np.stack([getattr(trace, name) for trace in traces])
        for values, count in zip(columns, steps, strict=True):
            values[count:last] = values[count - 1] if count else np.nan
        return columns.sum(0) if name in ("nuclear", "outlier", "isometry", "smoothness", "guide") else columns.max(0)

    return type(traces[0])(**{field.name: column(field.name) for field in fields(traces[0])})


def _print_trace(recovery):
    """The trace at 1, 2, 5, 10, 20, 50, ... steps, the last one, and the verdict."""
    names = recovery.trace.shown
    print(f"{'step':>5} " + " ".join(f"{name.replace('_', ' '):>15}" for name in names))
    last = recovery.steps
    for step in sorted({k * 10**p for k in (1, 2, 5) for p in range(6) if k * 10**p <= last} | {last} - {0}):
        print(f"{step:5d} " + " ".join(f"{getattr(recovery.trace, name)[step - 1]:15.5g}" for name in names))
    print(recovery.message)
