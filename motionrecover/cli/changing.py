"""Commands that change files: convert, corrupt. Each one's docstring is its help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from motionrecover.cli import arguments as given
from motionrecover.cli import terminal
from motionrecover.corrupt import PROTOCOLS, apply


def convert(
    path: given.Input,
    output: Annotated[Path, typer.Argument(metavar="OUT", help="File to write: .npz, .csv, .bvh, .c3d or .trc.")],
    to: Annotated[
        str | None, typer.Option(metavar="NAME", help="Format of OUT, if not what its ending says: csv-long.")
    ] = None,
    overwrite: given.Overwrite = False,
    format: given.Format = None,
    skeleton: given.SkeletonName = None,
    unit: given.Unit = None,
    up: given.Up = None,
    fps: given.Fps = None,
    skip_first: given.SkipFirst = False,
    json: given.Json = False,
    quiet: given.Quiet = False,
) -> None:
    """Write a motion in another format: CSV and NPZ in metres with y up, every number exact.

    BVH has six decimals, TRC ten digits, C3D floats of 32 bits.
    """
    from motionrecover.cli import checks, facts
    from motionrecover.io import load, save

    terminal.hush(quiet)
    checks.check_output(output, overwrite, to)
    clip = load(path, format=format, skeleton=skeleton, unit=unit, up=up, fps=fps, skip_first=skip_first)
    save(clip, output, overwrite=overwrite, format=to)
    if json:
        found = {"input": str(path), "output": str(output), "frames": len(clip), "joints": len(clip.names)}
        terminal.print_json(found | {"history": list(clip.history)})
    elif not quiet:
        print(f"{path}: {facts.size(clip)}")
        print(f"wrote {output}")


def corrupt(
    path: given.Input,
    output: given.Output,
    protocol: Annotated[
        str,
        typer.Option(
            metavar="NAME", help=f"{', '.join(PROTOCOLS)}; F in per cent, N joints, L frames: iid-20, rand30, gap3x60."
        ),
    ],
    seed: given.Seed = 0,
    overwrite: given.Overwrite = False,
    format: given.Format = None,
    skeleton: given.SkeletonName = None,
    unit: given.Unit = None,
    up: given.Up = None,
    fps: given.Fps = None,
    skip_first: given.SkipFirst = False,
    json: given.Json = False,
    quiet: given.Quiet = False,
) -> None:
    """Corrupt a motion on purpose, to see what a recovery makes of it."""
    from motionrecover.cli import checks, facts
    from motionrecover.io import load, save

    terminal.hush(quiet)
    checks.check_output(output, overwrite)
    clip = load(path, format=format, skeleton=skeleton, unit=unit, up=up, fps=fps, skip_first=skip_first)
    positions, hit = apply(protocol, facts.measured(clip), seed, clip.skeleton)
    corrupted = clip.with_positions(positions, f"corrupted by {protocol}, seed {seed}")
    save(corrupted, output, overwrite=overwrite)
    removed = int(clip.observed.sum() - corrupted.observed.sum())
    found = {
        "input": str(path),
        "output": str(output),
        "protocol": protocol,
        "seed": seed,
        "hit_share": float(hit.mean()),
        "removed": removed,
    }
    if json:
        terminal.print_json(found)
    elif not quiet:
        print(f"{path}: {facts.size(clip)}")
        print(f"{terminal.percent(found['hit_share'])} of the samples hit, {removed} of them removed")
        print(f"wrote {output}")
