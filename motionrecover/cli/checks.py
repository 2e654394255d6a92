"""What commands refuse before any work, and which joints two files share."""

from __future__ import annotations

import importlib.util
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionrecover.figures import FIGURES
from motionrecover.io import MotionFormatError, formats, write_beside
from motionrecover.motion import Motion
from motionrecover.report.account import measured


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
    check_plotly()
    check_place(path, overwrite)


def check_plotly() -> None:
    """Refuse a report, before any work, where nothing can draw it."""
    if importlib.util.find_spec("plotly") is None:
        raise ValueError("a report needs plotly: pip install motionrecover[report]")


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
