"""Planted feet: which joints are feet, when they stand still on the ground, and where they should have stayed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from motionrecover.motion import UP_AXES
from motionrecover.runs import runs_of
from motionrecover.skeleton import Skeleton

_FOOT_WORDS = re.compile(r"foot|feet|toe|ankle|heel|(?<![a-z])ball(?![a-z])|^[lr](ank|hee|mt\d)$")

WINDOW = 0.1
"""Seconds over which a speed is measured: 3 mm of noise at 120 Hz are 0.9 m/s between frames and 0.05 m/s over this."""
TOUCH, RELEASE = 0.15, 0.3
"""Statures a second. A contact is somewhere slower than the first and ends where the foot is faster than the second.
On CMU walks a foot is then in contact 57 % of the time and some foot 99 %; when running 23 % and 46 %. At 0.1 and 0.2
it is 55 % of a walk, but half of the contacts of a run are lost."""
STRAY = 0.02
"""Statures: how far from its place a foot may be during a contact. With 0.05, dancers' feet are planted through small
steps: `plant` moves them by 13.5 mm, against 7.6 mm."""
LOWEST = 0.05
"""Statures a second: what always moves faster than this and strays is no contact. Above what noise alone amounts to."""
SHORTEST = 0.1
"""Seconds. A foot at the top of a kick or a jump is slow, too, but not for so long."""
SOLE, CLEARANCE = 0.08, 0.05
"""Statures: the most that an ankle is above the sole, and how much higher a foot that bears may be found."""


def foot_joints(skeleton: Skeleton, positions: np.ndarray | None = None, up: str = "y") -> list[int]:
    """Indices of ankles, heels, feet and toes, in the order of the skeleton.

    By name, as rigs have them: lfoot, ltoes (CMU); LeftFoot, LeftToeBase, mixamorig:LeftToe_End (BVH, Mixamo);
    AnkleLeft, FootLeft (Kinect); left_ankle, left_foot (SMPL); LHeel, LBigToe (OpenPose); foot_l, ball_l (Unreal);
    LANK, LHEE (optical markers). Where no name tells, the joints of at most one bone whose median height over
    the complete frames of `positions` (frame, joint, 3) is within a tenth of the body's height of the lowest one; none
    without positions.
    """
    names = [name.rpartition(":")[2].lower() for name in skeleton.names]
    named = [joint for joint, name in enumerate(names) if _FOOT_WORDS.search(name)]
    if named or positions is None:
        return named
    seen = np.asarray(positions, np.float64)[..., UP_AXES.index(up)]
    seen = seen[np.isfinite(seen).all(1)]
    if not len(seen):
        return []
    heights, bones = np.median(seen, axis=0), np.bincount(np.ravel(skeleton.edges).astype(int), minlength=len(names))
    ends = np.flatnonzero(bones <= 1)
    return [int(j) for j in ends if heights[j] <= heights[ends].min() + 0.1 * np.ptp(heights)]


def find_contacts(positions: np.ndarray, fps: float, feet: Sequence[int], up: str = "y") -> np.ndarray:
    """True (frame, foot) where a foot joint of a whole body in positions (frame, joint, 3) stands still and bears.

    The evidence is speed, as in Kovar, Schreiner and Gleicher, "Footskate cleanup for motion capture editing", SCA
    2002, with hysteresis. All limits are in statures and seconds, so neither unit nor frame rate matters; a stature is
    the median over frames of the largest distance between a foot and another joint.

    1. The speed of a foot joint is the slope of the line fitted to `WINDOW` seconds of its positions.
    2. A contact is a run of frames slower than `RELEASE` that is somewhere slower than `TOUCH`, lasts `SHORTEST`
       seconds and stays within `STRAY` of its geometric median. A run that strays is cut where it is fastest until its
       parts stay.
    3. It counts where the joint is for `SHORTEST` seconds no higher than `CLEARANCE` above its usual height over the
       body's lowest joint. A leg held up never is; on stairs and slopes a foot is as soon as the other one leaves.
       There is no level of the ground to know: in CMU's data the floor itself rises by 5 cm along a walk.

    A missing sample, and frames within half a window of one, are no contact. Feet in the air that hang still below
    everything else look planted; feet on a treadmill do not, nor does a foot that rests on a step above the other one
    and never bears alone.
    """
    positions = np.asarray(positions, np.float64)
    if not len(feet):
        return np.zeros((len(positions), 0), bool)
    stature = _stature(positions, feet)
    speeds = np.linalg.norm(_velocity(positions[:, feet], fps), axis=-1) / stature
    shortest = max(2, round(SHORTEST * fps))
    heights = positions[..., UP_AXES.index(up)]
    above = heights[:, feet] - np.fmin.reduce(heights, axis=1)[:, None]
    contacts = np.zeros(speeds.shape, bool)
    for foot, joint in enumerate(feet):
        speed, height = speeds[:, foot], above[:, foot]
        runs = _stays(positions[:, joint], speed, RELEASE, STRAY * stature)
        runs = [slice(a, b) for a, b in runs if b - a >= shortest and speed[a:b].min() < TOUCH]
        if runs:
            # A low quantile, not the minimum: noise makes single frames low.
            usual = min(np.quantile(np.concatenate([height[run] for run in runs]), 0.1), SOLE * stature)
            for run in runs:
                contacts[run, foot] = np.sum(height[run] <= usual + CLEARANCE * stature) >= shortest
    return contacts


class Plants(NamedTuple):
    """Where planted feet belong, as soft observations."""

    targets: np.ndarray
    """(frame, foot, 3): the place of the contact, the blend beside it, the given positions elsewhere."""
    weights: np.ndarray
    """(frame, foot) in [0, 1]: 1 in a contact, falling to 0 beside it. Targets already hold the blend."""


def plant(positions: np.ndarray, contacts: np.ndarray, feet: Sequence[int], fps: float, blend: float = 0.08) -> Plants:
    """Targets that keep every foot of positions (frame, joint, 3) in one place during each of its contacts.

    For each run of contact frames [a, b) of a foot x with place c, the geometric median of x over the run:

        target(t) = c                                   a <= t < b
        target(t) = x(t) + s(a - t) (c - x(a))          t < a, and so after b with x(b - 1)

    with s the cubic that falls from 1 to 0 over `blend` seconds, or over the gap to the next contact if that is
    shorter: changes made on constrained frames are blended into their neighbours (Kovar et al. 2002). Feet
    stay continuous, and beyond the blend they are as given.
    """
    given = np.asarray(positions, np.float64)[:, feet]
    contacts = np.asarray(contacts, bool)
    if contacts.shape != given.shape[:2]:
        raise ValueError(f"received contacts of shape {contacts.shape}: give (frame, foot) = {given.shape[:2]}")
    targets, weights = given.copy(), contacts.astype(np.float64)
    for foot in range(given.shape[1]):
        runs = runs_of(contacts[:, foot])
        ends = [(0, 0), *runs, (len(given), len(given))]
        for (_, before), (start, stop), (after, _) in zip(ends, runs, ends[2:], strict=False):
            place = geometric_median(given[start:stop, foot])
            targets[start:stop, foot] = place
            for edge, beside in ((start, np.arange(start - 1, before - 1, -1)), (stop - 1, np.arange(stop, after))):
                frames = beside[: round(blend * fps)]
                u = np.arange(1, len(frames) + 1) / (len(frames) + 1)
                share = 1 - u**2 * (3 - 2 * u)
                targets[frames, foot] += share[:, None] * (place - given[edge, foot])
                weights[frames, foot] = np.maximum(weights[frames, foot], share)
    return Plants(targets, weights)


def geometric_median(points: np.ndarray) -> np.ndarray:
    """The point (3,) with the least sum of distances to `points` (point, 3); half of them may be anywhere.

    Weiszfeld's iteration (Tohoku Math. J. 43, 1937) from the mean, with distances kept off 0.
    """
    centre = points.mean(0)
    spread = np.linalg.norm(points - centre, axis=-1).mean()
    for _ in range(20):
        distances = np.linalg.norm(points - centre, axis=-1)
        shares = 1 / np.maximum(distances, 1e-3 * spread + 1e-12)
        centre = shares @ points / shares.sum()
    return centre


def _stature(positions: np.ndarray, feet: Sequence[int]) -> float:
    """Median over frames of the largest distance between one of the feet and another joint."""
    reaches = [np.fmax.reduce(np.linalg.norm(positions - positions[:, [foot]], axis=-1), axis=1) for foot in feet]
    reach = np.fmax.reduce(reaches, axis=0)
    return float(np.median(reach[np.isfinite(reach)])) if np.isfinite(reach).any() else float("nan")


def _velocity(tracks: np.ndarray, fps: float) -> np.ndarray:
    """Slopes (frame, foot, 3) of the lines fitted to `WINDOW` seconds around each frame.

    Beyond the ends a track goes on as its own point reflection, which keeps the slope there.
    """
    half = max(1, round(WINDOW * fps / 2))
    times = np.arange(-half, half + 1) / fps
    padded = np.pad(tracks, ((half, half), (0, 0), (0, 0)), mode="reflect", reflect_type="odd")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0) @ (times / (times @ times))


def _stays(track: np.ndarray, speed: np.ndarray, limit: float, stray: float) -> list[tuple[int, int]]:
    """Start and stop of the runs slower than `limit` in which `track` (frame, 3) stays within `stray` of one place.

    A run that strays is searched again at a lower limit, which cuts it where it is fastest.
    """
    stays = []
    for start, stop in runs_of(speed < limit):
        part = track[start:stop]
        if np.linalg.norm(part - geometric_median(part), axis=-1).max() <= stray:
            stays.append((start, stop))
        elif limit > LOWEST:
            within = _stays(part, speed[start:stop], 0.8 * limit, stray)
            stays += [(start + first, start + last) for first, last in within]
    return stays
