"""The models by name: how each is made, how it wants its motion, and the stages of its training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from motionrecover.refine import bra, bra_dgn, losses
from motionrecover.refine.bra import BRA
from motionrecover.refine.bra_dgn import BRADGN
from motionrecover.refine.bra_p import BRAP
from motionrecover.refine.cnn import CNN
from motionrecover.refine.ebf import EBF
from motionrecover.refine.layers import Running
from motionrecover.refine.losses import LossWeights
from motionrecover.refine.missing_marker import LSTMNet, WindowNet
from motionrecover.refine.normalise import CHOI, LI, Convention, Normaliser
from motionrecover.skeleton import Skeleton

Part = Literal["all", "perceptual", "denoiser"]


@dataclass(frozen=True)
class Stage:
    """Epochs of training with the same settings."""

    epochs: int
    rate: float
    weights: LossWeights
    trains: Part = "all"
    """Of BRA-P, the one autoencoder; the other stays as it is."""
    graph: bool = True
    """Whether incidence is learnt."""


@dataclass(frozen=True)
class Model:
    """A network by name."""

    name: str
    description: str
    make: Callable[[Skeleton, np.random.Generator, bool], eqx.Module]
    """Of the skeleton, a generator of random numbers, and whether it is to be small."""
    stages: tuple[Stage, ...]
    convention: Convention = CHOI
    terms: Callable = losses.choi
    batch: int = 16


def _staged(bone: float, smooth: float, graph: bool = False) -> tuple[Stage, ...]:
    """Table 1 of Choi et al. 2024: 200, 100 and 100 epochs, bones from the first, smoothness from the second on.

    The rate falls after ten epochs, as in the published code. `graph`: incidence rests for 50 epochs.
    """
    first = LossWeights(bone=bone * 1e-4)
    return (
        Stage(10, 1e-3, first, graph=not graph),
        Stage(40, 1e-4, first, graph=not graph),
        Stage(150, 1e-4, first),
        Stage(100, 1e-4, LossWeights(bone=bone * 1e-4, smooth=smooth * 3e-4)),
        Stage(100, 1e-4, LossWeights(bone=bone * 5e-4, smooth=smooth * 5e-4)),
    )


def _two_steps(constrained: bool) -> tuple[Stage, ...]:
    """Sec. III-D of Li et al. 2020: the perceptual autoencoder on clean motion, then the denoiser."""
    first, second = LossWeights(), LossWeights(perceptual=10)
    if constrained:
        first, second = replace(first, bone=1e-4, smooth=1e-4), replace(second, bone=1e-3, smooth=1e-3)
    return Stage(300, 1e-5, first, trains="perceptual"), Stage(300, 1e-3, second, trains="denoiser")


_POSITION, _BONES, _BOTH, _GRAPH = _staged(0, 0), _staged(1, 0), _staged(1, 1), _staged(1, 1, graph=True)
_SMALL = (64, 96, 168)
_SMALL_GRAPH = 8
"""Features at the LSTMs."""


def _bra(skeleton, rng, small):
    return BRA.make(len(skeleton.names), rng, _SMALL if small else bra.WIDTHS)


def _bra_p(widths=bra.WIDTHS, post_pass=True):
    small = _SMALL[-len(widths) :]
    return lambda skeleton, rng, is_small: BRAP.make(len(skeleton.names), rng, small if is_small else widths, post_pass)


def _bra_dgn(blocks=3, edge_update="paper"):
    widths = bra_dgn.WIDTHS[blocks]
    return lambda skeleton, rng, small: BRADGN.make(
        skeleton, rng, (*widths[:-1], _SMALL_GRAPH) if small else widths, edge_update=edge_update
    )


def _cnn(constrained):
    def make(skeleton, rng, small):
        return CNN.make(
            len(skeleton.names), rng, 64 if small else 256, constrained=skeleton.edges if constrained else ()
        )

    return make


def _ebf(skeleton, rng, small):
    return EBF.make(len(skeleton.names), rng, _SMALL if small else bra.WIDTHS)


def _window(skeleton, rng, small):
    return WindowNet.make(len(skeleton.names), rng, 256 if small else 1024)


def _lstm(skeleton, rng, small):
    return LSTMNet.make(len(skeleton.names), rng, 256 if small else 2048)


_KUCHERENKO = (Stage(150, 5e-4, LossWeights()),)

MODELS = {
    model.name: model
    for model in (
        Model("bra", "bidirectional recurrent autoencoder (Li 2019, as Choi 2024 compares)", _bra, _BOTH),
        Model("ebd", "bra trained on positions alone", _bra, _POSITION),
        Model("bra-dgn", "directed graph blocks, 3 (Choi 2024)", _bra_dgn(), _GRAPH),
        Model("bra-dgn-2", "... 2 blocks", _bra_dgn(2), _GRAPH),
        Model("bra-dgn-4", "... 4 blocks", _bra_dgn(4), _GRAPH),
        Model("bra-dgn-5", "... 5 blocks", _bra_dgn(5), _GRAPH),
        Model("bra-dgn-released", "... edges from edges, as in the published code", _bra_dgn(3, "released"), _GRAPH),
        Model("ebd-dgn", "bra-dgn trained on positions alone", _bra_dgn(), _staged(0, 0, graph=True)),
        Model("bra-p", "perceptual autoencoder and denoiser (Li 2020)", _bra_p(), _two_steps(True), LI, losses.li),
        Model("bra-p-256", "... two layers on either side", _bra_p((128, 256)), _two_steps(True), LI, losses.li),
        Model("bra-p-d", "... without the post-pass", _bra_p(post_pass=False), _two_steps(True), LI, losses.li),
        Model("ebd-p", "... without bone and smoothness losses", _bra_p(), _two_steps(False), LI, losses.li),
        Model("cnn", "convolutional autoencoder (Holden 2016)", _cnn(False), _POSITION),
        Model("cnn+constraint", "... moved onto bone lengths", _cnn(True), _POSITION),
        Model("ebf", "filters by a recurrent network (Mall 2017)", _ebf, _POSITION),
        Model("ebf+b", "... with the bone-length loss", _ebf, _BONES),
        Model("missing-marker-window", "ten frames at once (Kucherenko 2018)", _window, _KUCHERENKO, batch=32),
        Model("missing-marker-lstm", "LSTM forward in time (Kucherenko 2018)", _lstm, _KUCHERENKO, batch=64),
    )
}


def find(name: str) -> Model:
    """The model of a name. Raises `ValueError` for an unknown one."""
    if name not in MODELS:
        raise ValueError(f"received the model {name!r}: give one of {', '.join(MODELS)}")
    return MODELS[name]


def refined(network: Any, x: Array, observed: Array, normaliser: Normaliser) -> Array:
    """What a network makes of normalised windows; that of `cnn+constraint` has to know what a length is."""
    if isinstance(network, CNN) and network.constrained:
        return network.constrain(x, observed, normaliser.outward)
    return network(x, observed)[0]


def is_parameter(model: eqx.Module) -> eqx.Module:
    """For `eqx.partition`: True for what is learnt, False for running statistics and everything static."""
    return jax.tree.map(
        lambda leaf: not isinstance(leaf, Running), model, is_leaf=lambda leaf: isinstance(leaf, Running)
    )


def parameter_count(name: str, skeleton: Skeleton | None = None, small: bool = False) -> int:
    """Numbers that are learnt, for the 21 joints of the papers or another skeleton."""
    network = find(name).make(skeleton or Skeleton.standard("cmu21"), np.random.default_rng(0), small)
    return sum(leaf.size for leaf in jax.tree.leaves(eqx.filter(network, is_parameter(network))))
