"""Arguments that commands share. What else a command needs it imports when it runs: help and completion stay fast."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from motionrecover import presets
from motionrecover.cli import settings
from motionrecover.standards import STANDARDS

_READING = "How to read (goes before what the file says)"

Input = Annotated[
    Path,
    typer.Argument(
        metavar="IN",
        help="Motion file: BVH, AMC with its ASF beside it, C3D, TRC, CSV (also of Kinect), NPZ, or NPY of FreeMoCap.",
    ),
]
Output = Annotated[
    Path, typer.Option("--output", "-o", metavar="OUT", help="File to write: .npz, .csv, .bvh, .c3d or .trc.")
]
Format = Annotated[
    str | None,
    typer.Option("--format", metavar="NAME", help="Format, if the ending does not tell it.", rich_help_panel=_READING),
]
SkeletonName = Annotated[
    str | None,
    typer.Option(
        "--skeleton",
        metavar="NAME|FILE",
        autocompletion=lambda: [*STANDARDS, "infer"],
        help=f"Bones, where the file has none: {', '.join(STANDARDS)}, infer, or a TOML file; for AMC its ASF.",
        rich_help_panel=_READING,
    ),
]
Unit = Annotated[
    str | None,
    typer.Option(
        "--unit", metavar="UNIT", help="m, cm, mm, in, ft, or the metres in one unit.", rich_help_panel=_READING
    ),
]
Up = Annotated[
    str | None, typer.Option("--up", metavar="AXIS", help="Axis that points up: x, y or z.", rich_help_panel=_READING)
]
Fps = Annotated[float | None, typer.Option("--fps", metavar="RATE", help="Frames a second.", rich_help_panel=_READING)]
SkipFirst = Annotated[
    bool,
    typer.Option(
        "--skip-first", help="Leave frame 0 out, an added T-pose in some BVH files.", rich_help_panel=_READING
    ),
]
PRESET = "robust"
Preset = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help=f"Model: {', '.join(presets.PRESETS)}.",
        autocompletion=lambda: list(presets.PRESETS),
    ),
]
BoneLengths = Annotated[
    Literal["auto", "estimate", "rest"],
    typer.Option(
        help="Bone lengths from the clip itself, or from the rest pose in the file. auto: from the rest pose of a "
        "BVH whose frames keep it, else from the clip."
    ),
]
MaxGap = Annotated[
    int | None, typer.Option(min=0, metavar="FRAMES", help="Leave longer gaps missing instead of filling them.")
]
FillUnseen = Annotated[
    bool, typer.Option("--fill-unseen", help="Place joints that no frame shows by their bones alone.")
]
PlantFeet = Annotated[bool, typer.Option("--plant-feet", help="Hold feet in place while they stand on the ground.")]
Symmetric = Annotated[
    bool, typer.Option("--symmetric", help="Draw estimated lengths of left and right bones together.")
]
MaxSteps = Annotated[int | None, typer.Option(min=1, metavar="N", help="Stop after so many steps.")]
Dtype = Annotated[Literal["float32", "float64"], typer.Option(help="Precision of the answer.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
NoCache = Annotated[
    bool, typer.Option("--no-cache", help="Compile anew, and keep nothing in ~/.cache/motionrecover for the next time.")
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same file.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print the solver's trace.")]
Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        is_eager=True,
        callback=settings.take,
        help="Take settings from a TOML file, whose keys are the flags: max-gap = 30. Flags given here go before.",
    ),
]
