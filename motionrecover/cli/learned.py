"""The commands for learned refiners: models, train, refine. Each one's docstring is its help."""

from __future__ import annotations

import importlib.util
import math
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from motionrecover.cli import arguments as given
from motionrecover.cli import terminal

_PROTOCOLS = "choi-missing40, choi-missing20-noise3, choi-joints2 (any numbers), li-mixed, sensor, mixed"


def models(json: given.Json = False) -> None:
    """List the networks that can be trained, with the numbers they learn for the 21 joints of the papers."""
    from motionrecover.refine.models import MODELS, parameter_count

    found = [
        {
            "name": model.name,
            "description": model.description,
            "parameters": parameter_count(model.name),
            "parameters_small": parameter_count(model.name, small=True),
            "convention": asdict(model.convention),
            "epochs": sum(stage.epochs for stage in model.stages),
        }
        for model in MODELS.values()
    ]
    if json:
        terminal.print_json({"models": found})
        return
    rows = [
        (f"{model['name']}: {model['description']}", f"{model['parameters']:,}", f"{model['parameters_small']:,}")
        for model in found
    ]
    terminal.table(("model", "parameters", "small"), rows)


def train(
    model: Annotated[str, typer.Option(metavar="NAME", help="One of `motionrecover models`.")],
    data: Annotated[Path, typer.Option(metavar="DIR", help="Folder of clips, with subfolders.")],
    protocol: Annotated[str, typer.Option(metavar="NAME", help=f"What is done to the clips: {_PROTOCOLS}.")],
    out: Annotated[Path, typer.Option(metavar="RUN", help="Folder of the run: log, picture, checkpoint, weights.")],
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint in RUN.")] = False,
    preset: Annotated[
        Literal["small", "identity", "paper"],
        typer.Option(
            help="small: a narrow network in minutes on a CPU. identity: one that starts as the identity, in hours. "
            "paper: as published, for a GPU."
        ),
    ] = "small",
    steps: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Steps in all, not those of the preset.")
    ] = None,
    batch: Annotated[int | None, typer.Option(min=1, metavar="N", help="Windows a step, not as published.")] = None,
    minutes: Annotated[
        float | None, typer.Option(min=0, metavar="M", help="Stop with a checkpoint after so many minutes.")
    ] = None,
    split: Annotated[
        Literal["subject", "window"],
        typer.Option(help="What is held out: whole subjects, or windows as in the papers, which share frames."),
    ] = "subject",
    held_out: Annotated[
        str, typer.Option(metavar="A,B,...", help="Subjects held out (file names up to the first underscore).")
    ] = "",
    heading: Annotated[
        Literal["removed", "kept"] | None, typer.Option(help="Whether the body is turned to face z, not as published.")
    ] = None,
    skeleton: Annotated[str, typer.Option(metavar="NAME|FILE", help="Joints to learn; clips may have more.")] = "cmu21",
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same weights.")] = 0,
    quiet: given.Quiet = False,
) -> None:
    """Train a network on a folder of clips, and write its weights.

    RUN/checkpoint.safetensors is always whole: a run that was stopped or killed goes on with --resume as if nothing had
    happened, and either file of weights serves `motionrecover refine --model`.
    """
    from motionrecover.figures import loss_figure
    from motionrecover.io import write_beside
    from motionrecover.io.bones import named
    from motionrecover.refine.train import Settings, set_up
    from motionrecover.refine.train import train as lines_of

    subjects = tuple(name for name in held_out.split(",") if name)
    settings = Settings(model, protocol, preset, split, subjects, steps, batch, heading, seed)
    run = set_up(settings, data, out, named(skeleton), resume)
    if not quiet:
        for sentence in run.trained.clips.skipped:
            print("left out:", sentence, file=sys.stderr)
        counts = f"{len(run.trained)} windows to train on, {len(run.held_out)} held out"
        people = run.config["held_out_subjects"]
        print(f"{model}, {preset}: {counts}" + (f" (subjects {', '.join(people)})" if people else ""))
    done = 0
    with terminal.progress("training", run.total, quiet) as show:
        for line in lines_of(run, seconds=math.inf if minutes is None else 60 * minutes):
            done = line["step"]
            show(done)
            if line["held_out_mm"] == "":
                continue
            if not quiet:
                print(_said(line, run.total), flush=True)
            if importlib.util.find_spec("matplotlib") is not None:
                with write_beside(out / "loss.png", overwrite=True) as temporary:
                    loss_figure(out / "log.csv", temporary)
    if not quiet:
        name = "weights.safetensors" if (out / "weights.safetensors").is_file() else "checkpoint.safetensors"
        print(f"{done or run.total} of {run.total} steps; weights are in {out / name}")


