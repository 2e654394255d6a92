"""A trained network on a clip of any rate, length and joint order.

1. Joints are found by name, in any spelling that `io.bones` knows.
2. The clip comes to the model's rate, is moved about the body and normalised; missing samples are blanked.
3. Windows that overlap by half are refined, and blended with weights that fall linearly towards their ends.
4. The answer goes back into the world and to the clip's rate.
5. Where the input is free of noise, observed samples are kept, and between them the answer is bent to meet them: what
   it is off by there is interpolated in time and taken away.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from motionrecover import windows
from motionrecover.intake import check, fill
from motionrecover.io.bones import plain_name
from motionrecover.refine import models, weights
from motionrecover.refine.normalise import Convention, Normaliser, place
from motionrecover.refine.sampling import resample, spans
from motionrecover.skeleton import Skeleton

CHUNK = 16
"""Windows that are refined at once, so that clips of any length share a program."""
NOISE_FREE = 0.003
"""Metres. The networks are off by a centimetre or more where they were told the truth: below this, what was observed is
better."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """What a refiner made of a clip."""

    positions: np.ndarray
    """(frame, joint, 3) in metres; joints that the model does not know are as they came, NaN where missing."""
    refined: np.ndarray
    """(joint,) True for those that the model knows."""
    kept: np.ndarray
    """(frame, joint) True where the observed sample was kept."""
    noise: float
    """Metres an axis, estimated from the input."""


@dataclass(frozen=True, eq=False)
class Refiner:
    """A network and what it needs to know: call it with a clip. `load_refiner` makes one."""

    name: str
    network: eqx.Module
    skeleton: Skeleton
    convention: Convention
    normaliser: Normaliser

    def __call__(
        self,
        data: Any,
        skeleton: Skeleton,
        *,
        observed: Any = None,
        fps: float,
        keep_observed: bool | None = None,
    ) -> Refinement:
        """Refined positions of `data` (frame, joint, 3) or (3 frames, joint) in metres, y up, NaN where missing.

        `observed` (frame, joint) says what is measured beyond that; `fps` is frames a second; `keep_observed` keeps
        observed samples as they are, None: where the input is free of noise.

        Raises `ValueError` for misshapen data, a skeleton that lacks joints of the model, and a clip without a sample.
        """
        if not (np.isfinite(fps) and fps > 0):
            raise ValueError(f"received a frame rate of {fps}: give frames a second, above 0")
        positions, _ = check(data, skeleton, observed)
        columns = self._columns(skeleton)
        known = positions[:, columns]
        measured = np.isfinite(known[..., 0])
        if not measured.any():
            raise ValueError(f"received a clip without a sample of the {len(columns)} joints that {self.name} knows")
        noise = noise_level(known)
        keep = noise < NOISE_FREE if keep_observed is None else keep_observed
        refined = self._refine(known, fps, smoothed=not keep)
        if keep:
            refined += fill(np.where(measured[..., None], known - refined, np.nan))
            refined = np.where(measured[..., None], known, refined)
        kept = np.isfinite(positions[..., 0])
        kept[:, columns] &= keep
        out = positions.copy()
        out[:, columns] = refined
        return Refinement(out, np.isin(np.arange(positions.shape[1]), columns), kept, noise)

    def compile(self) -> None:
        """Compile the program that all clips share, seconds, so that clips do not wait for it."""
        self._run(np.full((1, self.convention.window, len(self.skeleton.names), 3), np.nan, np.float32))

    def _columns(self, skeleton: Skeleton) -> list[int]:
        """Of the clip's joints those of the model, in its order."""
        there = {plain_name(name): column for column, name in enumerate(skeleton.names)}
        lost = [name for name in self.skeleton.names if plain_name(name) not in there]
        if lost:
            raise ValueError(
                f"received a skeleton without {', '.join(lost)}, which {self.name} was trained on: rename the joints "
                f"(its {len(self.skeleton.names)} are {', '.join(self.skeleton.names)}), or train it on this skeleton"
            )
        return [there[plain_name(name)] for name in self.skeleton.names]

    def _refine(self, positions: np.ndarray, fps: float, smoothed: bool) -> np.ndarray:
        """Steps 2 to 4 for positions (frame, joint, 3) of the model's joints."""
        rate, window = self.convention.fps, self.convention.window
        frames = int(np.ceil((len(positions) - 1) * rate / fps - 1e-6)) + 1
        measured = np.isfinite(positions[..., 0])
        clip = resample(fill(positions), fps, rate, frames)
        nearest = np.minimum(np.rint(np.arange(frames) * fps / rate).astype(int), len(positions) - 1)
        seen, mean = np.any(measured, axis=0), self.normaliser.mean
        placed = place(clip, seen, self.skeleton, self.convention, rate, mean, smoothed)
        about = np.where(measured[nearest][..., None], placed.inward(clip), np.nan)
        about = np.pad(about, ((0, max(window - frames, 0)), (0, 0), (0, 0)), constant_values=np.nan)
        cuts = spans(frames, window)
        values = np.stack([self.normaliser.inward(about[cut]) for cut in cuts]).astype(np.float32)
        answers = self.normaliser.outward(self._run(values).astype(np.float64))
        refined = placed.outward(windows.blend(list(answers), cuts)[:frames])
        return resample(refined, rate, fps, len(positions))

    def _run(self, values: np.ndarray) -> np.ndarray:
        """The network on windows (window, frame, joint, 3), NaN where missing, a chunk at a time."""
        padded = np.pad(values, ((0, -len(values) % CHUNK), (0, 0), (0, 0), (0, 0)), constant_values=np.nan)
        mean, scale = jnp.asarray(self.normaliser.mean), jnp.asarray(self.normaliser.scale)
        parts = [_forward(self.network, mean, scale, padded[k : k + CHUNK]) for k in range(0, len(padded), CHUNK)]
        return np.concatenate([np.asarray(part) for part in parts])[: len(values)]


