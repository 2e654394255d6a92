"""Training: from a folder of clips to a file of weights, stopped and resumed at will.

A step depends on its number, the seed and what the last step left: the windows of its batch are those of the epoch's
permutation, its corruption and dropout are drawn from fold_in(key, step) inside the compiled step. So a run that was
killed goes on from its last checkpoint as if nothing had happened, bit for bit.

    RUN/config.json              what the run is; a run of something else is refused
    RUN/log.csv                  mean losses since the line before, and errors on held-out windows
    RUN/checkpoint.safetensors   network, Adam's moments and number of steps done; always whole
    RUN/weights.safetensors      the network, when the run is done
"""

from __future__ import annotations

import csv
import json
import math
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from motionrecover.io.atomic import write_beside
from motionrecover.refine import corruptions, models, weights
from motionrecover.refine.data import Windows, evenly, read_clips, split
from motionrecover.refine.identity import as_identity
from motionrecover.refine.models import Model, Part
from motionrecover.refine.normalise import Normaliser
from motionrecover.refine.schedule import PRESETS, Phase, Preset, plan, rate_at
from motionrecover.refine.step import Given, Task, fresh_moments, step
from motionrecover.skeleton import Skeleton

CHECKPOINT = 5
"""Lines of the log from checkpoint to checkpoint."""
HELD_OUT_BATCHES = 8
"""That a checkpoint is measured on."""
_NOTHING: dict[str, float] = dict.fromkeys(("loss", "position", "distance", "bone", "smooth", "perceptual"), 0.0)


class TrainingError(ValueError):
    """Training cannot start or go on: one sentence that says why, and what is left."""


