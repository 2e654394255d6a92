"""The robust recovery of the newest frames of an endless clip: a window of them, solved anew every few frames.

    1. The smoother (`solver.smoother`) goes on from what it believed about the window before: which samples are intact,
       noise, drive and activity. Of new frames only the bones tell. At the start, and when somebody comes back, it
       begins with nothing and is annealed, as for a clip.
    2. Gaps are filled and bones held as for a clip (`estimate`). What is learnt slowly comes from a memory of past
       frames: bone lengths, and how the other joints tell where a hidden one is.
    3. Into the gaps and the noisy samples that are due fades what the window before said of them: windows meet without
       a step.
    4. For frames behind the window, `solver.filter` goes on from its end (`follow`).

Everything that is kept has a fixed size, and all of it depends on the frames alone.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motionrecover import robust
from motionrecover.body import Body
from motionrecover.estimate import FREE, SHORT, Estimate, fill_gaps, hold, project_blocks
from motionrecover.evidence import regression
from motionrecover.evidence.bone_errors import smoothed_lengths
from motionrecover.evidence.bone_lengths import BoneLengths, estimate_bone_lengths
from motionrecover.evidence.pose_prior import Poses, median_distances, proportioned
from motionrecover.intake import fill
from motionrecover.isometry.objective import Edges
from motionrecover.programs import run
from motionrecover.runs import run_lengths, runs_of
from motionrecover.skeleton import bone_lengths
from motionrecover.solver import Problem, Smoother, SmootherState, filter, solve
from motionrecover.solver.smoother import INTACT, SETTLE
from motionrecover.threads import one_blas_thread

MEMORY = 192
"""Frames of the memory."""
COLD_STEPS = 45
"""At most, in a window that begins with nothing."""
KERNELS = regression.KERNELS[2], regression.KERNELS[5]
"""Of the regression: a third of what is tried for a clip. With all, 1 s at 30 Hz comes out 1 % better."""
SURE = 0.0
"""Weights by variance, as a clip has them, make missing samples of mixed at 30 Hz, 1 s, a tenth worse: what is learnt
from frames that are far apart is sure of too much."""
POSES = 128
"""Of other people."""
CAUTION = 9.0
"""The drive of a window is learnt from few frames, and gaps are often still open: there the smoother is off by two to
four times what it expects, and its variance counts so much more."""
MARGIN = 16
"""Frames on either side of those that are due that are smoothed with them when the bones are held."""
CROWD = 0.25
"""Share of the joints. Where more are hidden in one frame, the smoother alone fills gaps: those that could tell are
hidden too, and a window must end in time (11 of 25 joints: 0.11 s of regression, of 0.08 s to the next window)."""
SHOWN = 24
"""Frames of the memory from which on the held lengths are those of samples found intact."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What a stream is: its body and its sizes, in frames."""

    edges: Edges
    poses: Poses | None
    """Of other people, where it is known what the joints are."""
    window: int
    hop: int
    """From one window to the next."""
    back: int
    """From the first frame that is due to the window's end."""
    stride: int
    """Between two frames of the memory."""
    steps: int
    """Of the smoother in a window that goes on from another."""
    views: tuple[tuple[float, float], ...]
    """Of the regression, some of `regression.FRAMES`."""
    follows: bool
    """Whether frames behind the window are asked for."""


@dataclass(frozen=True, eq=False)
class Memory:
    """Frames of the past, the oldest first."""

    times: np.ndarray
    """(frame,): their numbers."""
    data: np.ndarray
    """(frame, joint, 3): what was measured, NaN where missing."""
    kept: np.ndarray
    """(frame, joint): whether it was found intact."""
    positions: np.ndarray
    """(frame, joint, 3): smoothed, before the bones were held; NaN where unknown."""

    def then(self, later: Memory) -> Memory:
        """Both, without the oldest frames beyond `MEMORY`."""
        pairs = ((getattr(self, field.name), getattr(later, field.name)) for field in fields(self))
        return Memory(*(np.concatenate(pair)[-MEMORY:] for pair in pairs))


@dataclass(frozen=True, eq=False)
class Learnt:
    """What the memory says."""

    body: Body
    """Of all samples: it tells which are intact."""
    lengths: BoneLengths
    """Of the intact ones: these are held."""
    people: np.ndarray | None
    """(pose, joint, 3): poses of other people with these proportions, NaN where they have no such joint."""
    frames: int
    """That there were."""


@dataclass(frozen=True, eq=False)
class Beliefs:
    """What the smoother believed about a window."""

    state: SmootherState
    first: int
    """Number of the first frame that the problem had."""
    frames: int
    """That it had."""
    trained: int
    """Frames with samples that there were when the smoother last began with nothing."""