def load_refiner(name_or_path: str | Path) -> Refiner:
    """The refiner of a file of weights, of the folder of a training run, or one by name that comes with the package.

    Raises `ValueError` for a name without weights, and `weights.WeightsError` for anything wrong with the file.
    """
    path = Path(name_or_path)
    if str(name_or_path) in models.MODELS and not path.exists():
        path = Path(__file__).parent / "trained" / f"{name_or_path}.safetensors"
        if not path.is_file():
            raise ValueError(
                f"no weights of {name_or_path!r} come with motionrecover: train it with `motionrecover train --model "
                f"{name_or_path} --data DIR --out RUN`, and give RUN"
            )
    if path.is_dir():
        found = [path / name for name in ("weights.safetensors", "checkpoint.safetensors") if (path / name).is_file()]
        if not found:
            raise weights.WeightsError(f"{path} is a folder without weights: give that of a training run")
        path = found[0]
    refiner = refiner_from(*weights.load_tensors(path), path)
    refiner.compile()
    return refiner


def refiner_from(tensors: dict[str, np.ndarray], facts: dict[str, Any], path: str | Path) -> Refiner:
    """The refiner that tensors and what is said of them (of `path`) make."""
    try:
        model = models.find(facts["model"])
        skeleton = Skeleton(facts["joints"], facts["bones"])
        convention, small = Convention(**facts["convention"]), bool(facts["small"])
        normaliser = Normaliser(tensors["normaliser.mean"], tensors["normaliser.scale"])
    except (KeyError, TypeError, ValueError) as error:
        raise weights.WeightsError(f"{path} does not say what it holds ({error}): train it again") from error
    network = weights.tensors_into(model.make(skeleton, np.random.default_rng(0), small), tensors, "model.", path)
    return Refiner(model.name, network, skeleton, convention, normaliser)


def noise_level(positions: np.ndarray) -> float:
    """Standard deviation of the noise an axis, in metres, from positions (frame, joint, 3); 0 where nothing tells.

    From the median of fourth differences, which hold 70 times the variance of white noise and hardly any motion.
    """
    differences = np.abs(np.diff(positions, 4, axis=0))
    differences = differences[np.isfinite(differences)]
    return float(np.median(differences) / (0.6745 * np.sqrt(70))) if len(differences) else 0.0


@eqx.filter_jit
def _forward(network, mean, scale, values):
    return models.refined(network, values, jnp.isfinite(values[..., 0]), Normaliser(mean, scale))
