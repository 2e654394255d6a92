"""NPZ: NumPy arrays in a zip file, read and written, exact.

Arrays: `positions` (frame, joint, 3) in metres with y up, float32 or float64, NaN where missing; `names` (joint,);
`parents` (joint,), -1 for a root, or `edges` (bone, 2) for any graph; `fps`; `skeleton`, the name of a standard or
"custom"; `source`, where the clip comes from. Optional: `observed` and `confidence` (frame, joint), `rest_offsets`
(joint, 3), `unit` (metres in one unit) and `up` of these positions, `history`. Nothing is ever unpickled.
"""

from __future__ import annotations

import io
import struct
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
    refuse_swollen,
    up_axis,
)
from motionrecover.io.errors import MotionFormatError
from motionrecover.io.npy import array_of
from motionrecover.motion import Motion
from motionrecover.skeleton import STANDARDS, Skeleton

KINDS = {
    **dict.fromkeys(("positions", "fps", "rest_offsets", "confidence", "parents", "edges"), "fiu"),
    **dict.fromkeys(("names", "source", "up", "history"), "UfiuS"),
    "unit": "fiuU",
    "observed": "bfiu",
}
"""The arrays that mean something, with the kinds of type they can have, as NumPy's `dtype.kind`."""
WHOLE = ("parents", "edges")
PACKED, SMALL = 8, 2**22
"""A file unpacks to so many times its size at most, or to so many bytes; clips that move pack to a half or less."""


def read(path: Path, asked: Asked) -> Motion:
    """Motion of an NPZ file, in the dtype it has; without `unit` and `up` the file is in metres with y up.

    Raises `MotionFormatError` for a file that is no whole zip of plain arrays, lacks one, or holds a misshapen one.
    """
    arrays = _arrays(path)
    for needed in ("positions", "names"):
        if needed not in arrays:
            raise MotionFormatError(f"{path} holds {sorted(arrays)}: add the array {needed!r}")
    positions = arrays["positions"]
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise MotionFormatError(
            f"{path} holds positions of shape {positions.shape} and type {positions.dtype}: "
            "store real numbers of shape (frame, joint, 3)"
        )
    frames, joints = positions.shape[:2]
    refuse_swollen(path, sum(array.nbytes for array in arrays.values()), frames, joints)
    names = [str(name) for name in arrays["names"].ravel()]
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
        positions,
        skeleton,
        fps=asked.fps or frame_rate(arrays["fps"].item()),
        unit=asked.unit or metres_in(arrays["unit"].item() if "unit" in arrays else 1.0),
        up=asked.up or up_axis(arrays["up"].item() if "up" in arrays else "y"),
        history=(
            *(str(line) for line in arrays.get("history", np.empty(0, str)).ravel()),
            f"read {path.name} (NPZ): {counted(frames, 'frame')}, {counted(joints, 'joint')}{source}; {note}",
        ),
        order=order,
        observed=arrays.get("observed"),
        confidence=arrays.get("confidence"),
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
    headers = 1000 * len(arrays)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)
        if _dense(sum(array.nbytes for array in arrays.values()) + headers, file.tell()):
            file.seek(0)
            np.savez(file, **arrays)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of the file that mean something."""
    content = read_bytes(path)
    if not content.startswith(b"PK"):
        raise MotionFormatError(
            f"{path} is no NPZ file, which is a zip of NumPy arrays: check its name or give format="
        )
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            found = {info.filename.removesuffix(".npy"): info for info in file.infolist()}
            unpacked = sum(info.file_size for info in found.values())
            if _dense(unpacked, len(content)):
                raise MotionFormatError(
                    f"{path} unpacks to {unpacked:,} bytes, {unpacked / len(content):.0f} times its size: "
                    "save it again with numpy.savez, which does not pack"
                )
            raw = {name: _member(file, info) for name, info in found.items() if name in KINDS}
    except MotionFormatError:
        raise
    except (OSError, ValueError, EOFError, RuntimeError, struct.error, zipfile.BadZipFile, zlib.error) as error:
        raise MotionFormatError(f"{path} is damaged or holds more than plain arrays: save it again") from error
    return {name: _array(path, name, each) for name, each in raw.items()}


def _dense(unpacked: int, size: int) -> bool:
    """Whether a file of a size unpacks to more bytes than are read."""
    return unpacked > max(SMALL, PACKED * size)


def _member(file: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """Bytes of a file in a zip, no more than the zip announces."""
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("NumPy packs in no other way")
    with file.open(info) as packed:
        return packed.read(info.file_size)


def _array(path: Path, name: str, content: bytes) -> np.ndarray:
    """An array of the file, of a kind that its name can have."""
    try:
        array = array_of(content)
    except ValueError as error:
        raise MotionFormatError(f"{path} is damaged or holds more than plain arrays, in {name!r}: {error}") from error
    if array.dtype.kind not in KINDS[name]:
        raise MotionFormatError(f"{path} holds {name} of type {array.dtype}: save it again, with its own type")
    if array.dtype.kind == "f" and name in WHOLE and not (np.isfinite(array) & (array == np.trunc(array))).all():
        raise MotionFormatError(f"{path} holds {name} that are no whole numbers: store indices of joints")
    return array


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
