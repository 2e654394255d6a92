"""One step of training: corrupt, refine, compare, and let Adam (Kingma & Ba 2015) change what a stage trains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax

try:
    import optax
except ImportError as error:
    raise ImportError("training needs optax and safetensors: pip install motionrecover[refine]") from error

from motionrecover.refine import corruptions, losses, models
from motionrecover.refine.augment import augmented
from motionrecover.refine.models import Part
from motionrecover.refine.normalise import Normaliser
from motionrecover.skeleton import Skeleton


def learnt(network: eqx.Module, part: Part) -> Any:
    """For `eqx.partition`: True for the parameters of the part that a stage trains."""
    spec = models.is_parameter(network)
    if part == "all":
        return spec
    nothing = jax.tree.map(lambda _: False, spec)
    return eqx.tree_at(lambda tree: getattr(tree, part), nothing, getattr(spec, part))


@dataclass(frozen=True)
class Task:
    """What a compiled step is for."""

    model: str
    protocol: str
    skeleton: Skeleton
    part: Part
    batch_statistics: bool = True
    """For batch normalisation, which else uses the running ones and leaves them."""
    augmented: bool = False


class Given(NamedTuple):
    """What a step is given beside network and moments."""

    task: Task
    mean: Any
    """With `scale` the normaliser's."""
    scale: Any
    clean: Any
    """Batch (window, frame, joint, 3) in metres."""
    key: Any
    rate: Any
    graph: Any
    """1 where incidence is learnt, else 0."""
    weights: dict[str, Any]
    so_far: dict[str, Any]
    """Losses since the last line of the log."""


@eqx.filter_jit(donate="all-except-first")
def step(given: Given, network: eqx.Module, moments: Any) -> tuple[eqx.Module, Any, dict[str, Any]]:
    """One step: the network, Adam's moments, and the losses so far with those of this step."""
    parameters, rest = eqx.partition(network, learnt(network, given.task.part))
    grads, (rest, terms) = jax.grad(_loss, has_aux=True)(parameters, rest, given)
    updates, moments = optax.scale_by_adam().update(_with_graph(grads, given.graph), moments)
    updates = _with_graph(jax.tree.map(lambda u: -given.rate * u, updates), given.graph)
    so_far = {name: total + terms.get(name, 0.0) for name, total in given.so_far.items()}
    return eqx.combine(eqx.apply_updates(parameters, updates), rest), moments, so_far


def _loss(parameters, rest, given):
    task, normaliser = given.task, Normaliser(given.mean, given.scale)
    network = eqx.combine(parameters, rest)
    drawn, inside = jax.random.split(given.key)
    clean = given.clean
    if task.augmented:
        clean = augmented(jax.random.fold_in(given.key, 1), clean, task.skeleton)
    noisy, observed = corruptions.protocol(task.protocol)(drawn, clean, normaliser.mean)
    x, noisy = normaliser.inward(clean), normaliser.inward(noisy)
    if not task.batch_statistics:
        inside = None
    if task.part == "perceptual":
        y, network = network.reproduce(x, inside)
    elif task.part == "denoiser":
        y, network = network.denoise(noisy, observed, inside)
    else:
        y, network = network(noisy, observed, inside)
    terms = models.find(task.model).terms(y, x, (normaliser.outward(y), clean), task.skeleton.edges)
    if task.part == "denoiser":
        terms["perceptual"] = losses.perceptual(network.perceive(y), network.perceive(x))
    total = sum(given.weights[name] * term for name, term in terms.items())
    return total, (eqx.filter(network, learnt(network, task.part), inverse=True), {"loss": total} | terms)


def _with_graph(tree: Any, graph: Any) -> Any:
    """The tree with what belongs to incidence multiplied by `graph`."""
    return jax.tree_util.tree_map_with_path(
        lambda path, leaf: leaf * graph if getattr(path[-1], "name", "") in ("sources", "targets") else leaf, tree
    )


def fresh_moments(network: eqx.Module, part: Part) -> Any:
    """Adam's moments of what a stage trains, before its first step."""
    return optax.scale_by_adam().init(eqx.filter(network, learnt(network, part)))
