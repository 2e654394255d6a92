"""The command recover, whose docstring is its help, and what it shares with demo."""

from __future__ import annotations

import warnings
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionrecover import presets
from motionrecover.cli import arguments as given
from motionrecover.cli import settings, terminal

if TYPE_CHECKING:
    from motionrecover.motion import Motion
    from motionrecover.recovery import Recovery


def recover(
    context: typer.Context,
    path: given.Input,
    output: given.Output,
    preset: given.Preset = given.PRESET,
    bone_lengths: given.BoneLengths = "auto",
    max_gap: given.MaxGap = None,
    fill_unseen: given.FillUnseen = False,
    plant_feet: given.PlantFeet = False,
    symmetric: given.Symmetric = False,
    max_steps: given.MaxSteps = None,
    dtype: given.Dtype = "float32",
    truth: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The true motion, if known, to measure the errors against.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a page about what was changed too: .html.")
    ] = None,
    figures: Annotated[Path | None, typer.Option(metavar="DIR", help="Draw pictures too, into this folder.")] = None,
    overwrite: given.Overwrite = False,
    format: given.Format = None,
    skeleton: given.SkeletonName = None,
    unit: given.Unit = None,
    up: given.Up = None,
    fps: given.Fps = None,
    skip_first: given.SkipFirst = False,
    json: given.Json = False,
    quiet: given.Quiet = False,
    verbose: given.Verbose = False,
    no_cache: given.NoCache = False,
    config: given.Config = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Read and check everything, say what would be done, and write nothing.")
    ] = False,
) -> None:
    """Recover the motion behind a corrupted recording: spikes and jitter removed, missing joints filled in.

    The answer has the frames and joints of IN, in metres with y up; from BVH to BVH it has the hierarchy, channels,
    unit and axes of IN, from C3D to C3D everything of IN but the points. Where IN names no bones, they are pairs of
    joints that keep their distance. --truth is read with the same options as IN.
    """
    from motionrecover import files
    from motionrecover.cli import checks, facts
    from motionrecover.figures import FIGURES, write_figures
    from motionrecover.intake import fill
    from motionrecover.io import load, save
    from motionrecover.io.bvh_out import posed
    from motionrecover.report import account, write_report

    terminal.hush(quiet)
    presets.find(preset)
    checks.check_output(output, overwrite)
    checks.check_place(settings.beside(output), overwrite)
    if report is not None:
        checks.check_report(report, overwrite)
    if figures is not None:
        checks.check_figures(figures, overwrite)
    asked = {"skeleton": skeleton, "unit": unit, "up": up, "fps": fps, "skip_first": skip_first}
    as_rotations = output.suffix.lower() == ".bvh"
    clip, bone_lengths, lengths = files.take_in(path, bone_lengths, as_bvh=as_rotations, format=format, **asked)
    made = settings.provenance(context, path)
    reference = None if truth is None else checks.matched(load(truth, **asked), clip, truth, path)[0]
    chosen = {
        "max_gap": max_gap,
        "fill_unseen": fill_unseen,
        "plant_feet": plant_feet,
        "symmetric": symmetric,
        "max_steps": max_steps,
        "dtype": dtype,
    }
    pictures = [] if figures is None else [figures / name for name in FIGURES]
    outputs = [output, settings.beside(output), *([] if report is None else [report]), *pictures]
    found = {
        "input": str(path),
        "output": str(output),
        "settings": str(settings.beside(output)),
        "report": None if report is None else str(report),
        "figures": None if figures is None else str(figures),
        "frames": len(clip),
        "joints": len(clip.names),
        "preset": preset,
        "bone_lengths": bone_lengths,
    }
    if dry_run:
        found |= {
            "missing_share": float((~clip.observed).mean()),
            "windows": _windows(clip, preset, bone_lengths=lengths, **chosen),
        }
        if json:
            terminal.print_json(found)
        elif not quiet:
            print(f"{path}: {facts.size(clip)}, {terminal.percent(found['missing_share'])} of the samples missing")
            print(f"would recover it with {preset}, bone lengths: {bone_lengths}, windows: {found['windows']}")
            print("would write", ", ".join(map(str, outputs)))
        return

    recovery, recovered = run(
        clip,
        preset,
        quiet=quiet,
        hidden=quiet or json,
        cached=not no_cache,
        digest=made["input-sha256"],
        bone_lengths=lengths,
        verbose=verbose,
        **chosen,
    )
    made |= {"steps": recovery.steps, "converged": recovery.converged, "verdict": recovery.message}
    written = posed(recovered) if as_rotations else recovered
    save(written, output, overwrite=overwrite)
    settings.save(settings.used(context) | {"bone-lengths": bone_lengths}, made, output, overwrite)
    if report is not None:
        shown = {"preset": preset, "bone_lengths": bone_lengths, **chosen}
        write_report(clip, recovery, report, truth=reference, title=path.name, settings=shown, overwrite=overwrite)
    if figures is not None:
        write_figures(figures, reference, clip, recovered, recovery, overwrite=overwrite)

    clips = {"before": fill(facts.measured(clip)), "after": recovered.positions}
    found |= {
        **account.verdict(recovery),
        **account.measures(clips, clip.skeleton, recovery.bone_lengths, reference),
        **account.changes(recovery),
        "rotations_mm": facts.apart(written, recovered) if as_rotations else None,
    }
    if json:
        terminal.print_json(found)
    elif not quiet:
        print(f"{path}: {facts.size(clip)}")
        print(facts.verdict_line(recovery))
        print()
        facts.print_measures(found)
        print()
        facts.print_changes(found)
        if as_rotations:
            facts.print_apart(found)
        print("wrote", ", ".join(map(str, outputs)))


def run(
    clip: Motion, preset: str, *, quiet: bool, hidden: bool, cached: bool, digest: str | None = None, **chosen: Any
) -> tuple[Recovery, Motion]:
    """The recovery of a clip, and its motion, with the SHA-256 of the clip's file in its history.

    `quiet` prints no notes, `hidden` shows no progress, `cached` keeps programs.
    """
    from motionrecover import files
    from motionrecover.io.border import counted

    terminal.show_log(quiet)
    if cached:
        keep_programs()
    recovery = terminal.work(
        f"recovering {counted(len(clip), 'frame')}", hidden, partial(_recover, clip, preset, **chosen)
    )
    return recovery, files.answer(clip, recovery, preset, digest)


def _recover(clip: Motion, preset: str, **chosen: Any) -> Recovery:
    from motionrecover.recovery import recover_motion
    from motionrecover.threads import processors

    return recover_motion(clip, preset=preset, workers=processors(), **chosen)


class _Checked(Exception):
    """Ends a recovery before its first window."""


def _windows(clip: Motion, preset: str, **chosen: Any) -> int:
    """How many windows a recovery would take. Raises what it would raise before the first."""
    windows = []

    def stop(_: int, total: int) -> None:
        windows.append(total)
        raise _Checked

    with suppress(_Checked):
        _recover(clip, preset, progress=stop, **chosen)
    return windows[0]


def keep_programs() -> Path | None:
    """Have compiled programs go to and come from the user's cache folder, and name it, if it can be written."""
    from motionrecover import programs

    folder = programs.user_folder()
    try:
        programs.keep_in(folder)
    except OSError as error:
        warnings.warn(f"compiled programs are not kept: {error}", stacklevel=1)
        return None
    return folder
