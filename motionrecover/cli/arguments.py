"""What the commands have in common: how a file is read, where an answer may be written, which joints are compared."""

from __future__ import annotations

import importlib.util
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from motionrecover.figures import FIGURES
from motionrecover.io import MotionFormatError, formats, write_beside
from motionrecover.motion import Motion
from motionrecover.report.account import measured
from motionrecover.skeleton import STANDARDS

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
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
NoCache = Annotated[
    bool, typer.Option("--no-cache", help="Compile anew, and keep nothing in ~/.cache/motionrecover for the next time.")
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same file.")]


class _Rehearsed(Exception):
    """Ends a rehearsal of writing."""


def check_output(path: Path, overwrite: bool, format: str | None = None) -> None:
    """Refuse, before any work, a motion file that could not be written after it."""
    writable = [known for known in formats() if known.writes]
    if not any(format == known.name or (not format and path.suffix.lower() in known.suffixes) for known in writable):
        endings = " or ".join(suffix for known in writable for suffix in known.suffixes)
        raise MotionFormatError(
            f"{path} cannot be written as {format or path.suffix or 'a file without an ending'}: "
            f"give a name that ends in {endings}"
        )
    check_place(path, overwrite)


def check_place(path: Path, overwrite: bool) -> None:
    """Refuse a file that exists or that cannot be created, and leave no trace."""
    with suppress(_Rehearsed), write_beside(path, overwrite=overwrite):
        raise _Rehearsed


def check_figures(folder: Path, overwrite: bool) -> None:
    """Refuse, before any work, a folder of pictures that could not be drawn after it."""
    if importlib.util.find_spec("matplotlib") is None:
        raise ValueError("a figure needs matplotlib: pip install motionrecover[figures]")
    check_folder(folder)
    for name in FIGURES if folder.exists() else ():
        check_place(folder / name, overwrite)


def check_folder(folder: Path) -> None:
    """Refuse a folder that is a file."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is no folder: give the name of one")


def check_report(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, a report that could not be written after it."""
    if path.suffix.lower() != ".html":
        raise ValueError(f"{path} is no name of a report: give one that ends in .html")
    if importlib.util.find_spec("plotly") is None:
        raise ValueError("a report needs plotly: pip install motionrecover[report]")
    check_place(path, overwrite)


def matched(truth: Motion, clip: Motion, truth_path: Path, path: Path) -> tuple[Motion, list[str]]:
    """`truth` on the joints of `clip`, NaN where it has none, and the joints that both name.

    Raises `ValueError` where nothing fits.
    """
    if len(truth) != len(clip):
        raise ValueError(
            f"{path} has {len(clip)} frames and {truth_path} has {len(truth)}: give clips of the same frames "
            "(`motionrecover convert --skip-first` removes an added T-pose)"
        )
    common = [name for name in clip.names if name in truth.names]
    if not common:
        raise ValueError(
            f"{path} and {truth_path} have no joint name in common: the first has {_some(clip.names)}, "
            f"the second {_some(truth.names)}"
        )
    positions = np.full(clip.positions.shape, np.nan)
    to, source = ([motion.names.index(name) for name in common] for motion in (clip, truth))
    positions[:, to] = measured(truth)[:, source]
    return replace(clip, positions=positions, observed=None, confidence=None), common


def _some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
