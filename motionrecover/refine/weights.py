"""Files of weights: safetensors with a JSON description, whole or not at all, and nothing in them that runs.

Tensors are named by their place in the model, `denoiser.encoder.0.weight`. The description holds the version of the
layout and a digest of all tensors, so that a file that was cut, changed or mixed up is told from a good one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from motionrecover.io.atomic import write_beside

VERSION = 1
_KEY = "motionrecover"
_Tree = TypeVar("_Tree")


class WeightsError(ValueError):
    """Something is wrong with a file of weights: one sentence that names it, and what to do."""


def save_tensors(
    path: str | Path, tensors: Mapping[str, np.ndarray], facts: Mapping[str, Any], *, overwrite: bool = False
) -> Path:
    """Write tensors and what is said of them (JSON) to `path`. Raises `FileExistsError` unless told to overwrite."""
    from safetensors.numpy import save_file

    described = json.dumps({"version": VERSION, "digest": _digest(tensors), **facts})
    with write_beside(path, overwrite=overwrite) as temporary:
        save_file(
            {name: np.asarray(tensor, order="C") for name, tensor in tensors.items()}, temporary, {_KEY: described}
        )
    return Path(path)


def load_tensors(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Tensors of a file and what is said of them. Raises `WeightsError` for anything but a whole file of this kind."""
    try:
        from safetensors import SafetensorError, safe_open
    except ImportError as error:
        raise ImportError("weights need safetensors: pip install motionrecover[refine]") from error
    path = Path(path)
    if not path.is_file():
        raise WeightsError(f"{path} does not exist: give a file of weights or the folder of a training run")
    try:
        with safe_open(path, "numpy") as file:
            described = (file.metadata() or {}).get(_KEY)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  not a dict
        facts = None if described is None else json.loads(described)
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise WeightsError(f"{path} is cut off or no safetensors file: fetch or train it again") from error
    if not isinstance(facts, dict) or "version" not in facts or "digest" not in facts:
        raise WeightsError(f"{path} holds tensors without a description of motionrecover: they are of another program")
    if facts["version"] != VERSION:
        raise WeightsError(
            f"{path} has version {facts['version']} of the layout, this motionrecover reads version {VERSION}: "
            "use the motionrecover that wrote it, or train again"
        )
    if facts["digest"] != _digest(tensors):
        raise WeightsError(f"{path} was changed after it was written: fetch or train it again")
    return tensors, facts


def tensors_of(tree: Any, prefix: str) -> dict[str, np.ndarray]:
    """The arrays of a tree by dotted names that start with `prefix`."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {prefix + _name(path): np.asarray(leaf) for path, leaf in leaves}


def tensors_into(tree: _Tree, tensors: Mapping[str, np.ndarray], prefix: str, path: str | Path) -> _Tree:
    """The tree with its arrays replaced by the tensors of their names.

    Raises `WeightsError` that names `path` where names, shapes or types do not fit.
    """
    leaves, structure = jax.tree_util.tree_flatten_with_path(tree)
    wanted = {prefix + _name(place): leaf for place, leaf in leaves}
    found = {name: tensor for name, tensor in tensors.items() if name.startswith(prefix)}
    if odd := sorted(wanted.keys() ^ found.keys()):
        raise WeightsError(
            f"{path} and the model that it is said to hold differ in {len(odd)} tensors, of which one is {odd[0]!r}: "
            "it is of another model or version, train again"
        )
    for name, leaf in wanted.items():
        if (found[name].shape, found[name].dtype) != (leaf.shape, leaf.dtype):
            raise WeightsError(
                f"{path} holds {name} of shape {found[name].shape} and type {found[name].dtype}, the model needs "
                f"{leaf.shape} and {leaf.dtype}: it is of another size, train again"
            )
    new = [jnp.asarray(found[name]) for name in wanted]
    return jax.tree.unflatten(structure, new)


def _name(path: tuple) -> str:
    return ".".join(str(getattr(key, "name", getattr(key, "idx", getattr(key, "key", key)))) for key in path)


def _digest(tensors: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(tensors):
        tensor = np.asarray(tensors[name], order="C")
        digest.update(f"{name} {tensor.dtype} {tensor.shape} ".encode())
        digest.update(tensor.tobytes())
    return digest.hexdigest()
