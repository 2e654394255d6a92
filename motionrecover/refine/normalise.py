"""From positions in the world to the numbers that a network sees, and back.

    1. The origin of each frame moves with the body: the root, or the point below it on the ground.
    2. Its heading, the turn about the vertical, is taken out if asked for. Left and right joints that hang on the
       trunk (hips, shoulders) say what is across; their direction is smoothed over `HEADING_SPREAD` seconds.
    3. Of what remains the mean pose is subtracted, and it is divided by the largest value of each axis (Choi et al.
       2024, Sec. 5.1) or by one standard deviation (Li et al. 2020, Sec. III-A).

Steps 1 and 2 are NumPy, for whole clips in float64; step 3 is in the compiled programs.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import gaussian_filter1d

from motionrecover.skeleton import Skeleton

HEADING_SPREAD = 0.1
"""Standard deviation in seconds: 3 cm of noise turn the line between two hips by 12 degrees from frame to frame."""
ORIGIN_SPREAD = 0.05
"""The same of the origin, where the root is noisy."""


@dataclass(frozen=True)
class Convention:
    """How a model wants its motion."""

    window: int
    """Frames a window in training, and for refining."""
    origin: Literal["root", "ground"]
    heading: Literal["removed", "kept"]
    scale: Literal["axes", "overall"]
    fps: float = 60.0


CHOI = Convention(64, "root", "removed", "axes")
LI = Convention(120, "ground", "kept", "overall")


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the body is: the way from a clip in the world to one about the body, and back."""

    origin: np.ndarray
    """(frame, 3)."""
    heading: np.ndarray
    """(frame,) in radians about y."""

    def inward(self, positions: np.ndarray) -> np.ndarray:
        """Positions (frame, joint, 3) about the body."""
        return _turned(positions - self.origin[:, None], -self.heading)

    def outward(self, positions: np.ndarray) -> np.ndarray:
        """Positions (frame, joint, 3) in the world."""
        return _turned(positions, self.heading) + self.origin[:, None]


@dataclass(frozen=True, eq=False)
class Normaliser:
    """Mean pose (joint, 3) and scale (3,) of motion about the body, in metres."""

    mean: np.ndarray
    scale: np.ndarray

    @staticmethod
    def of(clips: Iterable[np.ndarray], scale: Literal["axes", "overall"]) -> Normaliser:
        """Of clips (frame, joint, 3) about the body, passed over twice."""
        clips = list(clips)
        frames = sum(len(clip) for clip in clips)
        mean = np.sum([clip.sum(0, dtype=np.float64) for clip in clips], 0) / frames
        if scale == "axes":
            size = np.max([np.abs(clip - mean).max((0, 1)) for clip in clips], 0)
        else:
            power = sum(((clip - mean) ** 2).sum(dtype=np.float64) for clip in clips) / (frames * mean.size)
            size = np.full(3, np.sqrt(power))
        return Normaliser(mean.astype(np.float32), np.maximum(size, 1e-6).astype(np.float32))

    def inward(self, positions):
        """What the network sees of positions (..., joint, 3)."""
        return (positions - self.mean) / self.scale

    def outward(self, values):
        """Positions (..., joint, 3) of what the network says."""
        return values * self.scale + self.mean


def place(
    positions: np.ndarray,
    seen: np.ndarray,
    skeleton: Skeleton,
    convention: Convention,
    fps: float,
    mean: np.ndarray | None = None,
    smoothed: bool = False,
) -> Placement:
    """Where the body of a clip is, from complete positions (frame, joint, 3) of which only the joints `seen` count.

    Where the root is not among them, it is where the `mean` pose (joint, 3), turned by the heading, fits the joints
    seen on average. `smoothed`: the origin as well.
    """
    heading = np.zeros(len(positions))
    if convention.heading == "removed":
        heading = _heading(positions, seen, skeleton, fps)
    root = skeleton.parents.index(-1)
    if seen[root] or mean is None:
        origin = positions[:, root].copy()
    else:
        pose = _turned(np.broadcast_to(mean, positions.shape), heading)
        origin = (positions - pose)[:, seen].mean(1)
    if smoothed:
        origin = gaussian_filter1d(origin, ORIGIN_SPREAD * fps, axis=0, mode="nearest")
    if convention.origin == "ground":
        origin[:, 1] = np.quantile(positions[:, seen, 1], 0.01)
    return Placement(origin, heading)


def _heading(positions: np.ndarray, seen: np.ndarray, skeleton: Skeleton, fps: float) -> np.ndarray:
    """(frame,) in radians: 0 where the body's left is +x, that is where it faces +z."""
    sided = {joint for pair in skeleton.mirror for joint in pair}
    parents = skeleton.parents
    across = np.zeros((len(positions), 3))
    for left, right in skeleton.mirror:
        if parents[left] not in sided and seen[left] and seen[right]:
            across += positions[:, left] - positions[:, right]
    across = gaussian_filter1d(across, HEADING_SPREAD * fps, axis=0, mode="nearest")
    return np.arctan2(-across[:, 2], across[:, 0])


def _turned(positions: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Positions (frame, joint, 3) turned about y by angle (frame,)."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], -1)
