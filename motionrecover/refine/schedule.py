"""What a preset makes of a model's published training: width, start, steps, rates and losses."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from motionrecover.refine.losses import LossWeights
from motionrecover.refine.models import Model, Stage

WARM_UP = 50


@dataclass(frozen=True)
class Preset:
    """How a model is trained."""

    narrow: bool = True
    """The small network, not the published size."""
    steps: int | None = None
    """Of the whole run; None: as many as the published epochs have. Stages keep their shares."""
    rate: float | None = None
    """After `WARM_UP` steps from 0 and before a cosine to a fiftieth, each autoencoder its own; None: as published."""
    weights: LossWeights | None = None
    """Of the losses in all stages; None: as published."""
    identity: bool = False
    """Start as the identity (`identity`), which batch normalisation by the statistics of a batch would undo: it uses
    running ones, and these stay."""
    augmented: bool = False
    """Other bodies than those recorded (`augment`)."""


PRESETS = {
    "small": Preset(steps=1500, rate=1e-3),
    "identity": Preset(
        steps=40000, rate=1e-3, weights=LossWeights(0, distance=1, bone=0.1), identity=True, augmented=True
    ),
    "paper": Preset(narrow=False),
}


@dataclass(frozen=True)
class Phase:
    """Consecutive steps of one stage."""

    first: int
    stop: int
    stage: Stage


def plan(model: Model, preset: Preset, epoch: int, steps: int | None = None) -> list[Phase]:
    """The phases of a run with `epoch` steps an epoch; `steps` in all or as the preset says, shared by the stages as
    their epochs are."""
    ends = np.cumsum([0, *(stage.epochs for stage in model.stages)])
    total = steps or preset.steps or int(ends[-1]) * epoch
    borders = [round(total * int(end) / int(ends[-1])) for end in ends]
    stages = [replace(stage, weights=preset.weights or stage.weights) for stage in model.stages]
    return [Phase(a, b, stage) for a, b, stage in zip(borders[:-1], borders[1:], stages, strict=True) if b > a]


def rate_at(step: int, phases: list[Phase], preset: Preset) -> float:
    """The learning rate of a step."""
    now = next(phase for phase in phases if step < phase.stop)
    if preset.rate is None:
        return now.stage.rate
    same = [phase for phase in phases if phase.stage.trains == now.stage.trains]
    done, total = step - same[0].first, same[-1].stop - same[0].first
    warm = min(1.0, (done + 1) / min(WARM_UP, total))
    return preset.rate * warm * (0.02 + 0.98 * (1 + math.cos(math.pi * done / total)) / 2)
