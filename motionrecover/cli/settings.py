"""Settings files: TOML whose keys are a command's flags without dashes before them, and `input` for IN.

    input = "walk.bvh"
    output = "walk-clean.bvh"
    max-gap = 30
    plant-feet = true

`--config FILE` makes them the defaults of the command; what the command line says goes before. `recover` writes such a
file beside its answer, `walk-clean.bvh.toml`: all settings that bear on the answer, and a table `[provenance]` of what
it was made from and how that ended. The table is no setting: read again, it tells whether input and version are the
same.
"""

from __future__ import annotations

import difflib
import json
import tomllib
import warnings
from pathlib import Path
from typing import Any

import typer

from motionrecover import __version__

PROVENANCE = "provenance"
_HOW = {"config", "overwrite", "dry_run", "no_cache", "json", "quiet", "verbose"}
"""Arguments that do not bear on the answer."""


def take(context: typer.Context, path: Path | None) -> Path | None:
    """Make the settings in a file the defaults of the command's arguments.

    Raises `ValueError` for what is no TOML, keys that the command does not have, and values that are no text, number,
    or true and false.
    """
    if path is None or context.resilient_parsing:
        return path
    from motionrecover.io.border import read_bytes

    content = read_bytes(path)
    try:
        said = tomllib.loads(content.decode())
    except ValueError as error:
        raise ValueError(f"{path} is no TOML file: {error}") from error
    context.meta[PROVENANCE] = said.pop(PROVENANCE, {})
    names = _names(context)
    for key, value in said.items():
        if key not in names:
            nearest = difflib.get_close_matches(key, names, 1, cutoff=0)[0]
            raise ValueError(
                f"{path}: received the key {key!r}, which {context.info_name} does not have: the nearest is {nearest!r}"
            )
        if not isinstance(value, str | int | float):
            raise ValueError(f"{path}: received {key} = {value!r}: write a text, a number, true or false")
    context.default_map = {names[key]: str(value) for key, value in said.items()}
    return path


def used(context: typer.Context) -> dict[str, Any]:
    """The settings of a command that bear on its answer, as a settings file has them."""
    values = {key: context.params[name] for key, name in _names(context).items() if name not in _HOW}
    return {key: value for key, value in values.items() if value is not None}


def provenance(context: typer.Context, path: Path) -> dict[str, Any]:
    """What an answer to the file at `path` is made of; warns where the settings file was made from another."""
    from motionrecover.files import sha256

    made = {"motionrecover": __version__, "input-sha256": sha256(path)}
    source = context.get_parameter_source("path")
    before = context.meta.get(PROVENANCE, {}) if source is not None and source.name == "DEFAULT_MAP" else {}
    if before.get("input-sha256", made["input-sha256"]) != made["input-sha256"]:
        warnings.warn(f"{path} has changed since {context.params['config']} was written", stacklevel=2)
    if before.get("motionrecover", __version__) != __version__:
        warnings.warn(
            f"{context.params['config']} was written by motionrecover {before['motionrecover']}, and this is "
            f"{__version__}: answers may differ",
            stacklevel=2,
        )
    return made


def beside(output: Path) -> Path:
    """Where the settings that made an answer are written."""
    return output.with_name(f"{output.name}.toml")


def save(settings: dict[str, Any], made: dict[str, Any], output: Path, overwrite: bool) -> None:
    """Write the settings and the provenance of the answer at `output` beside it."""
    from motionrecover.io import write_beside

    path = beside(output)
    head = f"# What made {output.name}. The same again: motionrecover recover --config {path.name} --overwrite"
    lines = [head, *_lines(settings), "", f"[{PROVENANCE}]", *_lines(made), ""]
    with write_beside(path, overwrite=overwrite) as temporary:
        temporary.write_text("\n".join(lines), encoding="utf-8")


def _names(context: typer.Context) -> dict[str, str]:
    """Names of the command's arguments by their keys."""
    found = {max(param.opts, key=len).lstrip("-"): param.name for param in context.command.params if param.name}
    return {"input" if key == "path" else key: name for key, name in found.items() if key != "config"}


def _lines(values: dict[str, Any]) -> list[str]:
    from motionrecover.io.skeleton_file import quoted

    return [
        f"{key} = {json.dumps(value) if isinstance(value, bool | int | float) else quoted(str(value))}"
        for key, value in values.items()
    ]
