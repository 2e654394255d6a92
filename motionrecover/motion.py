"""Motion: a recorded or recovered clip, with everything that gives its numbers a meaning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionrecover.rig import Rig
from motionrecover.skeleton import FARTHEST, Skeleton
from motionrecover.source import Source

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Metres in one unit."""

UP_AXES = ("x", "y", "z")

SLOWEST, FASTEST = 1e-6, 1e6
"""Frames a second."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A clip: joint positions over time on a skeleton.

    `positions` is (frame, joint, 3) in metres with y up, NaN where nothing was measured. `observed` (frame, joint) is
    True where a joint was measured; left out, it is True where the position is finite. `confidence` (frame, joint)
    in [0, 1] says how far a measurement is to be trusted, NaN or None where the source does not say. `fps` is frames a
    second. `unit` (metres in one unit) and `up` (x, y or z) describe the file that the clip came from. `history`
    tells what was read, assumed and done, in order. `rig` is the hierarchy with channels of the BVH file that the clip
    came from, on which it can be written again; it may have more joints than the clip. `source` is the file that the
    clip came from, in formats that hold more than a motion and write it back.

    Raises `ValueError` for misshapen positions, positions farther than `FARTHEST` from the origin, unusable masks and
    an unusable frame rate.
    """

    positions: np.ndarray
    skeleton: Skeleton
    fps: float
    observed: np.ndarray = None  # pyright: ignore[reportAssignmentType]  # filled in below
    confidence: np.ndarray | None = None
    unit: float = 1.0
    up: str = "y"
    history: tuple[str, ...] = ()
    rig: Rig | None = None
    source: Source | None = None

    def __post_init__(self):
        positions = np.asarray(self.positions)
        if not np.issubdtype(positions.dtype, np.floating):
            positions = positions.astype(np.float64)
        joints = len(self.skeleton.names)
        if positions.ndim != 3 or positions.shape[1:] != (joints, 3):
            raise ValueError(
                f"received positions of shape {positions.shape}: "
                f"a skeleton of {joints} joints needs (frame, {joints}, 3)"
            )
        if len(positions) == 0:
            raise ValueError("received a clip of 0 frames: a motion needs at least one")
        refuse_far(positions, self.skeleton.names)
        if not SLOWEST <= self.fps <= FASTEST:
            raise ValueError(
                f"received a frame rate of {self.fps}: give frames a second, above 0 and up to {FASTEST:,.0f}"
            )
        if self.up not in UP_AXES:
            raise ValueError(f"received up axis {self.up!r}: give one of {', '.join(UP_AXES)}")
        finite = np.isfinite(positions).all(-1)
        observed = finite if self.observed is None else np.asarray(self.observed, bool)
        for name, mask in (("observed", observed), ("confidence", self.confidence)):
            if mask is not None and np.shape(mask) != finite.shape:
                raise ValueError(
                    f"received {name} of shape {np.shape(mask)}: the clip has (frame, joint) = {finite.shape}"
                )
        if self.confidence is not None and ((self.confidence < 0) | (self.confidence > 1)).any():
            raise ValueError("received a confidence outside 0 (ignore) to 1 (trust)")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "fps", float(self.fps))
        object.__setattr__(self, "observed", observed & finite)

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names."""
        return self.skeleton.names

    @property
    def seconds(self) -> float:
        """Length of the clip."""
        return len(self.positions) / self.fps

    def __len__(self) -> int:
        return len(self.positions)

    def with_positions(self, positions: np.ndarray, note: str, **changes) -> Motion:
        """The same clip with other positions (frame, joint, 3), and a line of history that says why."""
        changes = {"observed": None, "confidence": None} | changes
        return replace(self, positions=positions, history=(*self.history, note), **changes)

    def select(self, names: Sequence[str]) -> Motion:
        """The named joints only, each tied to its nearest kept ancestor. Raises `ValueError` for unknown names."""
        skeleton = self.skeleton.select(names)
        kept = [self.names.index(name) for name in names]
        return replace(
            self,
            positions=self.positions[:, kept],
            skeleton=skeleton,
            observed=self.observed[:, kept],
            confidence=None if self.confidence is None else self.confidence[:, kept],
            history=(*self.history, f"kept {len(kept)} of {len(self.names)} joints"),
        )


def refuse_far(positions: np.ndarray, names: Sequence[str]) -> None:
    """Raise `ValueError` that names the first sample of positions (frame, joint, 3) beyond `FARTHEST`, if any is."""
    if max(np.fmax.reduce(positions, None, initial=0), -np.fmin.reduce(positions, None, initial=0)) > FARTHEST:
        frame, joint, axis = np.argwhere(np.abs(positions) > np.float64(FARTHEST))[0]
        value = positions[frame, joint, axis]
        what = "an infinite position" if np.isinf(value) else f"a position {abs(value):.3g} m from the origin"
        raise ValueError(
            f"received {what} at frame {frame}, joint {names[joint]!r}: mark missing samples as NaN, state the unit"
        )
