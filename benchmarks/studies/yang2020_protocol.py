"""What the reproduction of Yang et al. 2020 runs: clips, their corruption, and ways to solve that no preset has."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import reference
from motionrecover import corrupt, intake, metrics
from motionrecover.io import load
from motionrecover.motion import Motion
from motionrecover.presets import PRESETS
from motionrecover.recovery import bucket, recover
from motionrecover.skeleton import Skeleton
from motionrecover.solver import solve

SEED = 2020
STR = PRESETS["str_yang2020"]
WHOLE = {name: replace(preset, window=None) for name, preset in PRESETS.items()}
"""The models on the whole clip at once, as the paper describes them; the presets take long clips in windows."""
PIECE = 300
"""Frames. "It is better to take 50 to 300 frames" (Sec. IV-A4)."""


@dataclass(frozen=True)
class Plan:
    """What a run covers."""

    subjects: dict[str, tuple[str, ...]]
    rates: tuple[int, ...] = (5, 10, 15, 20, 80)
    few: tuple[str, ...] = ("05_02", "05_10", "09_01", "09_05")
    """Clips of the start and penalty variants and of the sweeps; their first `PIECE` frames."""
    curves: tuple[str, ...] = ("05_02", "09_01", "09_12")
    whole: tuple[str, ...] = ("05_02", "05_12", "05_18", "09_12")
    """Clips whose whole length is compared with its first `PIECE` frames, in energy."""
    bvh: tuple[str, ...] = ("05_01", "05_14")
    factors: tuple[float, ...] = (0.25, 0.5, 1.0, 1.5, 2.0, 4.0, 8.0)
    """lambda as a multiple of 1 / sqrt(T)."""
    gammas: tuple[float, ...] = (0.1, 1.0, 10.0, 100.0, 1e3, 1e4)
    mus: tuple[float, ...] = (1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3)
    lengths: tuple[int, ...] = (272, 584, 1100, 6784)
    repeats: int = 7


FULL = Plan({"05": tuple(f"05_{k:02}" for k in range(1, 21)), "09": tuple(f"09_{k:02}" for k in range(1, 13))})
QUICK = Plan(
    subjects={"09": ("09_03", "09_08")},
    rates=(5, 20),
    few=("09_03",),
    curves=("09_03",),
    whole=("09_03",),
    bvh=(),
    factors=(1.0,),
    gammas=(10.0,),
    mus=(0.1,),
    lengths=(128,),
    repeats=1,
)


@dataclass(frozen=True, eq=False)
class Clip:
    """The truth: positions (frame, joint, 3), and what the protocol lets a method know."""

    name: str
    positions: np.ndarray
    skeleton: Skeleton
    lengths: np.ndarray
    """Bone lengths, the median over the frames of the truth."""

    def corrupted(self, rate: int, model=corrupt.joints, amplitude: float = 0.25) -> tuple[np.ndarray, np.ndarray]:
        """D at `rate` per cent, and the mask of what was hit: the same for every method."""
        seed = np.random.default_rng([SEED, int(self.name.replace("_", "")), rate])
        return model(self.positions, rate / 100, amplitude, seed)

    def score(self, positions: np.ndarray) -> tuple[float, float]:
        """AJE and ABE in thousandths of the unit."""
        aje = metrics.aje(positions, self.positions)
        return round(1000 * aje, 2), round(1000 * metrics.abe(positions, self.lengths, self.skeleton), 2)

    def head(self, frames: int) -> Clip:
        """The first frames; the bone lengths stay."""
        return replace(self, positions=self.positions[:frames])


def cmu25(name: str, folder: Path) -> Clip:
    """A clip of the ASF/AMC files on the 25 joints without hands and fingers."""
    motion = load(folder / "cmu" / "npz" / f"{name}.npz")
    return clip_of(name, motion.select(Skeleton.standard("cmu25").names))


def clip_of(name: str, motion: Motion) -> Clip:
    """The motion as a truth."""
    positions = motion.positions.astype(float)
    return Clip(name, positions, motion.skeleton, np.median(motion.skeleton.bone_lengths_of(positions), 0))


def preset_positions(preset, clip: Clip, data: np.ndarray, dtype=np.float32) -> np.ndarray:
    """The answer of the public front door with the true bone lengths, NaN where the solver failed."""
    return recover(data, clip.skeleton, preset=preset, bone_lengths=clip.lengths, dtype=dtype, throw=False).positions


def variant(preset, clip: Clip, data: np.ndarray, *, centre=True, zero=False, penalties="data", dtype=np.float32):
    """Positions, and the energy after each step, for starts and penalties that no preset has.

    `penalties="printed"`: rho = 0.5, eta = 1.3 without an end, which is up to 1e6, at most 100 steps.
    """
    taken = intake.take_in(data, clip.skeleton, bone_lengths=clip.lengths, centre=centre)
    with jax.enable_x64(True):
        problem, origin = taken.problem(slice(0, len(data)), bucket(len(data)), np.dtype(dtype))
        solver = replace(preset.solver(problem), zero_start=zero)
        if penalties == "printed":
            solver = replace(solver, penalty=jnp.full(3, 0.5, dtype), penalty_max=jnp.full(3, 1e6, dtype))
        solution = _solve(solver, problem, 100 if penalties == "printed" else preset.max_steps)
        energy = np.asarray(solution.trace.objective)[: int(solution.steps)]
        return taken.restore(solution.positions, len(data)) + origin, energy


_solve = jax.jit(solve, static_argnums=2)


def energy(preset, clip: Clip, data: np.ndarray, positions: np.ndarray) -> float:
    """Eq. 7 of Yang et al. 2020 at any positions, under the origin and the weights of the preset.

    The number of frames must be divisible by 4.
    """
    origin = np.median(data.reshape(-1, 3), 0)
    matrix, error = intake.matrix_from(positions - origin), intake.matrix_from(data - positions)
    residual, _ = reference.linearise(matrix, clip.skeleton.edges, clip.lengths)
    return (
        np.linalg.svd(matrix, compute_uv=False).sum()
        + preset.outlier_weight / np.sqrt(len(data)) * np.abs(error).sum()
        + preset.isometry_weight / 2 * residual @ residual
        + preset.smoothness_weight * np.abs(reference.wavedec(matrix, preset.wavelet, preset.level)).sum()
    )
