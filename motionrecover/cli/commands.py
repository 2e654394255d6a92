"""The commands. Each one's docstring is its help."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

from motionrecover import __version__, presets, programs
from motionrecover.cli import arguments as given
from motionrecover.cli import facts, terminal
from motionrecover.corrupt import PROTOCOLS, apply
from motionrecover.figures import FIGURES, write_figures
from motionrecover.intake import fill
from motionrecover.io import load, save, save_skeleton
from motionrecover.io.border import counted
from motionrecover.io.bvh_out import posed, rig_of
from motionrecover.motion import Motion
from motionrecover.recovery import Recovery
from motionrecover.recovery import recover as run_recovery
from motionrecover.report import write_report
from motionrecover.synthetic import synthesize
from motionrecover.view import view as show

_PRESET = "robust"


def recover(
    path: given.Input,
    output: given.Output,
    preset: Annotated[str, typer.Option(metavar="NAME", help=f"Model: {', '.join(presets.PRESETS)}.")] = _PRESET,
    bone_lengths: Annotated[
        Literal["auto", "estimate", "rest"],
        typer.Option(
            help="Bone lengths from the clip itself, or from the rest pose in the file. auto: from the rest pose of a "
            "BVH whose frames keep it, else from the clip."
        ),
    ] = "auto",
    max_gap: Annotated[
        int | None, typer.Option(min=0, metavar="FRAMES", help="Leave longer gaps missing instead of filling them.")
    ] = None,
    fill_unseen: Annotated[
        bool, typer.Option("--fill-unseen", help="Place joints that no frame shows by their bones alone.")
    ] = False,
    plant_feet: Annotated[
        bool, typer.Option("--plant-feet", help="Hold feet in place while they stand on the ground.")
    ] = False,
    symmetric: Annotated[
        bool, typer.Option("--symmetric", help="Draw estimated lengths of left and right bones together.")
    ] = False,
    max_steps: Annotated[int | None, typer.Option(min=1, metavar="N", help="Stop after so many steps.")] = None,
    dtype: Annotated[Literal["float32", "float64"], typer.Option(help="Precision of the answer.")] = "float32",
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
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print the solver's trace.")] = False,
    no_cache: given.NoCache = False,
) -> None:
    """Recover the motion behind a corrupted recording: spikes and jitter removed, missing joints filled in.

    The answer has the frames and joints of IN, in metres with y up; from BVH to BVH it has the hierarchy, channels,
    unit and axes of IN, from C3D to C3D everything of IN but the points. Where IN names no bones, they are pairs of
    joints that keep their distance. --truth is read with the same options as IN.
    """
    _hush(quiet)
    presets.find(preset)
    given.check_output(output, overwrite)
    if report is not None:
        given.check_report(report, overwrite)
    if figures is not None:
        given.check_figures(figures, overwrite)
    asked = {"skeleton": skeleton, "unit": unit, "up": up, "fps": fps, "skip_first": skip_first}
    clip = load(path, format=format, **asked)
    if not clip.observed.any():
        raise ValueError(f"{path} holds no measured sample: there is nothing to recover from")
    clip = clip
    reference = None if truth is None else given.matched(load(truth, **asked), clip, truth, path)[0]
    as_rotations = output.suffix.lower() == ".bvh"
    if as_rotations:
        rig_of(clip)  # refuses what BVH cannot hold before the work
    if bone_lengths == "auto":
        bone_lengths = "rest" if facts.keeps_rest(clip) else "estimate"
    lengths = clip.skeleton.rest_lengths if bone_lengths == "rest" else None
    if bone_lengths == "rest" and lengths is None:
        raise ValueError(f"{path} brings no rest pose to take bone lengths from: use --bone-lengths estimate")
    settings = {
        "max_gap": max_gap,
        "fill_unseen": fill_unseen,
        "plant_feet": plant_feet,
        "symmetric": symmetric,
        "max_steps": max_steps,
        "dtype": dtype,
    }
    recovery, recovered = _recover(clip, preset, quiet, not no_cache, bone_lengths=lengths, verbose=verbose, **settings)
    written = posed(recovered) if as_rotations else recovered
    save(written, output, overwrite=overwrite)
    wrote = [output]
    if report is not None:
        shown = {"preset": preset, "bone_lengths": bone_lengths, **settings}
        write_report(clip, recovery, report, truth=reference, title=path.name, settings=shown, overwrite=overwrite)
        wrote.append(report)
    if figures is not None:
        write_figures(figures, reference, clip, recovered, recovery, overwrite=overwrite)
        wrote += [figures / name for name in FIGURES]

    clips = {"before": fill(facts.measured(clip)), "after": recovered.positions}
    found = {
        "input": str(path),
        "output": str(output),
        "report": None if report is None else str(report),
        "figures": None if figures is None else str(figures),
        "frames": len(clip),
        "joints": len(clip.names),
        "preset": preset,
        "bone_lengths": bone_lengths,
        **facts.verdict(recovery),
        **facts.measures(clips, clip.skeleton, recovery.bone_lengths, reference),
        **facts.changes(recovery),
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
        print("wrote", ", ".join(map(str, wrote)))


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write into.")] = Path("demo"),
    overwrite: given.Overwrite = False,
    seconds: Annotated[float, typer.Option(help="Length of the motion.")] = 8.0,
    seed: given.Seed = 0,
    json: given.Json = False,
    no_cache: given.NoCache = False,
) -> None:
    """Show what it does: make a motion, corrupt it, recover it, and report on it in a page and in pictures.

    A person walks, turns, kicks and jumps; a fifth of all samples is thrown by up to 25 cm an axis.
    """
    truth = synthesize(seconds, seed=seed)
    given.check_folder(output)
    output.mkdir(parents=True, exist_ok=True)
    names = ("truth.npz", "corrupted.npz", "corrupted.csv", "recovered.npz", "recovered.csv", *FIGURES, "report.html")
    paths = [output / name for name in names]
    for path in paths:
        given.check_place(path, overwrite)
    corrupted = truth.with_positions(apply("iid-20", truth.positions, seed)[0], f"corrupted by iid-20, seed {seed}")
    recovery, recovered = _recover(corrupted, _PRESET, cached=not no_cache)
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
        **facts.verdict(recovery),
        **facts.measures(clips, truth.skeleton, recovery.bone_lengths, truth),
        "written": [str(path) for path in paths],
    }
    if json:
        terminal.print_json(found)
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
    _hush(quiet)
    given.check_output(output, overwrite)
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
) -> None:
    """Measure a motion against the true one.

    Joints are matched by name, frames by number. The options on reading apply to both files; where that does not fit,
    convert one of them first.
    """
    asked = {"skeleton": skeleton, "unit": unit, "up": up, "fps": fps, "skip_first": skip_first}
    clip, true = load(path, format=format, **asked), load(truth, **asked)
    if not np.isclose(clip.fps, true.fps, rtol=0.01):
        warnings.warn(
            f"{path} has {clip.fps:g} frames a second and {truth} {true.fps:g}: they are compared frame by frame",
            stacklevel=1,
        )
    reference, common = given.matched(true, clip, truth, path)
    left_out = sorted({*clip.names, *true.names} - {*common})
    found = {"input": str(path), "truth": str(truth), **facts.comparison(clip, reference, common)}
    if not found["compared_share"]:
        raise ValueError(f"{path} and {truth} have no sample that both measured: there is nothing to compare")
    if json:
        terminal.print_json(found | {"joints_left_out": left_out})
        return
    print(f"{path} against {truth}")
    print(f"compared: {counted(len(clip), 'frame')}, {counted(len(common), 'joint')} of the same name")
    if left_out:
        print(f"these joints: {', '.join(common)}")
        print(f"left out, for only one file has them: {', '.join(left_out)}")
    facts.print_comparison(found)


def info(
    path: given.Input,
    format: given.Format = None,
    skeleton: given.SkeletonName = None,
    unit: given.Unit = None,
    up: given.Up = None,
    fps: given.Fps = None,
    skip_first: given.SkipFirst = False,
    json: given.Json = False,
) -> None:
    """Tell what a motion file holds, and how it was read."""
    clip = load(path, format=format, skeleton=skeleton, unit=unit, up=up, fps=fps, skip_first=skip_first)
    found = {"file": str(path), **facts.contents(clip)}
    if json:
        terminal.print_json(found)
    else:
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
) -> None:
    """List the bones of a motion, and how well each keeps its length; write them as a file for --skeleton.

    A file that brings no bones gets those of a standard whose joints it names, or else those that its distances show;
    --skeleton infer takes the latter in any case. OUT can be edited: a line is a bone.
    """
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
) -> None:
    """Look at a motion in the viewer of rerun, beside what was recovered from it and the truth.

    The viewer plots the confidence that IN brings, and how far each joint was moved. The options on reading apply to
    all files.
    """
    if output is not None:
        given.check_place(output, overwrite)
    asked = {"skeleton": skeleton, "unit": unit, "up": up, "fps": fps, "skip_first": skip_first}
    clip = load(path, format=format, **asked)
    clips, series = {"input": clip}, {}
    if clip.confidence is not None:
        series["weights"] = clip.confidence
    for name, other in (("recovered", recovered), ("truth", truth)):
        if other is not None:
            clips[name] = given.matched(load(other, **asked), clip, other, path)[0]
    if recovered is not None:
        series["moved"] = np.linalg.norm(facts.measured(clip) - clips["recovered"].positions, axis=-1)
    show(clips, series, save=output, overwrite=overwrite)
    if output is not None:
        print(f"wrote {output}")


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
    quiet: given.Quiet = False,
) -> None:
    """Write a motion in another format: CSV and NPZ in metres with y up, every number exact.

    BVH has six decimals, TRC ten digits, C3D floats of 32 bits.
    """
    _hush(quiet)
    given.check_output(output, overwrite, to)
    clip = load(path, format=format, skeleton=skeleton, unit=unit, up=up, fps=fps, skip_first=skip_first)
    save(clip, output, overwrite=overwrite, format=to)
    if not quiet:
        print(f"{path}: {facts.size(clip)}")
        print(f"wrote {output}")


def _hush(quiet: bool) -> None:
    if quiet:
        warnings.simplefilter("ignore")


def _recover(
    clip: Motion, preset: str, quiet: bool = False, cached: bool = True, **settings: Any
) -> tuple[Recovery, Motion]:
    """The recovery of a clip, and its motion."""
    terminal.show_log(quiet)
    if cached:
        _keep_programs()

    def call() -> Recovery:
        masks = {"observed": clip.observed, "confidence": clip.confidence}
        return run_recovery(clip.positions, clip.skeleton, preset=preset, fps=clip.fps, **masks, **settings)

    recovery = terminal.work(f"recovering {facts.size(clip)}", quiet, call)
    ended = "converged" if recovery.converged else "not converged"
    note = f"recovered with {preset} of motionrecover {__version__}: {counted(recovery.steps, 'step')}, {ended}"
    return recovery, clip.with_positions(recovery.positions, note)


def _keep_programs() -> None:
    """Compiled programs go to and come from the user's cache folder, if it can be written."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    try:
        programs.keep_in(Path(root) / "motionrecover")
    except OSError as error:
        warnings.warn(f"compiled programs are not kept: {error}", stacklevel=1)
