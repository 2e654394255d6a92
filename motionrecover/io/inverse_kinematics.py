"""Inverse kinematics: the rotations of a hierarchy that bring its joints to given positions, all frames at once.

    min over turns and moves of  sum_k |p_k - P_k|^2 + PULL |x - x_0|^2

P_k are the known positions, p_k those of forward kinematics, x the turns (radians) and moves (metres) of the joints.
Positions do not show everything, such as the twist of a stretched limb: that stays near x_0.

    1. From the root down, each joint takes its reference rotation and is turned by as little as brings its children
       into their directions: R = argmin sum_k |P_k - p - R d_k|^2, a weighted Procrustes problem (Kabsch 1976) with a
       weak pull to the identity. With one child that is the swing of the shortest arc, which leaves the twist alone.
       Children at the joint itself (bones of no length) keep their rotation here, and their own children count.
    2. Where a reference is off by more than `DOUBT`, its twist is in doubt too: it is replaced by the one between its
       neighbours in time, and step 1 is done again.
    3. Gauss-Newton steps with Levenberg's damping, a frame's own, until every position is within `CLOSE`, or no step
       helps: joints with fewer than three channels, bodies that are not as rigid as the hierarchy.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionrecover.io.kinematics import euler_rotations, forward
from motionrecover.rotations import about, nearest_rotation, skew

CLOSE = 1e-5
"""Metres. Nearer is not asked for: float32 positions 100 m from the origin are off by as much."""
PULL = 1e-6
"""0.1 mm against 0.1 rad, squared: a thigh whose shin is 1 mm off its axis is not turned by 30 degrees for 0.5 mm."""
FAINT = 1e-8
"""Square metres. The pull of step 1: bones of well under a millimetre turn nothing, 4 cm are off by 10^-5 rad."""
DOUBT = np.radians(10)
"""A bone of 3 cm turns by as much for 5 mm of noise."""
STEPS = 30
FEW = 40
"""Unknowns that are multiplied and solved for in one go. From about 100 on, OpenBLAS sets all cores to each small
matrix: on a busy machine 256 products of 132 x 132 take 2.1 s instead of 0.07, and so do solutions of 100 unknowns."""
BLOCK = 256
"""Frames whose equations are held in memory at once, 100 kB each."""


@dataclass(frozen=True, eq=False)
class Pose:
    """What moves a hierarchy, relative to each joint's parent."""

    translations: np.ndarray
    """(frame, joint, 3) in metres."""
    angles: np.ndarray
    """(frame, joint, 3) in radians, in the joint's order."""
    rotations: np.ndarray
    """(frame, joint, 3, 3)."""


@dataclass(frozen=True, eq=False)
class Freedom:
    """What of each joint may change."""

    parents: Sequence[int]
    """Parents come before their children; -1 marks a root."""
    orders: Sequence[str]
    """Order of the rotation channels."""
    turns: np.ndarray
    """Number of rotation channels (joint,)."""
    moves: np.ndarray
    """Axes along which the joint may move (joint, 3)."""


def solve(freedom: Freedom, start: Pose, targets: np.ndarray) -> Pose:
    """The pose nearest to `start` whose positions are `targets` (frame, joint, 3) in metres, NaN where unknown.

    Angles of joints with three rotation channels are not brought up to date.
    """
    positions, _ = forward(freedom.parents, start.translations, start.rotations)
    if _miss(positions, targets).max() <= CLOSE:
        return start
    turned, off = _swing(freedom, start, targets)
    doubtful = off > DOUBT
    if doubtful.any():
        turned, _ = _swing(freedom, _bridge(start, doubtful), targets)
    blocks = [slice(first, first + BLOCK) for first in range(0, len(targets), BLOCK)]
    parts = [_refine(freedom, _part(turned, block), targets[block]) for block in blocks]
    return Pose(*(np.concatenate([getattr(part, name) for part in parts]) for name in Pose.__dataclass_fields__))


def _part(pose: Pose, frames) -> Pose:
    return Pose(pose.translations[frames], pose.angles[frames], pose.rotations[frames])


def _miss(positions, targets):
    """Distance (frame,) of the joint that is farthest from its target."""
    return np.sqrt(np.nan_to_num(np.sum((positions - targets) ** 2, -1)).max(-1))


