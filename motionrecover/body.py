"""What the bones of a clip say before anything is solved, and the smoother that begins with it: for clips and streams.

1. Bones get their length, and how well it is kept (evidence.bone_lengths). The body's size is its median bone.
2. A clip is exact where lengths that should stay the same do: it has no noise to remove.
3. Where each frame keeps each length, as in a BVH file, lengths do not tell a thrown rotation from a true one:
   with their word for it, most of 0.3 % thrown rotations stay, 5 mm before and 3 mm after; without, 0.03 mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from motionrecover.evidence.bone_lengths import BoneLengths, evidence
from motionrecover.evidence.drive import estimate_drive
from motionrecover.solver import Smoother, SmootherState


@dataclass(frozen=True, eq=False)
class Body:
    """Bones as they were measured, and what follows from them."""

    bones: BoneLengths
    scale: float
    """Median bone length; the body's own spread where there are no bones; 1 where there is neither."""
    noise_max: float
    """Infinite where the bones themselves show noise: a mode's spread does not bound it. With it, still joints of a
    Kinect recording keep 2.6 mm of jitter, not 1."""
    tell: bool
    """Whether lengths tell intact samples from others at all."""

    @classmethod
    def of(cls, data: np.ndarray, lengths: np.ndarray, bones: BoneLengths) -> Body:
        """That of samples `data` (frame, joint, 3), NaN where missing, whose bones measure `lengths` (frame, bone)."""
        spread = bones.spread[bones.rigid] / np.sqrt(2)
        usual = float(np.quantile(spread, 0.25)) if len(spread) else np.inf
        scale = _scale(data, bones)
        floor = Smoother.FLOOR * scale
        tell = bool(np.nanmax(np.abs(lengths - bones.length), initial=0) > floor)
        return cls(bones, scale, usual if usual < floor else np.inf, tell)

    @property
    def exact(self) -> bool:
        """Whether the bones show no noise."""
        return bool(np.isfinite(self.noise_max))

    @property
    def outlier_share(self) -> float:
        """First guess of the share of samples that are outliers: a length agrees where both its ends are intact."""
        agreeing = np.median(self.bones.share[self.bones.rigid]) if self.bones.rigid.any() else 0.9
        return float(np.clip(1 - np.sqrt(agreeing), 0.02, 0.95))

    def evidence(self, lengths: np.ndarray) -> np.ndarray:
        """How many nats each measured length (frame, bone) speaks for two intact ends."""
        return evidence(lengths, self.bones) if self.tell else np.zeros(lengths.shape)

    def drive(self, positions: np.ndarray, observed: np.ndarray) -> np.ndarray:
        """First guess (joint,) of the variance of the second difference."""
        found = estimate_drive(positions, observed)
        # A hundredth of a bone a frame where no three samples in a row tell; what moves needs more than a 10^-5th.
        return np.where(np.isnan(found), (0.01 * self.scale) ** 2, np.maximum(found, (1e-5 * self.scale) ** 2))

    def smoother(
        self, told: np.ndarray, stored: int, drive: np.ndarray, tolerance: float, beliefs: SmootherState | None = None
    ) -> Smoother:
        """The solver of frames of which the bones have `told` (frame, bone), as `evidence` says, stored in so many."""

        def array(value) -> Any:  # of NumPy: JAX would convert each by a program of its own
            return np.asarray(value, np.float64)

        return Smoother(
            evidence=array(np.pad(told, ((0, stored - len(told)), (0, 0)))),
            drive=array(drive),
            scale=array(self.scale),
            outlier_share=array(self.outlier_share),
            noise_max=array(self.noise_max),
            tolerance=array(tolerance),
            beliefs=beliefs,
        )


def _scale(data, bones):
    lengths = bones.length[np.isfinite(bones.length) & (bones.length > 0)]
    if len(lengths):
        return float(np.median(lengths))
    known = data[np.isfinite(data).all(-1)]
    across = np.median(np.linalg.norm(known - np.median(known, 0), axis=-1)) if len(known) else 0
    return float(across) if across > 0 else 1.0
