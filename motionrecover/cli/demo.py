"""The command demo, whose docstring is its help."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from motionrecover.cli import arguments as given
from motionrecover.cli import terminal
from motionrecover.cli.recovery import run


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write into.")] = Path("demo"),
    overwrite: given.Overwrite = False,
    seconds: Annotated[float, typer.Option(help="Length of the motion.")] = 8.0,
    seed: given.Seed = 0,
    json: given.Json = False,
    quiet: given.Quiet = False,
    verbose: given.Verbose = False,
    no_cache: given.NoCache = False,
) -> None:
    """Show what it does: make a motion, corrupt it, recover it, and report on it in a page and in pictures.

    A person walks, turns, kicks and jumps; a fifth of all samples is thrown by up to 25 cm an axis.
    """
    from motionrecover.cli import checks, facts
    from motionrecover.corrupt import apply
    from motionrecover.figures import FIGURES, write_figures
    from motionrecover.io import save
    from motionrecover.report import account, write_report
    from motionrecover.synthetic import synthesize

    terminal.hush(quiet)
    truth = synthesize(seconds, seed=seed)
    checks.check_folder(output)
    output.mkdir(parents=True, exist_ok=True)
    names = ("truth.npz", "corrupted.npz", "corrupted.csv", "recovered.npz", "recovered.csv", *FIGURES, "report.html")
    paths = [output / name for name in names]
    for path in paths:
        checks.check_place(path, overwrite)
    corrupted = truth.with_positions(apply("iid-20", truth.positions, seed)[0], f"corrupted by iid-20, seed {seed}")
    recovery, recovered = run(
        corrupted, given.PRESET, quiet=quiet, hidden=quiet or json, cached=not no_cache, verbose=verbose
    )
    for path, clip in zip(paths, (truth, corrupted, corrupted, recovered, recovered), strict=False):
        save(clip, path, overwrite=overwrite)
    *pictures, page = paths[5:]
    title = "a motion made from nothing, a fifth of it thrown off"
    for drawn, draw in (
        (pictures, lambda: write_figures(output, truth, corrupted, recovered, recovery, overwrite=overwrite)),
        ([page], lambda: write_report(corrupted, recovery, page, truth=truth, title=title, overwrite=overwrite)),
    ):
        try:
            draw()
        except ImportError as error:
            warnings.warn(str(error), stacklevel=1)
            paths = [path for path in paths if path not in drawn]

    padded = np.pad(corrupted.positions, ((2, 2), (0, 0), (0, 0)), mode="edge")
    clips = {
        "corrupted": corrupted.positions,
        "median of 5 frames": np.median(np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0), axis=-1),
        "recovered": recovered.positions,
    }
    found = {
        "frames": len(truth),
        "joints": len(truth.names),
        **account.verdict(recovery),
        **account.measures(clips, truth.skeleton, recovery.bone_lengths, truth),
        "written": [str(path) for path in paths],
    }
    if json:
        terminal.print_json(found)
    if json or quiet:
        return
    print(f"made a motion of {facts.size(truth)}, and threw 20 % of the samples by up to 25 cm an axis")
    print(facts.verdict_line(recovery))
    print()
    facts.print_measures(found)
    if found["aje_mm"]["median of 5 frames"] < found["aje_mm"]["recovered"]:
        print("a running median is nearer to the truth on lone spikes like these; it knows nothing of bones and gaps")
    print()
    print(f"wrote {', '.join(path.name for path in paths)} into {output}")
    for path in (page, pictures[0]):
        if path in paths:
            print(f"look at {path}: orange went in, blue came out, black is the truth")
    print("now try a file of yours (BVH, AMC, CSV, NPZ or NPY):")
    print("  motionrecover info walk.bvh")
    print("  motionrecover recover walk.bvh -o walk-clean.bvh --report walk.html")