@dataclass(frozen=True)
class Settings:
    """What a run is."""

    model: str
    protocol: str
    preset: Literal["small", "identity", "paper"] = "small"
    """Of `schedule.PRESETS`."""
    split: Literal["subject", "window"] = "subject"
    held_out: tuple[str, ...] = ()
    """Subjects; none: drawn by the seed."""
    steps: int | None = None
    """Of the whole run; None: as the preset says."""
    batch: int | None = None
    """Windows a step; None: as published."""
    heading: Literal["removed", "kept"] | None = None
    """None: as published."""
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Run:
    """A run that is set up: its data, network and plan."""

    settings: Settings
    model: Model
    skeleton: Skeleton
    normaliser: Normaliser
    trained: Windows
    held_out: Windows
    phases: list[Phase]
    folder: Path
    config: dict[str, Any]

    @property
    def preset(self) -> Preset:
        """How it is trained."""
        return PRESETS[self.settings.preset]

    @property
    def batch(self) -> int:
        """Windows a step."""
        return self.settings.batch or self.model.batch

    @property
    def total(self) -> int:
        """Steps."""
        return self.phases[-1].stop

    @property
    def every(self) -> int:
        """Steps a line of the log; a fifth one has a checkpoint."""
        return min(500, max(1, self.total // 100))


def set_up(settings: Settings, data: str | Path, out: str | Path, skeleton: Skeleton, resume: bool = False) -> Run:
    """Read the clips, and make the folder of the run or find the one to resume.

    Raises `TrainingError` for a folder that belongs to another run or has nothing to resume, `ValueError` for unusable
    settings or data.
    """
    model, preset, folder = models.find(settings.model), PRESETS[settings.preset], Path(out)
    corruptions.protocol(settings.protocol)
    if preset.identity:  # refuses other networks before there is a folder
        as_identity(model.make(skeleton, np.random.default_rng(0), preset.narrow))
    convention = model.convention
    if settings.heading is not None:
        convention = replace(convention, heading=settings.heading)
    if resume and not (folder / "config.json").is_file():
        raise TrainingError(f"{folder} holds no run to resume: leave --resume out to start one")
    if not resume and folder.is_dir() and any(folder.iterdir()):
        raise TrainingError(f"{folder} holds files already: resume its run (--resume), or give another folder")
    clips = read_clips(data, skeleton, convention)
    trained, held_out = split(clips, convention.window, settings.split, settings.held_out, settings.seed)
    batch = settings.batch or model.batch
    epoch = trained.batches(batch)
    if not epoch:
        raise ValueError(
            f"received {len(trained)} windows to train on: a batch needs {batch}, give more or smaller batches"
        )
    used = [clips.positions[c] for c in sorted(set(trained.where[:, 0].tolist()))]
    config = {
        **asdict(settings),
        "joints": list(skeleton.names),
        "bones": [list(bone) for bone in skeleton.edges],
        "convention": asdict(convention),
        "small": preset.narrow,
        "clips": clips.digest,
        "windows": len(trained),
        "held_out_windows": len(held_out),
        "held_out_subjects": sorted({clips.subjects[c] for c, _ in held_out.where})
        if settings.split == "subject"
        else [],
    }
    config = json.loads(json.dumps(config))
    if resume:
        _same_run(folder, config)
    else:
        folder.mkdir(parents=True, exist_ok=True)
        with write_beside(folder / "config.json") as temporary:
            temporary.write_text(json.dumps(config, indent=1) + "\n", encoding="utf-8")
    normaliser = Normaliser.of(used, convention.scale)
    phases = plan(model, preset, epoch, settings.steps)
    return Run(settings, model, skeleton, normaliser, trained, held_out, phases, folder, config)


def _same_run(folder: Path, config: dict[str, Any]) -> None:
    try:
        there = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    except ValueError as error:
        raise TrainingError(f"{folder / 'config.json'} is no JSON: start a new run in another folder") from error
    for name in config | there:
        if config.get(name) != there.get(name):
            raise TrainingError(
                f"{folder} belongs to a run with {name} {there.get(name)!r}, not {config.get(name)!r}: "
                "resume it with its own settings and data, or give another folder"
            )


def train(run: Run, *, seconds: float = math.inf) -> Iterator[dict[str, Any]]:
    """Train, from the last checkpoint if there is one; yields each line of the log as it is written.

    Ends when the run is done, with weights written, or with a checkpoint after `seconds`. Raises `TrainingError` that
    names the last good checkpoint when a loss or a weight is no longer finite.
    """
    began, settings = time.monotonic(), run.settings
    key = jax.random.key(settings.seed)
    network = run.model.make(run.skeleton, np.random.default_rng(settings.seed), run.preset.narrow)
    if run.preset.identity:
        network = as_identity(network)
    network, moments, part, done = _resumed(run, network)
    _cut_log(run.folder / "log.csv", done)
    so_far, line_began = _arrays(_NOTHING), done
    for phase in run.phases:
        if done >= phase.stop:
            continue
        if phase.stage.trains != part:
            part, moments = phase.stage.trains, fresh_moments(network, phase.stage.trains)
        task = Task(
            run.model.name,
            settings.protocol,
            run.skeleton,
            phase.stage.trains,
            batch_statistics=not run.preset.identity,
            augmented=run.preset.augmented,
        )
        while done < phase.stop:
            given = Given(
                task,
                jnp.asarray(run.normaliser.mean),
                jnp.asarray(run.normaliser.scale),
                clean=jnp.asarray(run.trained.batch(done, run.batch, settings.seed)),
                key=jax.random.fold_in(key, done),
                rate=jnp.float32(rate_at(done, run.phases, run.preset)),
                graph=jnp.float32(phase.stage.graph),
                weights=_arrays(asdict(phase.stage.weights)),
                so_far=so_far,
            )
            network, moments, so_far = step(given, network, moments)
            done += 1
            if done % run.every and done != run.total:
                continue
            late = time.monotonic() - began > seconds
            keeps = late or done == run.total or done % (CHECKPOINT * run.every) == 0
            line = {
                "step": done,
                "epoch": round(done / run.trained.batches(run.batch), 3),
                "rate": rate_at(done - 1, run.phases, run.preset),
                "seconds": round(time.monotonic() - began, 1),
                **{name: float(so_far[name]) / (done - line_began) for name in _NOTHING},
            }
            if not math.isfinite(line["loss"]) or (keeps and not _finite(network)):
                raise TrainingError(_broken(run, done))
            line |= held_out_errors(run, network) if keeps else dict.fromkeys(ERRORS, "")
            _write_line(run.folder / "log.csv", line)
            if keeps:
                save(run, network, run.folder / "checkpoint.safetensors", moments, done, line)
            if done == run.total:
                save(run, network, run.folder / "weights.safetensors", None, done, line)
            so_far, line_began = _arrays(_NOTHING), done
            yield line
            if late:
                return


ERRORS = ("held_out_mm", "held_out_missing_mm", "mean_pose_missing_mm")


def held_out_errors(run: Run, network: eqx.Module) -> dict[str, float]:
    """Mean joint errors in millimetres on held-out windows under the run's protocol, the same windows every time.

    Of all samples, of those missing, and of those missing where the mean pose is put.
    """
    normaliser, found = run.normaliser, []
    for k, clean in enumerate(evenly(run.held_out, run.batch, HELD_OUT_BATCHES)):
        key = jax.random.fold_in(jax.random.key(run.settings.seed + 1), k)
        mean, scale, clean = (jnp.asarray(each) for each in (normaliser.mean, normaliser.scale, clean))
        found.append(_errors(network, run.settings.protocol, mean, scale, clean, key))
    everywhere, missing, filled, lost = np.mean(found, 0)
    return dict(zip(ERRORS, (float(everywhere), float(missing / lost), float(filled / lost)), strict=True))


@eqx.filter_jit
def _errors(network, protocol, mean, scale, clean, key):
    normaliser = Normaliser(mean, scale)
    noisy, observed = corruptions.protocol(protocol)(key, clean, normaliser.mean)
    y = normaliser.outward(models.refined(network, normaliser.inward(noisy), observed, normaliser))
    off = 1000 * jnp.linalg.norm(y - clean, axis=-1)
    filled = 1000 * jnp.linalg.norm(normaliser.mean - clean, axis=-1)
    lost = ~observed
    return off.mean(), (off * lost).mean(), (filled * lost).mean(), lost.mean()


def save(run: Run, network: eqx.Module, path: Path, moments: Any, done: int, line: dict[str, Any]) -> None:
    """Write weights, and with `moments` a checkpoint."""
    tensors = weights.tensors_of(network, "model.")
    tensors |= {"normaliser.mean": run.normaliser.mean, "normaliser.scale": run.normaliser.scale}
    if moments is not None:
        tensors |= weights.tensors_of(moments, "adam.")
    weights.save_tensors(path, tensors, {**run.config, "step": done, "log": line}, overwrite=True)


def _resumed(run: Run, network: eqx.Module) -> tuple[eqx.Module, Any, Part | None, int]:
    """Network, moments, what they belong to, and number of steps done: of the last checkpoint or of the start."""
    path = run.folder / "checkpoint.safetensors"
    if not path.is_file():
        return network, None, None, 0
    tensors, facts = weights.load_tensors(path)
    done = int(facts["step"])
    part = next(phase for phase in run.phases if done <= phase.stop).stage.trains
    network = weights.tensors_into(network, tensors, "model.", path)
    return network, weights.tensors_into(fresh_moments(network, part), tensors, "adam.", path), part, done


def _arrays(numbers: dict[str, float]) -> dict[str, jax.Array]:
    return {name: jnp.float32(number) for name, number in numbers.items()}


def _finite(network: eqx.Module) -> bool:
    return all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(eqx.filter(network, eqx.is_inexact_array)))


def _broken(run: Run, done: int) -> str:
    path = run.folder / "checkpoint.safetensors"
    if not path.is_file():
        return f"the loss is no longer finite within {done} steps, before the first checkpoint: check the data"
    return (
        f"the loss is no longer finite at step {done}: the last good checkpoint is {path} of step "
        f"{weights.load_tensors(path)[1]['step']}, which refines as it is"
    )


def _write_line(path: Path, line: dict[str, Any]) -> None:
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(line))
        if new:
            writer.writeheader()
        writer.writerow(line)


def _cut_log(path: Path, done: int) -> None:
    """Leave out lines of steps after the checkpoint: they come again."""
    if not done:
        path.unlink(missing_ok=True)
        return
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    kept = [row for k, row in enumerate(rows) if k == 0 or (len(row) == len(rows[0]) and int(row[0]) <= done)]
    with write_beside(path, overwrite=True) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(kept)
