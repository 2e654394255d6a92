"""The command `batch`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionrecover import presets
from motionrecover.cli import arguments as given
from motionrecover.cli import terminal
from motionrecover.cli.recovery import keep_programs

if TYPE_CHECKING:
    from motionrecover.batch import Tally


def batch(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="IN_DIR|GLOB|LIST...",
            help="Folders, patterns in quotes ('takes/**/*.bvh'), lists of files (.txt), motion files, Zarr stores; "
            "also by URL (s3://bucket/takes).",
        ),
    ],
    output: Annotated[str, typer.Option("--output", "-o", metavar="OUT_DIR", help="Folder or URL to write into.")],
    to: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Format of all answers. Left out, that of each clip, or npz where that is read only."
        ),
    ] = None,
    report: Annotated[bool, typer.Option("--report", help="Write a page on each clip too.")] = False,
    workers: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Processes. Left out, one for each processor.", show_default=False),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler whose workers to use instead (tcp://host:8786)."),
    ] = None,
    preset: given.Preset = given.PRESET,
    bone_lengths: given.BoneLengths = "auto",
    max_gap: given.MaxGap = None,
    fill_unseen: given.FillUnseen = False,
    plant_feet: given.PlantFeet = False,
    symmetric: given.Symmetric = False,
    max_steps: given.MaxSteps = None,
    dtype: given.Dtype = "float32",
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Write into a folder of other files too, and replace them.")
    ] = False,
    format: given.Format = None,
    skeleton: given.SkeletonName = None,
    unit: given.Unit = None,
    up: given.Up = None,
    fps: given.Fps = None,
    skip_first: given.SkipFirst = False,
    json: given.Json = False,
    quiet: given.Quiet = False,
    no_cache: given.NoCache = False,
) -> None:
    """Recover whole archives: all files of folders, patterns and lists, into OUT_DIR with the same structure.

    OUT_DIR gets manifest.jsonl, a line a clip, and index.html. The same command goes on where an earlier one ended:
    it does what is missing, what failed, and what has another input or other options. One bad clip never stops the
    rest; the exit code is then 1. The options on reading apply to all files.
    """
    from motionrecover.batch import Dask, Processes, Settings, plan, run
    from motionrecover.batch.remote import is_url
    from motionrecover.cli import checks
    from motionrecover.io.border import counted
    from motionrecover.threads import processors

    terminal.hush(quiet)
    presets.find(preset)
    if report:
        checks.check_plotly()
    if not is_url(output):
        checks.check_folder(Path(output))
    if scheduler is not None:
        if workers is not None:
            raise typer.BadParameter("the scheduler has its own workers: leave --workers out")
        # Other machines have another working folder.
        *sources, output = (name if is_url(name) else os.path.abspath(name) for name in (*sources, output))
        skeleton = os.path.abspath(skeleton) if skeleton is not None and os.path.isfile(skeleton) else skeleton
    jobs = plan(sources, output, format=format, to=to)
    cache = None if no_cache else keep_programs()
    settings = Settings(
        preset,
        bone_lengths,
        recovery={
            "max_gap": max_gap,
            "fill_unseen": fill_unseen,
            "plant_feet": plant_feet,
            "symmetric": symmetric,
            "max_steps": max_steps,
            "dtype": dtype,
        },
        reading={"format": format, "skeleton": skeleton, "unit": unit, "up": up, "fps": fps, "skip_first": skip_first},
        report=report,
        programs=None if cache is None else str(cache),
    )
    local = Processes(min(processors() if workers is None else workers, len(jobs)))
    executor = local if scheduler is None else Dask(scheduler)
    with terminal.progress(f"recovering {counted(len(jobs), 'clip')}", len(jobs), quiet or json) as show:
        tally = run(
            jobs,
            output,
            settings,
            executor,
            seen=lambda tally: show(tally.done + tally.kept + tally.failed),
            overwrite=overwrite,
        )
    if json:
        terminal.print_json(_facts(tally, output))
    elif not quiet:
        _print(tally, output)
    if tally.failed:
        raise typer.Exit(1)


def _facts(tally: Tally, output: str) -> dict:
    from motionrecover.batch.jobs import MANIFEST
    from motionrecover.batch.remote import home

    return {
        "output": output,
        "manifest": str(home(output) / MANIFEST),
        "done": tally.done,
        "kept": tally.kept,
        "failed": tally.failed,
        "frames": tally.frames,
        "samples": dict(tally.samples),
        "first_failures": [{"input": name, "reason": reason} for name, reason in tally.failures],
    }


def _print(tally: Tally, output: str) -> None:
    from motionrecover.batch.jobs import INDEX, MANIFEST
    from motionrecover.batch.remote import home
    from motionrecover.io.border import counted

    total = max(sum(tally.samples.values()), 1)
    shares = [f"{kind} {terminal.percent(count / total)}" for kind, count in tally.samples.items() if count]
    rows = [("recovered", f"{counted(tally.done, 'clip')}, {counted(tally.frames, 'frame')}")]
    if shares:
        rows.append(("of the samples", ", ".join(shares)))
    rows += [("done before", counted(tally.kept, "clip"))] if tally.kept else []
    rows += [("failed", counted(tally.failed, "clip"))] if tally.failed else []
    terminal.table(("", ""), rows)
    if tally.failures:
        print()
        for name, reason in tally.failures:
            print(reason if reason.startswith(name) else f"{name}: {reason}")
        if tally.failed > len(tally.failures):
            print(f"and {tally.failed - len(tally.failures)} more, in {home(output) / MANIFEST}")
        print()
    print(f"wrote {home(output) / INDEX} and {home(output) / MANIFEST}")