def _swing(freedom: Freedom, reference: Pose, targets: np.ndarray) -> tuple[Pose, np.ndarray]:
    """Step 1, and the angles (frame, joint) by which joints were turned from the reference."""
    translations, rotations = reference.translations.copy(), reference.rotations.copy()
    positions, turned = np.empty_like(translations), np.empty_like(rotations)
    off = np.zeros(targets.shape[:2])
    for joint, parent in enumerate(freedom.parents):
        above = np.broadcast_to(np.eye(3), turned[:, 0].shape) if parent == -1 else turned[:, parent]
        at = 0.0 if parent == -1 else positions[:, parent]
        free = freedom.moves[joint]
        if free.any():
            wanted = np.einsum("fji,fj->fi", above, targets[:, joint] - at)
            translations[:, joint] = np.where(free & np.isfinite(wanted), wanted, translations[:, joint])
        positions[:, joint] = at + np.einsum("fij,fj->fi", above, translations[:, joint])
        turned[:, joint] = above @ rotations[:, joint]
        children = _children(freedom, reference, joint)
        if freedom.turns[joint] < 3 or not children:
            continue
        towards = np.broadcast_to(FAINT * np.eye(3), turned[:, 0].shape).copy()
        for child, offset in children:
            now = np.einsum("fij,fj->fi", turned[:, joint], offset)
            towards += np.nan_to_num(targets[:, child] - positions[:, joint])[:, :, None] * now[:, None]
        turn = nearest_rotation(towards)
        off[:, joint] = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
        turned[:, joint] = turn @ turned[:, joint]
        rotations[:, joint] = np.swapaxes(above, 1, 2) @ turned[:, joint]
    return Pose(translations, reference.angles, rotations), off


def _children(freedom: Freedom, reference: Pose, joint: int) -> list[tuple[int, np.ndarray]]:
    """(joint, offset (frame, 3)) of what a turn of `joint` moves, past bones of no length."""
    found = []
    for child, parent in enumerate(freedom.parents):
        if parent != joint or freedom.moves[child].any():
            continue
        offset = reference.translations[:, child]
        if np.abs(offset).max() > CLOSE:
            found.append((child, offset))
        else:
            local = reference.rotations[:, child]
            found += [
                (further, np.einsum("fij,fj->fi", local, o)) for further, o in _children(freedom, reference, child)
            ]
    return found


def _bridge(reference: Pose, doubtful: np.ndarray) -> Pose:
    """Step 2: rotations of doubtful frames between those of the nearest others, where most frames are not doubtful."""
    rotations = reference.rotations.copy()
    for joint in np.flatnonzero(doubtful.any(0) & (doubtful.mean(0) < 0.5)):
        good, bad = np.flatnonzero(~doubtful[:, joint]), np.flatnonzero(doubtful[:, joint])
        place = np.searchsorted(good, bad)
        before, after = good[np.maximum(place - 1, 0)], good[np.minimum(place, len(good) - 1)]
        weight = np.clip((bad - before) / np.maximum(after - before, 1), 0, 1)[:, None, None]
        between = (1 - weight) * reference.rotations[before, joint] + weight * reference.rotations[after, joint]
        rotations[bad, joint] = nearest_rotation(between)
    return Pose(reference.translations, reference.angles, rotations)


def _refine(freedom: Freedom, start: Pose, targets: np.ndarray) -> Pose:
    """Step 3."""
    best = Pose(start.translations.copy(), start.angles.copy(), start.rotations.copy())
    unknowns = _unknowns(freedom)
    gone = np.zeros((len(targets), len(unknowns)))
    damping = np.full(len(targets), 1e-9)
    positions, _ = forward(freedom.parents, best.translations, best.rotations)
    cost = np.nansum((positions - targets) ** 2, (1, 2))
    active = np.flatnonzero(_miss(positions, targets) > CLOSE)
    for _ in range(STEPS):
        if not len(active) or not unknowns:
            break
        now, goal, x = _part(best, active), targets[active], gone[active]
        jacobian, left = _linear(freedom, unknowns, now, goal)
        normal = _squared(jacobian)
        # Where bones are kilometres long, PULL alone is less than their squares' last digit.
        least = 1e-12 * np.diagonal(normal, axis1=1, axis2=2).max(-1)
        normal += (PULL + damping[active] + least)[:, None, None] * np.eye(len(unknowns))
        step = _solved(normal, jacobian @ left[..., None] - PULL * x[..., None])[..., 0]
        tried = _moved(freedom, unknowns, now, step)
        positions, _ = forward(freedom.parents, tried.translations, tried.rotations)
        found = np.nansum((positions - goal) ** 2, (1, 2)) + PULL * np.sum((x + step) ** 2, -1)
        better = found < cost[active]
        # A per cent of improvement is the end of it.
        stays = np.where(better, found < 0.99 * cost[active], damping[active] < 1.0)
        stays &= np.where(better, _miss(positions, goal) > CLOSE, True)
        took = active[better]
        for name in Pose.__dataclass_fields__:
            getattr(best, name)[took] = getattr(tried, name)[better]
        gone[took] += step[better]
        cost[took] = found[better]
        damping[active] = np.where(better, 0.1 * damping[active], np.maximum(100 * damping[active], 1e-6))
        active = active[stays]
    return best


