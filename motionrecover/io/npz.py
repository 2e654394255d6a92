"""NPZ: NumPy arrays in a zip file, read and written, exact.

Arrays: `positions` (frame, joint, 3) in metres with y up, float32 or float64, NaN where missing; `names` (joint,);
`parents` (joint,), -1 for a root, or `edges` (bone, 2) for any graph; `fps`; `skeleton`, the name of a standard or
"custom"; `source`, where the clip comes from. Optional: `observed` and `confidence` (frame, joint), `rest_offsets`
(joint, 3), `unit` (metres in one unit) and `up` of these positions, `history`. Nothing is ever unpickled.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from motionrecover.io.bones import skeleton_for
from motionrecover.io.border import (
    Asked,
    counted,
    frame_rate,
    metres_in,
    motion_from,
    parents_of,
    read_bytes,
    up_axis,
)
from motionrecover.io.errors import MotionFormatError
from motionrecover.motion import Motion
from motionrecover.skeleton import STANDARDS, Skeleton


def read(path: Path, asked: Asked) -> Motion:
    """Motion of an NPZ file, in the dtype it has; without `unit` and `up` the file is in metres with y up.

    Raises `MotionFormatError` for a file that is no whole zip of plain arrays, lacks one, or holds a misshapen one.
    """
    arrays = _arrays(path)
    for needed in ("positions", "names"):
        if needed not in arrays:
            raise MotionFormatError(f"{path} holds {sorted(arrays)}: add the array {needed!r}")
    positions = arrays["positions"]
    if positions.ndim != 3 or positions.shape[2] != 3 or positions.dtype.kind not in "fiu":
        raise MotionFormatError(
            f"{path} holds positions of shape {positions.shape} and type {positions.dtype}: "
            "store real numbers of shape (frame, joint, 3)"
        )
    names = [str(name) for name in arrays["names"].ravel()]
    frames, joints = positions.shape[:2]
    shapes = {
        "names": (joints,),
        "parents": (joints,),
        "observed": (frames, joints),
        "confidence": (frames, joints),
        "rest_offsets": (joints, 3),
        "edges": (len(arrays["edges"]) if arrays.get("edges", np.empty(())).ndim else 0, 2),
        "fps": (),
        "unit": (),
        "up": (),
    }
    for name, shape in shapes.items():
        if name in arrays and arrays[name].shape != shape:
            raise MotionFormatError(
                f"{path} holds {name} of shape {arrays[name].shape} beside positions of shape {positions.shape}: "
                f"store {name} of shape {shape}"
            )
    if asked.fps is None and "fps" not in arrays:
        raise MotionFormatError(f"{path} states no frame rate: give fps= (--fps) or add the array 'fps'")

    skeleton, order, note = skeleton_for(path, names, _own_skeleton(arrays, names), asked.skeleton, positions)
    source = f", from {arrays['source']}" if str(arrays.get("source", "")) else ""
    return motion_from(
        positions[:, order],
        skeleton,
        fps=asked.fps or frame_rate(arrays["fps"].item()),
        unit=asked.unit or metres_in(arrays["unit"].item() if "unit" in arrays else 1.0),
        up=asked.up or up_axis(arrays["up"].item() if "up" in arrays else "y"),
        history=(
            *(str(line) for line in arrays.get("history", np.empty(0, str)).ravel()),
            f"read {path.name} (NPZ): {counted(frames, 'frame')}, {counted(joints, 'joint')}{source}; {note}",
        ),
        observed=arrays["observed"][:, order] if "observed" in arrays else None,
        confidence=arrays["confidence"][:, order] if "confidence" in arrays else None,
    )


def write(motion: Motion, path: Path) -> None:
    """Write a motion, in metres with y up and the dtype it has."""
    skeleton = motion.skeleton
    parents = parents_of(skeleton)
    standard = next((name for name in STANDARDS if _same_bones(Skeleton.standard(name), skeleton)), "custom")
    arrays = {
        "positions": motion.positions,
        "names": np.array(skeleton.names),
        "fps": np.float64(motion.fps),
        "skeleton": np.array(standard),
        "source": np.array("motionrecover"),
        "unit": np.float64(1.0),
        "up": np.array("y"),
        "observed": motion.observed,
        "history": np.array(motion.history, str),
    }
    if parents is None:
        arrays["edges"] = np.array(skeleton.edges, np.int64).reshape(-1, 2)
    else:
        arrays["parents"] = np.array(parents, np.int64)
    if skeleton.rest_offsets is not None:
        arrays["rest_offsets"] = np.array(skeleton.rest_offsets)
    if motion.confidence is not None:
        arrays["confidence"] = np.asarray(motion.confidence, float)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _arrays(path: Path) -> Mapping[str, np.ndarray]:
    """All arrays of the file."""
    content = read_bytes(path)
    if not content.startswith(b"PK"):
        raise MotionFormatError(
            f"{path} is no NPZ file, which is a zip of NumPy arrays: check its name or give format="
        )
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, KeyError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise MotionFormatError(f"{path} is damaged or holds more than plain arrays: save it again") from error


def _own_skeleton(arrays: Mapping[str, np.ndarray], names: list[str]) -> Skeleton | None:
    """The skeleton that the file holds; None where it holds no bones."""
    offsets = arrays.get("rest_offsets")
    if "edges" in arrays:
        return Skeleton(names, arrays["edges"].tolist(), offsets)
    if "parents" in arrays:
        return Skeleton.from_parents(names, arrays["parents"].tolist(), offsets)
    return None


def _same_bones(one: Skeleton, other: Skeleton) -> bool:
    return one.names == other.names and one.edges == other.edges