def refine(
    path: given.Input,
    output: given.Output,
    model: Annotated[str, typer.Option(metavar="RUN|FILE|NAME", help="Folder of a run, its weights, or a name.")],
    observed: Annotated[
        Literal["auto", "kept", "refined"],
        typer.Option(help="Whether measured samples stay. auto: where the recording is free of noise."),
    ] = "auto",
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
    """Refine a recording with a trained network: missing samples filled in, noise removed.

    Joints are found by name; those that the network does not know stay as they are.
    """
    from motionrecover.cli import checks, facts
    from motionrecover.io import load, save
    from motionrecover.io.bvh_out import posed, rig_of
    from motionrecover.refine import load_refiner

    terminal.hush(quiet)
    checks.check_output(output, overwrite)
    refiner = load_refiner(model)
    clip = load(path, format=format, skeleton=skeleton, unit=unit, up=up, fps=fps, skip_first=skip_first)
    as_rotations = output.suffix.lower() == ".bvh"
    if as_rotations:
        rig_of(clip)  # refuses what BVH cannot hold before the work
    began = time.monotonic()
    keep = {"auto": None, "kept": True, "refined": False}[observed]

    def call(**_):
        masked = facts.measured(clip)
        return refiner(masked, clip.skeleton, fps=clip.fps, keep_observed=keep)

    found = terminal.work(f"refining {facts.size(clip)}", quiet or json, call)
    seconds = time.monotonic() - began
    refined = clip.with_positions(found.positions, f"refined with {refiner.name} of {model}")
    written = posed(refined) if as_rotations else refined
    save(written, output, overwrite=overwrite)
    known = found.refined
    report: dict[str, Any] = {
        "input": str(path),
        "output": str(output),
        "model": refiner.name,
        "joints_refined": [name for name, each in zip(clip.names, known, strict=True) if each],
        "joints_left": [name for name, each in zip(clip.names, known, strict=True) if not each],
        "noise_mm": 1000 * found.noise,
        "kept_share": float(found.kept[:, known].mean()),
        "filled_share": float((~clip.observed)[:, known].mean()),
        "seconds": seconds,
    }
    if json:
        terminal.print_json(report)
    elif not quiet:
        print(f"{path}: {facts.size(clip)}")
        print(f"refined {len(report['joints_refined'])} joints with {refiner.name} in {seconds:.1f} s")
        if report["joints_left"]:
            print(f"left as they are: {', '.join(report['joints_left'])}")
        kept, filled = terminal.percent(report["kept_share"]), terminal.percent(report["filled_share"])
        print(f"noise {terminal.mm(report['noise_mm'])}; kept {kept} of the samples, filled in {filled}")
        print(f"wrote {output}")


def _said(line: dict[str, Any], total: int) -> str:
    held_out, missing, filled = (
        terminal.mm(line[name]) for name in ("held_out_mm", "held_out_missing_mm", "mean_pose_missing_mm")
    )
    return (
        f"step {line['step']} of {total}: loss {line['loss']:.3g}, held out {held_out}, "
        f"missing samples {missing} (mean pose {filled})"
    )