def _unknowns(freedom: Freedom) -> list[tuple[str, int, int]]:
    """(turn, hinge or move; joint; axis or place in its order) of all that may change."""
    unknowns = []
    for joint, turns in enumerate(freedom.turns):
        unknowns += [("move", joint, axis) for axis in range(3) if freedom.moves[joint, axis]]
        if joint in freedom.parents:
            unknowns += [("turn" if turns == 3 else "hinge", joint, place) for place in range(turns)]
    return unknowns


def _linear(freedom, unknowns, pose, targets):
    """Jacobian transposed (frame, unknown, 3 joints) of the positions, and what is left (frame, 3 joints) to go."""
    positions, turned = forward(freedom.parents, pose.translations, pose.rotations)
    joints, frames = len(freedom.parents), len(positions)
    below = np.eye(joints, dtype=bool)
    for joint, parent in enumerate(freedom.parents):
        if parent != -1:
            below[:, joint] |= below[:, parent]
    known = np.isfinite(targets).all(-1)
    axes = np.empty((frames, len(unknowns), 3))
    for column, (kind, joint, which) in enumerate(unknowns):
        if kind == "turn":
            axes[:, column] = turned[:, joint, :, which]
            continue
        axis = which
        parent = freedom.parents[joint]
        above = np.broadcast_to(np.eye(3), turned[:, 0].shape) if parent == -1 else turned[:, parent]
        if kind == "hinge":
            axis = "XYZ".index(freedom.orders[joint][which])
            before = np.where(np.arange(3) < which, pose.angles[:, joint : joint + 1], 0)
            above = above @ euler_rotations(before, [freedom.orders[joint]])[:, 0]
        axes[:, column] = above[:, :, axis]
    owners = np.array([joint for _, joint, _ in unknowns])
    moves = np.array([kind == "move" for kind, _, _ in unknowns])[:, None, None]
    # w x (p_k - p_j) for turns about the axis w through joint j, w itself for moves along w
    turning = (skew(axes).reshape(frames, -1, 3) @ np.swapaxes(positions, 1, 2)).reshape(*axes.shape, joints)
    turning -= np.cross(axes, positions[:, owners])[..., None]
    jacobian = np.where(moves, axes[..., None], turning) * (below[owners][:, None] & known[:, None, None])
    left = np.where(known[..., None], targets - positions, 0)
    return jacobian.reshape(frames, len(unknowns), -1), np.swapaxes(left, 1, 2).reshape(frames, -1)


def _squared(matrices):
    """M M^T (frame, n, n) for M (frame, n, m)."""
    n = matrices.shape[1]
    out = np.empty((len(matrices), n, n))
    parts = [slice(first, first + FEW) for first in range(0, n, FEW)]
    for one, other in itertools.product(parts, parts):
        out[:, one, other] = matrices[:, one] @ np.swapaxes(matrices[:, other], 1, 2)
    return out


def _solved(a, b):
    """A^-1 B for positive definite A (frame, n, n) and B (frame, n, 1), block by block."""
    if a.shape[1] <= FEW:
        return np.linalg.solve(a, b)
    both = np.linalg.solve(a[:, :FEW, :FEW], np.concatenate([a[:, :FEW, FEW:], b[:, :FEW]], -1))
    across, own = both[..., :-1], both[..., -1:]
    below = a[:, FEW:, :FEW]
    rest = _solved(a[:, FEW:, FEW:] - below @ across, b[:, FEW:] - below @ own)
    return np.concatenate([own - across @ rest, rest], 1)


def _moved(freedom, unknowns, pose, step):
    """The pose after steps (frame, unknown)."""
    translations, angles, rotations = pose.translations.copy(), pose.angles.copy(), pose.rotations.copy()
    vectors = np.zeros_like(translations)
    for column, (kind, joint, which) in enumerate(unknowns):
        part = {"turn": vectors, "hinge": angles, "move": translations}[kind]
        part[:, joint, which] += step[:, column]
    rotations = rotations @ about(vectors)
    hinged = sorted({joint for kind, joint, _ in unknowns if kind == "hinge"})
    if hinged:
        rotations[:, hinged] = euler_rotations(angles[:, hinged], [freedom.orders[joint] for joint in hinged])
    return Pose(translations, angles, rotations)
