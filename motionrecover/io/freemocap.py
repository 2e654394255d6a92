"""FreeMoCap NPY: positions (frame, marker, 3) of a tracker's body, in millimetres with z up.

    recording/output_data/mediapipe_body_3d_xyz.npy                  {tracker}_body_3d_xyz, the body alone
    recording/output_data/mediapipe_skeleton_3d.npy                  body, then hands and face; also as
    recording/output_data/mediaPipeSkel_3d_body_hands_face.npy       older versions name it
    recording/output_data/mediapipe_names_and_connections_dict.json  {"body": {"names": [...], "connections": ...}, ...}
    recording/output_data/raw_data/mediapipe_3dData_numFrames_numTrackedPoints_reprojectionError.npy

The body comes first and is what is read. Its names are those of the JSON file beside it; without one, those of the
skeleton asked for, or of the tracker's own keypoints. Where the reprojection errors e (frame, marker), in pixels, are
found, confidence is min(1, median e / e): an error in space grows as the one in the pictures, and the noise of a sample
is taken to be that of its joint over its confidence. None of these files states a rate. Arrays in `raw_data` are not
aligned yet: their axes are a camera's.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from motionrecover.io.bones import INFER, named, skeleton_for
from motionrecover.io.border import Asked, assume, counted, motion_from, read_bytes
from motionrecover.io.errors import MotionFormatError
from motionrecover.io.npy import array_of
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

TRACKERS = {"mediapipe": "mediapipe33", "openpose": "body25", "yolo": "coco17"}
"""The keypoints of the trackers that begin a file's name."""
ERRORS = "*3dData_numFrames_numTrackedPoints_reprojectionError.npy"


def read(path: Path, asked: Asked) -> Motion:
    """Motion of the body in a FreeMoCap array, in the dtype it has.

    `fps` has to be asked for; millimetres with z up are assumed, with a `MotionFormatWarning`. Raises
    `MotionFormatError` for a file that is no whole array of such a shape, and where nothing names its markers.
    """
    positions = _array(path)
    if positions.ndim != 3 or positions.shape[2] != 3 or positions.dtype.kind != "f" or not positions.shape[1]:
        raise MotionFormatError(
            f"{path} holds an array of shape {positions.shape} and type {positions.dtype}: "
            "give real numbers of shape (frame, marker, 3)"
        )
    if asked.fps is None:
        raise MotionFormatError(f"{path} states no frame rate: give that of the cameras, fps= (--fps)")
    frames, markers = positions.shape[:2]
    names, source = _names(path, markers, asked.skeleton)
    positions = positions[:, : len(names)]
    confidence, said = _confidence(path, (frames, len(names)))
    skeleton, order, note = skeleton_for(path, names, None, asked.skeleton, positions)
    history = [
        f"read {path.name} (FreeMoCap): {counted(frames, 'frame')}, {counted(len(names), 'joint')} named by {source}, "
        f"{markers - len(names)} more left out; {said}; {note}"
    ]
    assumed = [word for word, given in (("millimetres", asked.unit), ("z up", asked.up)) if given is None]
    if assumed:
        history.append(
            assume(
                f"{path.name} states neither unit nor up axis: assumed {' with '.join(assumed)} as FreeMoCap writes, "
                "override with unit= and up= (--unit, --up)"
            )
        )
    return motion_from(
        positions,
        skeleton,
        fps=asked.fps,
        unit=asked.unit or 0.001,
        up=asked.up or "z",
        history=tuple(history),
        order=order,
        confidence=confidence,
    )


def beside(path: Path) -> list[Path]:
    """The files with names and with errors of the tracker that wrote a file."""
    return [*_names_beside(path), *_errors_beside(path)]


def _array(path: Path) -> np.ndarray:
    """The array of an NPY file."""
    content = read_bytes(path)
    try:
        return array_of(content)
    except ValueError as error:
        raise MotionFormatError(f"{path}: {error}") from error


def _names(path: Path, markers: int, asked: Skeleton | str | Path | None) -> tuple[list[str], str]:
    """Names of the body's markers, which are the first of all, and where they come from."""
    tracker = _tracker(path)
    listed = next(iter(_names_beside(path)), None)
    if listed is not None:
        names, source = _body(listed), listed.name
    elif asked not in (None, INFER):
        names, source = named(asked).names, "the skeleton asked for"
    elif tracker in TRACKERS:
        names, source = Skeleton.standard(TRACKERS[tracker]).names, TRACKERS[tracker]
    else:
        raise MotionFormatError(
            f"{path} holds {counted(markers, 'marker')} without names: put FreeMoCap's "
            "*_names_and_connections_dict.json beside it or give skeleton= (--skeleton)"
        )
    if len(names) > markers:
        raise MotionFormatError(
            f"{path} holds {counted(markers, 'marker')} and {source} names {len(names)}: give a skeleton of its markers"
        )
    return list(names), source


def _body(path: Path) -> list[str]:
    """Names of the body's markers in FreeMoCap's JSON file."""
    try:
        names = json.loads(path.read_text(encoding="utf-8"))["body"]["names"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise MotionFormatError(f'{path} has no list "names" in "body": copy it again or take it away') from error
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise MotionFormatError(f'{path} has {type(names).__name__} as "names" of "body": write a list of names')
    return names


def _confidence(path: Path, shape: tuple[int, int]) -> tuple[np.ndarray | None, str]:
    """Confidence (frame, marker) from the reprojection errors beside a file, None without, and a line of history."""
    found = _errors_beside(path)
    if not found:
        return None, "no reprojection errors beside it"
    errors = _array(found[0])
    if errors.ndim != 2 or errors.dtype.kind != "f" or len(errors) != shape[0] or errors.shape[1] < shape[1]:
        return None, f"left out {found[0].name}, whose shape {errors.shape} is not that of its frames and markers"
    errors = errors[:, : shape[1]].astype(np.float64)
    usual = np.nanmedian(errors) if np.isfinite(errors).any() else 0.0
    if not usual > 0:
        return None, f"left out {found[0].name}, which has no errors above 0"
    return usual / np.maximum(errors, usual), f"confidence is {usual:.3g} px over the reprojection error"


def _names_beside(path: Path) -> list[Path]:
    return _of_its_tracker(path, path.parents[:2], "*names_and_connections*.json")


def _errors_beside(path: Path) -> list[Path]:
    return _of_its_tracker(path, (path.parent, path.parent / "raw_data"), ERRORS)


def _of_its_tracker(path: Path, folders: Iterable[Path], pattern: str) -> list[Path]:
    found = [file for folder in folders for file in sorted(folder.glob(pattern))]
    return [file for file in found if _tracker(file) == _tracker(path)]


def _tracker(path: Path) -> str:
    """What the name of a file begins with: mediapipe of mediapipe_body_3d_xyz.npy and mediaPipeSkel_3d.npy."""
    name = path.name.lower()
    return next((tracker for tracker in TRACKERS if name.startswith(tracker)), name.partition("_")[0])
