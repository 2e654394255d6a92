"""What other people's poses say about a joint of this body: proportions and a prediction from the other joints.

Problem. Poses (pose, joint, 3) of several bodies are known, and a clip of another body of which a joint is missing.

1. Tree. The joints are tied by the spanning tree of least variation (Prim, Bell System Technical Journal 36, 1957): the
   cost of a pair is the standard deviation of the log of its distance within a body, and of equals the shorter is
   taken. Bones cost nothing, so they are found without being named, and where joints are left out, what is nearest to a
   bone.
2. Lengths. From each bone o that the clip shows, a bone u that it does not has the log length l_o + mean(l_u - l_o)
   over the bodies. These are averaged with weights (var(l_u - l_o) + `INDIVIDUAL`²)^-4: a bone follows those that it
   keeps a ratio to, the one on the other side before all. Every body is there with its mirror image.
3. Proportions. Bone by bone the poses get the clip's lengths, in the directions that they have.
4. Prediction. In rigid frames fitted to the other joints (evidence.local_shape), Gaussian process regression
   (Rasmussen & Williams, "Gaussian Processes for Machine Learning", 2006, Eqs. 2.23-2.26) of the joint's local position
   on the other joints' with the kernel
       k = 1 + <u, u'> + exp(-|u - u'|²/2l²) + ν [same pose],    l = `LENGTH`.
5. Variance. Leaving out all poses of a body (Eqs. 5.10-5.12) tells how far the next body may be from the prediction.

Nothing is in metres: the answer turns, moves and scales with the clip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionrecover.evidence.local_shape import inputs, rigid_frames

INDIVIDUAL = 0.01
"""Standard deviation of the log of a ratio beside what bodies show. Leaving out each of 10 CMU bodies, a bone of
cmu25 is predicted to 2.0 %, with 0.78 of its standard deviation, where bodies differ by 2 to 11 %; by the conditional
mean of normal log lengths to 4.2 % at best, since bodies are fewer than bones."""
FRAMES = 200
LENGTH = 2.0
"""In rms of the input."""

Blocks = tuple[np.ndarray, np.ndarray]
"""Sets of samples: their indices (block, sample), and which of these there are, as some blocks are shorter."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of several bodies, in any place, heading and unit."""

    positions: np.ndarray
    """(pose, joint, 3); NaN throughout for a joint that the bodies do not have."""
    bodies: np.ndarray
    """(pose,): number of the body from 0, or -1 less that of the body whose mirror image this is."""

    def of(self, joints: np.ndarray) -> Poses:
        """The same of the given joints (joint,)."""
        return Poses(self.positions[:, joints], self.bodies)

    def merged(self, groups: np.ndarray) -> Poses:
        """The same of groups (joint,) of joints that coincide, numbered from 0: of each its first that is present."""
        here = present(self.positions)
        return self.of(
            np.array([max(np.flatnonzero(groups == k), key=lambda j: here[j]) for k in range(max(groups) + 1)])
        )

    def thinned(self, most: int) -> Poses:
        """At most so many, evenly spread."""
        step = -(-len(self.bodies) // most)
        return Poses(self.positions[::step], self.bodies[::step])


@dataclass(frozen=True, eq=False)
class Proportions:
    """Poses with the lengths of one body."""

    positions: np.ndarray
    """(pose, joint, 3); NaN throughout for a joint that the poses do not have."""
    bodies: np.ndarray
    """(pose,): as in `Poses`."""
    tree: tuple[tuple[int, int], ...]
    """Bones of the spanning tree."""
    lengths: np.ndarray
    """(bone,) of the tree."""
    deviations: np.ndarray
    """(bone,): standard deviation of a length."""


def proportioned(poses: Poses, distances: np.ndarray) -> Proportions:
    """Steps 1 to 3: the poses on a body whose joints have the `distances` (joint, joint), NaN where unknown."""
    have = np.flatnonzero(present(poses.positions))
    x = poses.positions[:, have]
    logs = np.log(np.linalg.norm(x[:, :, None] - x[:, None], axis=-1) + np.eye(len(have)))
    own, which = np.unique(poses.bodies, return_inverse=True)
    means = np.stack([logs[which == k].mean(0) for k in range(len(own))])
    varies = np.sqrt(((logs - means[which]) ** 2).mean(0))
    i, j = np.array(_spanning_tree(varies + 1e-3 * np.exp(logs.mean(0) - logs.mean()))).T
    given = np.log(distances[have[i], have[j]])
    log_lengths, deviations = _completed(given, means[:, i, j])
    out, stretch = np.zeros_like(x), np.exp(log_lengths - logs[:, i, j])
    for bone, (a, b) in enumerate(zip(i, j, strict=True)):
        out[:, b] = out[:, a] + stretch[:, bone, None] * (x[:, b] - x[:, a])
    positions = np.full(poses.positions.shape, np.nan)
    positions[:, have] = out
    lengths = np.exp(log_lengths)
    tree = tuple((int(have[a]), int(have[b])) for a, b in zip(i, j, strict=True))
    return Proportions(positions, poses.bodies, tree, lengths, lengths * np.hypot(deviations, varies[i, j]))


def present(poses: np.ndarray) -> np.ndarray:
    """Joints (joint,) that poses (pose, joint, 3) have."""
    return np.isfinite(poses[0, :, 0])


def median_distances(positions: np.ndarray) -> np.ndarray:
    """Median distances (joint, joint) in positions (frame, joint, 3), NaN where a pair is never seen together.

    From so many frames as `FRAMES` to twice that.
    """
    x = positions[:: max(1, len(positions) // FRAMES)]
    d = np.sort(np.linalg.norm(x[:, :, None] - x[:, None], axis=-1), axis=0)
    count = np.isfinite(d).sum(0)
    middle = np.take_along_axis(d, np.maximum(count - 1, 0)[None] // 2, 0)[0]
    return np.where((count > 0) & (middle > 0), middle, np.nan)


def mean_from_poses(
    target: np.ndarray,
    poses: np.ndarray,
    others: np.ndarray,
    near: np.ndarray,
    share: np.ndarray,
    trust: np.ndarray,
    noise: float,
    bodies: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Step 4, and 5 with `bodies`: positions (row, 3) of a joint, and their variance (row,) an axis.

    `target` (pose, 3) and `poses` (pose, other, 3): the joint and the others in poses; `others` (row, other, 3): where
    they are in the clip, with `trust` (row, other); those that the poses do not have count for nothing. `near` and
    `share` (other,): weights of the others in the fit of the frame, and in the input. `noise`: ν.
    """
    from scipy.linalg import cho_factor, cho_solve, solve_triangular  # a fifth of a second to import

    here, learnt = present(poses), len(poses)
    poses, others, near, share, trust = poses[:, here], others[:, here], near[here], share[here], trust[:, here]
    weights = np.maximum(near, 1e-12) * np.concatenate([np.ones((learnt, len(near))), trust])
    rotations, centres, shapes = rigid_frames(np.concatenate([poses, others]), weights, learnt)
    linear, squares = inputs(shapes, share, learnt)
    far = np.maximum(squares[:, None] + squares[:learnt] - 2 * linear, 0)
    K = 1 + linear + np.exp(-far / (2 * LENGTH**2))
    local = np.einsum("ti,tij->tj", target - centres[:learnt], rotations[:learnt])
    mean = local.mean(0)
    factor = cho_factor(K[:learnt] + noise * np.eye(learnt), lower=True, check_finite=False)
    coefficients = cho_solve(factor, local - mean, check_finite=False)
    asked = K[learnt:]
    there = asked @ coefficients + mean
    positions = np.einsum("tj,tij->ti", there, rotations[learnt:]) + centres[learnt:]
    if bodies is None:
        return positions, None
    root = solve_triangular(factor[0], np.eye(learnt), lower=True, check_finite=False)
    inverse = root.T @ root
    spread = np.maximum(2 + squares[learnt:] - ((asked @ root.T) ** 2).sum(1), 0) + noise
    people = np.maximum(bodies, -1 - bodies)
    blocks = blocks_of([np.flatnonzero(people == person) for person in np.unique(people)])
    residuals, variances = leave_out(inverse, coefficients, blocks)
    amplitude = ((residuals**2).sum(2) / (3 * variances))[blocks[1]].mean()
    return positions, amplitude * spread


def leave_out(inverse: np.ndarray, coefficients: np.ndarray, blocks: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (block, sample, 3) and variances (block, sample) of the samples in each block when that is not learnt
    from; 0 and 1 where a block is shorter.

    `inverse` is K^-1 with the noise in K, `coefficients` K^-1 y. The block form of the leave-one-out formulas
    (Rasmussen & Williams 2006, Eqs. 5.10-5.12).
    """
    at, there = blocks
    pairs = there[:, :, None] & there[:, None]
    covariance = np.linalg.inv(np.where(pairs, inverse[at[:, :, None], at[:, None]], np.eye(at.shape[1])))
    return covariance @ np.where(there[..., None], coefficients[at], 0), np.einsum("bss->bs", covariance)


def blocks_of(indices: Sequence[np.ndarray]) -> Blocks:
    """Blocks of these samples each."""
    size = np.array([len(part) for part in indices])
    there = np.arange(size.max(initial=0)) < size[:, None]
    at = np.zeros(there.shape, int)
    at[there] = np.concatenate([*indices, np.zeros(0, int)])
    return at, there


def _spanning_tree(cost: np.ndarray) -> list[tuple[int, int]]:
    """Bones (old, new) of the least spanning tree of a cost (joint, joint), in the order in which it grows from 0."""
    near, via = cost[0].copy(), np.zeros(len(cost), int)
    near[0], bones = np.inf, []
    outside = np.arange(len(cost)) > 0
    while outside.any():
        new = int(np.argmin(np.where(outside, near, np.inf)))
        bones.append((int(via[new]), new))
        outside[new] = False
        closer = cost[new] < near
        near, via = np.where(closer, cost[new], near), np.where(closer, new, via)
    return bones


def _completed(log_lengths: np.ndarray, bodies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Step 2: log lengths (bone,) without NaN, and their standard deviations, from those of the bodies (body, bone)."""
    known = np.isfinite(log_lengths)
    out, deviations = log_lengths.copy(), np.zeros(len(known))
    if known.any() and not known.all():
        ratios = bodies[:, ~known, None] - bodies[:, None, known]
        variance = ratios.var(0) + INDIVIDUAL**2
        weights = variance**-4 / (variance**-4).sum(1, keepdims=True)
        out[~known] = (weights * (log_lengths[known] + ratios.mean(0))).sum(1)
        deviations[~known] = np.sqrt((weights * variance).sum(1))
    return out, deviations
