"""Rig: a hierarchy with channels and their values, as a BVH file holds them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Rig:
    """Joints that move by channels: what a motion needs, beside its positions, to be written as BVH.

    Offsets and position channels are in the file's unit and axes, rotation channels in degrees. A position channel
    takes the place of that component of the joint's offset; rotations are multiplied in the order of the channels.
    """

    names: tuple[str, ...]
    """In file order: parents before their children."""
    parents: tuple[int, ...]
    """-1 marks a root."""
    offsets: np.ndarray
    """(joint, 3)."""
    channels: tuple[tuple[tuple[str, int], ...], ...]
    """(position or rotation, axis) of each channel of each joint."""
    ends: tuple[bool, ...]
    """Whether the joint is an end site, which the file does not name."""
    values: np.ndarray
    """(frame, channel)."""
    frame_time: float
    """Seconds, as the file says."""
    unit: float
    """Metres in one unit."""
    up: str

    @property
    def orders(self) -> tuple[str, ...]:
        """Each joint's order of rotations, a permutation of XYZ; the axes without a channel come last."""
        orders = ["".join("XYZ"[axis] for kind, axis in own if kind == "rotation") for own in self.channels]
        return tuple(order + "".join(axis for axis in "XYZ" if axis not in order) for order in orders)

    @property
    def turns(self) -> np.ndarray:
        """Number of rotation channels (joint,)."""
        return np.array([sum(kind == "rotation" for kind, _ in own) for own in self.channels])

    @property
    def moves(self) -> np.ndarray:
        """Which axes have a position channel (joint, 3)."""
        return np.array([[("position", axis) in own for axis in range(3)] for own in self.channels])

    def split(self) -> tuple[np.ndarray, np.ndarray]:
        """Translations (frame, joint, 3) in the file's unit, and angles (frame, joint, 3) in radians in `orders`."""
        translations = np.broadcast_to(self.offsets, (len(self.values), *self.offsets.shape)).copy()
        angles = np.zeros_like(translations)
        for column, (part, joint, axis) in enumerate(self._columns()):
            if part == "position":
                translations[:, joint, axis] = self.values[:, column]
            else:
                angles[:, joint, axis] = np.radians(self.values[:, column])
        return translations, angles

    def moved(self, translations: np.ndarray, angles: np.ndarray) -> Rig:
        """The same rig with the values of these translations and angles, as `split` gives them."""
        columns = [
            translations[:, joint, axis] if part == "position" else np.degrees(angles[:, joint, axis])
            for part, joint, axis in self._columns()
        ]
        return replace(self, values=np.stack(columns, -1))

    def frames(self, part: slice) -> Rig:
        """The same rig in some of the frames."""
        return replace(self, values=self.values[part])

    def _columns(self):
        """(position, joint, axis) or (rotation, joint, place in the joint's order) of each column of the values."""
        for joint, own in enumerate(self.channels):
            turned = 0
            for kind, axis in own:
                yield kind, joint, axis if kind == "position" else turned
                turned += kind == "rotation"
