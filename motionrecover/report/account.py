"""The account of a recovery in numbers: how far what was changed, and which moments to look at. Metres and frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from motionrecover import metrics
from motionrecover.evidence.contacts import find_contacts, foot_joints
from motionrecover.motion import Motion
from motionrecover.recovery import Recovery
from motionrecover.robust import Change
from motionrecover.runs import runs_of
from motionrecover.skeleton import Skeleton

NOTABLE = 0.01
"""Metres. What is less far off, or was moved less, is no moment to look at."""
APART = 0.5
"""Seconds between two moments of one kind."""
COUNT = 4
"""Moments of one kind."""


def measured(clip: Motion) -> np.ndarray:
    """Positions (frame, joint, 3), NaN where nothing was measured."""
    return np.where(clip.observed[..., None], clip.positions, np.nan)


def moved(clip: Motion, recovery: Recovery) -> np.ndarray:
    """Distance (frame, joint) from the input to the answer; NaN where either is missing."""
    return np.linalg.norm(measured(clip) - recovery.positions, axis=-1)


def extent(clip: Motion, recovery: Recovery) -> np.ndarray:
    """How far what `recovery.changed` names went (frame, joint): the distance that a sample was moved; of a filled one,
    which has no input, its uncertainty. 0 where there is neither."""
    filled = recovery.changed == Change.FILLED
    return np.nan_to_num(np.where(filled, recovery.uncertainty, moved(clip, recovery)), posinf=0.0)


@dataclass(frozen=True)
class Moment:
    """A place to look at."""

    kind: str
    """unknown, swap, uncertain or repaired."""
    frame: int
    """Where to look."""
    start: int
    stop: int
    """The frames concerned, from `start` up to, not including, `stop`."""
    joints: tuple[int, ...]
    metres: float
    """How far moved, or how far off it may be; NaN for what is unknown."""


def moments(clip: Motion, recovery: Recovery) -> list[Moment]:
    """What to look at, at most `COUNT` of each kind, the most pressing kind first.

    1. Runs of frames where a joint stays unknown that other frames know, the longest first.
    2. Swaps that were put right, the longest first.
    3. Where the answer is least certain, one for `APART` seconds.
    4. Where an observed sample was moved farthest, one for `APART` seconds, swaps aside.
    """
    unknown = recovery.changed == Change.UNKNOWN
    partly = unknown & ~unknown.all(0)
    found = []
    for start, stop in sorted(runs_of(partly.any(1)), key=lambda run: run[0] - run[1])[:COUNT]:
        joints = tuple(np.flatnonzero(partly[start:stop].any(0)).tolist())
        found.append(Moment("unknown", start, start, stop, joints, float("nan")))
    distance = np.nan_to_num(moved(clip, recovery))
    for swap in sorted(recovery.swaps, key=lambda swap: swap.start - swap.stop)[:COUNT]:
        joints = (swap.first_joint, swap.second_joint)
        far = float(distance[swap.start : swap.stop, joints].max())
        found.append(Moment("swap", swap.start, swap.start, swap.stop, joints, far))
    for swap in recovery.swaps:
        distance[swap.start : swap.stop, [swap.first_joint, swap.second_joint]] = 0
    distance[recovery.changed != Change.REPAIRED] = 0
    doubt = np.nan_to_num(recovery.uncertainty, posinf=0.0)
    for kind, score in (("uncertain", doubt), ("repaired", distance)):
        found += _peaks(kind, score, recovery.changed, round(APART * clip.fps))
    return found


def _peaks(kind: str, score: np.ndarray, changed: np.ndarray, apart: int) -> list[Moment]:
    """Up to `COUNT` moments where score (frame, joint) is notable and highest, each more than `apart` frames, and a
    whole gap or repair, from the others."""
    left, found = score.max(1), []
    while len(found) < COUNT and left.max() > NOTABLE:
        frame = int(left.argmax())
        joint = int(score[frame].argmax())
        start, stop = frame, frame + 1
        if changed[frame, joint] in (Change.FILLED, Change.REPAIRED):
            same = runs_of(changed[:, joint] == changed[frame, joint])
            start, stop = next(run for run in same if run[0] <= frame < run[1])
        found.append(Moment(kind, frame, start, stop, (joint,), float(score[frame, joint])))
        left[max(0, min(start, frame - apart)) : max(stop, frame + apart + 1)] = 0
    return found


@dataclass(frozen=True, eq=False)
class Feet:
    """Contacts of the recovered feet with the ground, and how far feet slide meanwhile."""

    joints: tuple[int, ...]
    contacts: np.ndarray
    """(frame, foot)."""
    speeds: np.ndarray
    """(frame, foot): horizontal speed of a recovered foot in contact, metres a second; NaN elsewhere."""
    before: tuple[float, ...]
    """Mean slide of the input in the same contacts, metres a second; NaN where it is unknown."""
    after: tuple[float, ...]


def feet(clip: Motion, recovery: Recovery) -> Feet:
    """What the feet do; no feet for a clip in which none is found, or that is too short to have a speed."""
    answer = np.asarray(recovery.positions, np.float64)
    joints = foot_joints(clip.skeleton, answer) if len(clip) > 2 else []
    if not joints:
        nothing = np.zeros((len(clip), 0))
        return Feet((), nothing > 0, nothing, (), ())
    contacts = find_contacts(answer, clip.fps, joints)
    speeds = np.linalg.norm(np.diff(answer[:, joints], axis=0)[..., [0, 2]], axis=-1) * clip.fps
    speeds = np.where(contacts, np.concatenate([speeds, speeds[-1:]]), np.nan)

    def slide(positions: np.ndarray) -> tuple[float, ...]:
        known = contacts & np.isfinite(positions[:, joints, 0])
        each = enumerate(joints)
        return tuple(metrics.foot_slide(positions, known[:, [k]], [joint], clip.fps) for k, joint in each)

    return Feet(tuple(joints), contacts, speeds, slide(measured(clip)), slide(answer))


def bone_deviations(positions: np.ndarray, recovery: Recovery) -> np.ndarray:
    """Mean distance (bone,) of the bones of positions (frame, joint, 3) from the length that was used; NaN without."""
    off = np.abs(recovery.skeleton.bone_lengths_of(positions) - recovery.bone_lengths)
    counts = np.isfinite(off).sum(0)
    return np.where(counts, np.nansum(off, axis=0) / np.maximum(counts, 1), np.nan)


def binned(values: np.ndarray, size: int) -> np.ndarray:
    """The largest of every `size` frames of values (frame, ...), so that what is short stays visible."""
    return np.maximum.reduceat(values, np.arange(0, len(values), size), axis=0)


def verdict(recovery: Recovery) -> dict[str, Any]:
    """How the solver ended."""
    return {
        "converged": recovery.converged,
        "message": recovery.message,
        "steps": recovery.steps,
        "seconds": recovery.seconds,
    }


def measures(
    clips: dict[str, np.ndarray], skeleton: Skeleton, lengths: np.ndarray, truth: Motion | None = None
) -> dict[str, Any]:
    """Errors of each clip against the bone lengths that were used, and against the truth if there is one."""

    # All clips are measured where all have a position, so that their numbers compare.
    known = np.logical_and.reduce([np.isfinite(positions).all(-1) for positions in clips.values()])

    def each(measure) -> dict[str, float]:
        return {name: 1000 * measure(positions) for name, positions in clips.items()}

    facts = {}
    if truth is not None:
        counts = known & truth.observed
        facts["aje_mm"] = each(lambda positions: metrics.aje(positions, truth.positions, counts))
        facts["abe_mm"] = each(lambda positions: metrics.abe(positions, truth.positions, skeleton, counts))
    bones = [bone for bone, length in enumerate(lengths) if np.isfinite(length)]
    edges = [skeleton.edges[bone] for bone in bones]
    return facts | {
        "bone_length_deviation_mm": each(lambda positions: metrics.abe(positions, lengths[bones], edges, known))
    }


def changes(recovery: Recovery) -> dict[str, Any]:
    """What happened to how many samples, and what stays unknown."""
    names = recovery.skeleton.names
    unknown = recovery.changed == Change.UNKNOWN
    filled = recovery.changed == Change.FILLED
    doubt = recovery.uncertainty[filled & np.isfinite(recovery.uncertainty)]
    return {
        "samples": {kind.name.lower(): int((recovery.changed == kind).sum()) for kind in Change},
        "filled_uncertainty_mm": 1000 * float(doubt.mean()) if len(doubt) else None,
        "swaps": [
            f"{names[swap.first_joint]} and {names[swap.second_joint]}, frames {swap.start} to {swap.stop - 1}"
            for swap in recovery.swaps
        ],
        "never_seen": [name for joint, name in enumerate(names) if not recovery.observed[:, joint].any()],
        "partly_unknown": [name for joint, name in enumerate(names) if unknown[:, joint].any()],
    }