@dataclass(frozen=True, eq=False)
class End:
    """Where a window ends, for `follow`; arrays as `solver.filter` takes them."""

    arrays: dict[str, Any]
    learnt: Learnt
    origin: np.ndarray
    exact: bool
    lost: int
    """Frames without enough intact joints before it."""


@dataclass(frozen=True, eq=False)
class Sliding:
    """The state between two windows."""

    memory: Memory
    learnt: Learnt | None = None
    beliefs: Beliefs | None = None
    """None: begin with nothing."""
    next: np.ndarray | None = None
    """(hop, joint, 3): what the last window said of the frames that are due in the next one."""
    end: End | None = None


def begin(joints: int) -> Sliding:
    """The state before the first window."""
    empty = np.zeros((0, joints, 3))
    return Sliding(Memory(np.zeros(0, int), empty, np.zeros((0, joints), bool), empty))


def forget(state: Sliding) -> Sliding:
    """The state when nobody has been there for a whole window: the body is remembered, the motion is not."""
    return replace(state, beliefs=None, next=None, end=None)


@one_blas_thread()
def advance(state: Sliding, plan: Plan, data: np.ndarray, trust: np.ndarray, count: int) -> tuple[Sliding, np.ndarray]:
    """The next state, and the frames that are due: (`plan.hop`, joint, 3), NaN where unknown.

    `data` (`plan.window`, joint, 3), NaN where missing, and `trust` (`plan.window`, joint), 0 where missing: the last
    of `count` frames.
    """
    part = _stretch(trust.any(1), plan.window - plan.back + plan.hop)
    if part is None:
        return forget(state), np.full((plan.hop, *data.shape[1:]), np.nan)
    data, trust = data[part], trust[part]
    frames, begins = len(data), count - plan.window + part.start
    first = plan.window - plan.back - part.start
    due, place = _shared(first, plan.hop, frames)
    after, place_after = _shared(first + plan.hop, plan.hop, frames)
    near = slice(max(due.start - MARGIN, 0), due.stop + MARGIN)
    with jax.enable_x64(True):
        state = _learn(state, plan, data, count)
        learnt = state.learnt
        assert learnt is not None
        body = learnt.body
        solved, origin, hopeless = _solve(state, plan, data, trust, begins)
        found = _estimate(solved, data, trust, origin, hopeless)
        noise = float(np.median(solved.state.noise))
        if not (np.isfinite(noise) and np.isfinite(found.positions).all()):
            return forget(state), np.full((plan.hop, *data.shape[1:]), np.nan)
        exact = body.exact or noise < (2 * Smoother.FLOOR * body.scale) ** 2
        predict = partial(_predicted, state=state, plan=plan, begins=begins, near=near)
        found = fill_gaps(found, exact, body.scale, predict)
        lost = robust.lost_frames(found.kept)
        unknown = (lost & ~found.kept) | (found.variance > body.scale**2)
        end = None
        if plan.follows and part.stop == plan.window and not hopeless.any():
            end = _end(found, solved, learnt, origin, exact, lost)
        if state.next is not None:
            found = _faded(found, due, state.next[place], exact)
        block = plan.hop + 2 * MARGIN
        held, _ = hold(found.of(near), learnt.lengths, plan.edges, exact, body.scale, block, {"compile": 0, "run": 0})
    answer, following = np.full((2, plan.hop, *data.shape[1:]), np.nan)
    inner = slice(due.start - near.start, due.stop - near.start)
    answer[place] = np.where(unknown[due, :, None], np.nan, held.positions[inner])
    smooth = np.where(unknown[..., None], np.nan, found.positions)
    following[place_after] = smooth[after]
    times = np.arange(begins, begins + frames)[due]
    rows = times % plan.stride == 0
    seen = Memory(times[rows], data[due][rows], held.kept[inner][rows], smooth[due][rows])
    return replace(state, memory=state.memory.then(seen), beliefs=solved, next=following, end=end), answer


def _stretch(there, end):
    """The frames that belong together: those before or after somebody was gone for long, the last to begin before
    `end`."""
    gone = run_lengths(~there[:, None])[:, 0] > robust.LONG
    parts = [slice(a + int(there[a:b].argmax()), b) for a, b in runs_of(~gone) if there[a:b].any()]
    return next((part for part in reversed(parts) if part.start < end), parts[0] if parts else None)


def _shared(first, count, frames):
    """Of `count` frames from `first` on, those that there are, and their places among the count."""
    a, b = np.clip([first, first + count], 0, frames).tolist()
    return slice(a, b), slice(a - first, b - first)


