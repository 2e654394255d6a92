"""Commands that look at files: info, skeleton, view, evaluate. Each one's docstring is its help."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from motionrecover.cli import arguments as given
from motionrecover.cli import terminal


def info(
    path: given.Input,
    format: given.Format = None,
    skeleton: given.SkeletonName = None,
    unit: given.Unit = None,
    up: given.Up = None,
    fps: given.Fps = None,
    skip_first: given.SkipFirst = False,
    json: given.Json = False,
    quiet: given.Quiet = False,
) -> None:
    """Tell what a motion file holds, and how it was read."""
    from motionrecover.cli import facts
    from motionrecover.io import load

    terminal.hush(quiet)
    clip = load(path, format=format, skeleton=skeleton, unit=unit, up=up, fps=fps, skip_first=skip_first)
    found = {"file": str(path), **facts.contents(clip)}
    if json:
        terminal.print_json(found)
    elif not quiet:
        print(path)
        facts.print_contents(found)


def skeleton(
    path: given.Input,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="OUT", help="Skeleton file to write: TOML.")
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
    """List the bones of a motion, and how well each keeps its length; write them as a file for --skeleton.

    A file that brings no bones gets those of a standard whose joints it names, or else those that its distances show;
    --skeleton infer takes the latter in any case. OUT can be edited: a line is a bone.
    """
    from motionrecover.cli import facts
    from motionrecover.io import load, save_skeleton
    from motionrecover.io.border import counted

    terminal.hush(quiet)
    clip = load(path, format=format, skeleton=skeleton, unit=unit, up=up, fps=fps, skip_first=skip_first)
    bones = facts.bones(clip)
    if output is not None:
        reasons = [facts.reason(bone, len(clip)) for bone in bones]
        save_skeleton(clip.skeleton, output, reasons=reasons, overwrite=overwrite)
    parts = [[clip.names[joint] for joint in part] for part in clip.skeleton.components]
    found = {
        "file": str(path),
        "output": None if output is None else str(output),
        "frames": len(clip),
        "parts": parts,
        "bones": bones,
        "history": list(clip.history),
    }
    if json:
        terminal.print_json(found)
    if json or quiet:
        return
    print(f"{path}: {facts.size(clip)}, {counted(len(bones), 'bone')}")
    for line in clip.history:
        print(line)
    facts.print_bones(bones, len(clip))
    for part in parts[1:]:
        print("no bone ties to the rest:", ", ".join(part))
    if output is not None:
        print(f"wrote {output}")


def view(
    path: given.Input,
    recovered: Annotated[
        Path | None, typer.Argument(metavar="[RECOVERED]", help="What was recovered from IN.", show_default=False)
    ] = None,
    truth: Annotated[Path | None, typer.Option(metavar="FILE", help="The true motion, if known.")] = None,
    output: Annotated[
        Path | None, typer.Option("--save", metavar="FILE", help="Write what would be shown to a file: .rrd.")
    ] = None,
    overwrite: given.Overwrite = False,
    format: given.Format = None,
    skeleton: given.SkeletonName = None,
    unit: given.Unit = None,
    up: given.Up = None,
    fps: given.Fps = None,
    skip_first: given.SkipFirst = False,
    quiet: given.Quiet = False,
) -> None:
    """Look at a motion in the viewer of rerun, beside what was recovered from it and the truth.

    The viewer plots the confidence that IN brings, and how far each joint was moved. The options on reading apply to
    all files.
    """
    from motionrecover.cli import checks, facts
    from motionrecover.io import load
    from motionrecover.view import view as show

    terminal.hush(quiet)
    if output is not None:
        checks.check_place(output, overwrite)
    asked = {"skeleton": skeleton, "unit": unit, "up": up, "fps": fps, "skip_first": skip_first}
    clip = load(path, format=format, **asked)
    clips, series = {"input": clip}, {}
    if clip.confidence is not None:
        series["weights"] = clip.confidence
    for name, other in (("recovered", recovered), ("truth", truth)):
        if other is not None:
            clips[name] = checks.matched(load(other, **asked), clip, other, path)[0]
    if recovered is not None:
        series["moved"] = np.linalg.norm(facts.measured(clip) - clips["recovered"].positions, axis=-1)
    show(clips, series, save=output, overwrite=overwrite)
    if output is not None and not quiet:
        print(f"wrote {output}")


def evaluate(
    path: given.Input,
    truth: Annotated[Path, typer.Option(metavar="FILE", help="The true motion.")],
    format: given.Format = None,
    skeleton: given.SkeletonName = None,
    unit: given.Unit = None,
    up: given.Up = None,
    fps: given.Fps = None,
    skip_first: given.SkipFirst = False,
    json: given.Json = False,
    quiet: given.Quiet = False,
) -> None:
    """Measure a motion against the true one.

    Joints are matched by name, frames by number. The options on reading apply to both files; where that does not fit,
    convert one of them first.
    """
    from motionrecover.cli import checks, facts
    from motionrecover.io import load
    from motionrecover.io.border import counted

    terminal.hush(quiet)
    asked = {"skeleton": skeleton, "unit": unit, "up": up, "fps": fps, "skip_first": skip_first}
    clip, true = load(path, format=format, **asked), load(truth, **asked)
    if not np.isclose(clip.fps, true.fps, rtol=0.01):
        warnings.warn(
            f"{path} has {clip.fps:g} frames a second and {truth} {true.fps:g}: they are compared frame by frame",
            stacklevel=1,
        )
    reference, common = checks.matched(true, clip, truth, path)
    left_out = sorted({*clip.names, *true.names} - {*common})
    found = {"input": str(path), "truth": str(truth), **facts.comparison(clip, reference, common)}
    if not found["compared_share"]:
        raise ValueError(f"{path} and {truth} have no sample that both measured: there is nothing to compare")
    if json:
        terminal.print_json(found | {"joints_left_out": left_out})
    if json or quiet:
        return
    print(f"{path} against {truth}")
    print(f"compared: {counted(len(clip), 'frame')}, {counted(len(common), 'joint')} of the same name")
    if left_out:
        print(f"these joints: {', '.join(common)}")
        print(f"left out, for only one file has them: {', '.join(left_out)}")
    facts.print_comparison(found)