def follow(end: End, plan: Plan, data: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """The newest frame (joint, 3), NaN where unknown, from where a window ended and all frames behind it.

    `data` (frame, joint, 3), NaN where missing, and `trust` (frame, joint): at most 2 `plan.hop` frames.
    """
    frames, bones, scale = len(data), end.learnt.lengths, end.learnt.body.scale
    pad = (0, 2 * plan.hop - frames), (0, 0)
    arrays = end.arrays | {
        "samples": np.pad(np.nan_to_num(data - end.origin), (*pad, (0, 0))),
        "confidence": np.pad(trust, pad),
        "evidence": np.pad(end.learnt.body.evidence(bone_lengths(data, plan.edges)), pad),
    }
    seconds = {"compile": 0.0, "run": 0.0}
    with jax.enable_x64(True):
        positions, covariance, intact = run(filter.follow, arrays, {"edges": plan.edges}, seconds)
    last = frames - 1
    position, spread, kept = positions[last] + end.origin, covariance[last], intact[last] > INTACT
    variance = np.diag(spread)
    if end.exact:
        position = np.where(kept[:, None], data[last], position)
        spread = np.where(kept[:, None] | kept, 0.0, spread)
    held = (bones.rigid | (not end.exact)) & np.isfinite(bones.length)
    slack = np.where(held, 0, (FREE * scale) ** 2)
    length = np.where(held, bones.length, 0)
    with jax.enable_x64(True):
        position = project_blocks(position[None], spread[None], length, slack, plan.edges, 1, seconds)[0][0]
    few = np.sum(intact[:frames] > INTACT, 1) < min(robust.BODY, trust.shape[1])
    run_of_few = frames + end.lost if few.all() else int(np.argmin(few[::-1]))
    unknown = (variance > scale**2) | ((run_of_few > robust.LONG) & ~kept)
    return np.where(unknown[:, None], np.nan, position)


def _learn(state, plan, data, count):
    """The state with the body estimated anew, every ten frames of the memory and more often at first."""
    if state.learnt is not None and count - state.learnt.frames < min(10 * plan.stride, state.learnt.frames):
        return state
    memory = state.memory
    seen = np.concatenate([memory.data, data])
    lengths = bone_lengths(seen, plan.edges)
    measured = held = estimate_bone_lengths(lengths)
    body = Body.of(seen, lengths, measured)
    if len(memory.times) >= SHOWN:
        held = estimate_bone_lengths(bone_lengths(np.where(memory.kept[..., None], memory.data, np.nan), plan.edges))
        if not body.exact:
            held = smoothed_lengths(held, np.nan_to_num(memory.positions), memory.kept * 1.0, plan.edges)
    people = None if plan.poses is None else proportioned(plan.poses, median_distances(seen)).positions
    return replace(state, learnt=Learnt(body, held, people, count))


def _solve(state, plan, data, trust, begins):
    """Beliefs about these frames, their origin, and whether what is measured is noise in each."""
    learnt, frames, observed = state.learnt, len(data), trust > 0
    body = learnt.body
    origin = np.median(data[observed], 0)
    samples = np.where(observed.any(0)[:, None], fill(data) - origin, 0.0)
    pad = (0, plan.window - frames)
    samples, trust = np.pad(samples, (pad, (0, 0), (0, 0))), np.pad(trust, (pad, (0, 0)))
    problem = Problem(
        positions=jnp.asarray(samples.transpose(2, 1, 0)),
        weights=jnp.asarray(trust.T),
        bone_lengths=jnp.asarray(learnt.lengths.length),
        frames=jnp.asarray(frames, jnp.int32),
        edges=plan.edges,
    )
    measured, old = int(observed.any(1).sum()), state.beliefs
    if old is not None:
        grown = measured >= 2 * old.trained and 2 * old.trained <= plan.window
        old = None if grown or begins >= old.first + old.frames else old
    before = _nothing(data, observed, samples, body) if old is None else _shifted(old, begins, plan.steps)
    told, tolerance = body.evidence(bone_lengths(data, plan.edges)), 0.02 if old is None else np.inf
    solver = body.smoother(told, plan.window, np.diag(before.drive), tolerance, before)
    seconds = {"compile": 0.0, "run": 0.0}
    solution = run(solve, {"solver": solver, "problem": problem}, {"max_steps": COLD_STEPS}, seconds)
    hopeless = robust.hopeless(data, [solution], [slice(0, frames)], body.scale)
    return Beliefs(solution.state, begins, frames, measured if old is None else old.trained), origin, hopeless


def _nothing(data, observed, samples, body):
    """What is believed before anything is."""
    drive = body.drive(data, observed)
    frames, joints, _ = samples.shape
    hot = (Smoother.HOT * body.scale) ** 2
    nowhere = np.zeros((frames, joints, joints))
    unjudged = np.full((frames, joints), np.nan)
    level = np.full(joints, hot)
    arrays = samples, nowhere, unjudged, np.diag(drive), np.ones(frames), level, hot, body.outlier_share, 0
    return SmootherState(*map(jnp.asarray, arrays))


def _shifted(old, first, steps):
    """Beliefs for a window that begins at frame `first`, with so many steps left: of its new frames there are none."""
    gone = first - old.first
    new = np.arange(len(old.state.intact)) >= old.frames - gone

    def moved(rows, empty):
        return np.where(new.reshape(-1, *[1] * (rows.ndim - 1)), empty, np.roll(rows, -gone, 0))

    return replace(
        old.state,
        positions=moved(old.state.positions, 0.0),
        covariance=moved(old.state.covariance, 0.0),
        intact=moved(old.state.intact, np.nan),
        activity=moved(old.state.activity, 1.0),
        step=np.array(Smoother.anneal + SETTLE + 1 - steps),
    )


def _estimate(solved, data, trust, origin, hopeless):
    """What the beliefs say of the frames."""
    state, frames = solved.state, len(data)
    intact = np.where((trust > 0) & ~hopeless, state.intact[:frames], 0)
    doubt = np.sqrt(np.where(run_lengths(intact <= INTACT) >= SHORT, CAUTION, 1.0))
    return Estimate(
        merged=np.where((trust > 0)[..., None], data, origin),
        trust=trust,
        positions=state.positions[:frames] + origin,
        covariance=state.covariance[:frames] * doubt[:, :, None] * doubt[:, None],
        intact=intact,
        drive=state.activity[:frames, None] * np.diag(state.drive),
        noise=np.tile(state.noise, (frames, 1)),
    )


def _predicted(positions, kept, gaps, state, plan, begins, near):
    """What the other joints say of gaps that reach into the frames `near`: see `estimate.Predict`.

    They are learnt from the memory, and from the window.
    """
    memory, frames = state.memory, len(positions)
    wanted = np.zeros_like(gaps)
    for joint in np.flatnonzero(gaps[near].any(0)):
        for a, b in runs_of(gaps[:, joint]):
            wanted[a:b, joint] = a < near.stop and b > near.start
    if wanted[near].mean(1).max(initial=0) > CROWD:
        return positions, np.full(kept.shape, np.inf)
    old = memory.times < begins
    before = memory.positions[old]
    known = memory.kept[old] & np.isfinite(before).all(-1)
    # A row without any position has no joint that is known.
    middle = np.nansum(before, 1, keepdims=True) / np.maximum(known.sum(1), 1)[:, None, None]
    predicted, doubt = regression.predict_missing(
        np.concatenate([np.where(np.isfinite(before), before, middle), positions]),
        np.concatenate([known, kept]),
        regression.bone_distance(plan.edges, kept.shape[1]),
        np.concatenate([np.zeros_like(known), wanted]),
        state.learnt.people,
        np.concatenate([memory.times[old], np.arange(begins, begins + frames)]),
        plan.views,
        KERNELS,
        SURE,
    )
    return predicted[len(before) :], doubt[len(before) :]


def _faded(found, due, before, exact):
    """The estimate, into whose frames that are due those of the window `before` fade."""
    share = (np.arange(len(before)) + 1) / (len(before) + 1)
    now = found.positions[due]
    fades = run_lengths(~found.kept)[due] >= SHORT if exact else np.ones(now.shape[:2], bool)
    mixed = np.where(fades[..., None] & np.isfinite(before), before + share[:, None, None] * (now - before), now)
    positions = found.positions.copy()
    positions[due] = mixed
    return replace(found, positions=positions)


def _end(found, solved, learnt, origin, exact, lost):
    """Where the window ends: its last frame holds what gaps were filled with."""
    state, frames, scale = solved.state, len(found.trust), learnt.body.scale
    far = (Smoother.MISSING * scale) ** 2
    noise = np.where(found.kept, state.noise / np.maximum(found.trust, 1e-3), far)
    noise[-1] = np.where(found.kept[-1], noise[-1], np.maximum(found.variance[-1], state.noise))
    samples = np.where(found.kept[..., None], found.merged, found.positions) - origin
    # Frames before the first say nothing.
    pad = len(state.intact) - frames, 0
    arrays = {
        "samples": np.pad(samples, (pad, (0, 0), (0, 0)), mode="edge"),
        "noise": np.pad(noise, (pad, (0, 0)), constant_values=far),
        "activity": np.pad(state.activity[:frames], pad, mode="edge"),
        "drive": state.drive,
        "start": np.array((Smoother.FREE * scale) ** 2),
    }
    arrays = {
        "state": run(filter.behind, arrays, {}, {"compile": 0.0, "run": 0.0}),
        "drive": state.activity[frames - 1] * state.drive,
        "noise": state.noise,
        "outlier": state.outlier,
        "outlier_share": state.outlier_share,
        "scale": np.array(scale),
    }
    return End(arrays, learnt, origin, exact, int(run_lengths(lost)[-1, 0]))
