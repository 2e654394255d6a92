"""Poses datasets of the package movement, in memory: an xarray.Dataset in dims time, space, keypoints, individuals.

Variables: `position` (time, space, keypoints, individuals) and `confidence` (time, keypoints, individuals), NaN where
missing or unknown. Attributes: `fps`, `time_unit` (seconds or frames), `source_software` and `ds_type`, as movement's
`ValidPosesInputs` makes them. What movement has no place for is in further attributes: `unit`, `up`, and as JSON
`bones`, pairs of keypoints, and `motion_history`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motionrecover.io.bones import skeleton_for
from motionrecover.io.border import assume, counted, frame_rate, metres_in, motion_from, up_axis
from motionrecover.io.errors import MotionFormatError
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

if TYPE_CHECKING:
    import xarray

DIMS = ("time", "space", "keypoints", "individuals")
_NAME = "the dataset"


def to_xarray(motion: Motion, individual: str = "id_0") -> xarray.Dataset:
    """The poses dataset of a motion, in metres with y up, with one individual.

    What was not observed is NaN; rest offsets and the rig of a BVH are left out. Raises `ImportError` without xarray.
    """
    try:
        import xarray
    except ImportError as error:
        raise ImportError("datasets need xarray: pip install motionrecover[xarray]") from error
    bones = [[motion.names[i], motion.names[j]] for i, j in motion.skeleton.edges]
    confidence = np.full(motion.observed.shape, np.nan) if motion.confidence is None else motion.confidence
    positions = np.where(motion.observed[..., None], motion.positions, np.nan)
    return xarray.Dataset(
        {
            "position": (DIMS, positions.transpose(0, 2, 1)[..., None]),
            "confidence": ((DIMS[0], *DIMS[2:]), np.asarray(confidence, float)[..., None]),
        },
        coords={
            "time": np.arange(len(motion)) / motion.fps,
            "space": ["x", "y", "z"],
            "keypoints": list(motion.names),
            "individuals": [individual],
        },
        attrs={
            "ds_type": "poses",
            "source_software": "motionrecover",
            "fps": float(motion.fps),
            "time_unit": "seconds",
            "unit": "m",
            "up": "y",
            "bones": json.dumps(bones, ensure_ascii=False),
            "motion_history": json.dumps(motion.history, ensure_ascii=False),
        },
    )


def from_xarray(
    dataset: xarray.Dataset,
    *,
    individual: str | None = None,
    skeleton: Skeleton | str | Path | None = None,
    unit: str | float | None = None,
    up: str | None = None,
    fps: float | None = None,
) -> Motion:
    """Motion of one individual of a poses dataset in three dimensions.

    `individual` names it where there are several; the others go before what the dataset says, as in `load`. The unit
    has to be stated or given; an up axis that neither states is assumed to be y, with a `MotionFormatWarning`.

    Raises `MotionFormatError` for a dataset of another make, of two dimensions, or without a constant rate.
    """
    lost = [name for name in ("position", *DIMS) if name not in dataset.variables]
    if lost or dataset["position"].ndim != len(DIMS):
        raise MotionFormatError(
            f"received a dataset without {lost or 'four dimensions'}: give a poses dataset of movement, position in "
            f"{', '.join(DIMS)}"
        )
    if [str(axis) for axis in dataset["space"].values] != ["x", "y", "z"]:
        raise MotionFormatError(f"received a dataset in {list(dataset['space'].values)}: give x, y and z")
    names = [str(name) for name in dataset["individuals"].values]
    chosen = individual if individual is not None or len(names) != 1 else names[0]
    if chosen not in names:
        raise MotionFormatError(f"received individual {individual!r} of a dataset of {names}: give individual=")
    one = dataset.sel(individuals=chosen)
    positions = one["position"].transpose("time", "keypoints", "space").values
    joints = [str(name) for name in one["keypoints"].values]
    confidence = one["confidence"].transpose("time", "keypoints").values if "confidence" in one else None
    if confidence is not None and np.isnan(confidence).all():
        confidence = None
    told = dataset.attrs
    metres = metres_in(unit if unit is not None else _stated(told, "unit"))
    history = json.loads(told.get("motion_history", "[]"))
    source = told.get("source_software") or "an unnamed program"
    own = Skeleton(joints, json.loads(told["bones"])) if "bones" in told else None
    taken, order, note = skeleton_for(_NAME, joints, own, skeleton, positions)
    history.append(
        f"took individual {chosen} of a dataset of {source}: {counted(len(positions), 'frame')}, "
        f"{counted(len(joints), 'joint')}; {note}"
    )
    if up is None and "up" not in told:
        history.append(assume("the dataset states no up axis: assumed y, override with up=", deeper=-1))
    return motion_from(
        positions,
        taken,
        fps=frame_rate(fps) if fps is not None else _rate(dataset),
        unit=metres,
        up=up_axis(up or told.get("up", "y")),
        history=tuple(history),
        order=order,
        confidence=confidence,
    )


def _rate(dataset: xarray.Dataset) -> float:
    """Frames a second, of which the times must be multiples where they are seconds."""
    rate = frame_rate(_stated(dataset.attrs, "fps"))
    steps = np.diff(dataset["time"].values) * (rate if dataset.attrs.get("time_unit") == "seconds" else 1)
    if not np.allclose(steps, 1, atol=0.01):
        raise MotionFormatError(
            f"received a dataset at {rate:g} frames a second whose times are {steps.min():.3g} to {steps.max():.3g} "
            "frames apart: reindex it to every frame, or give fps="
        )
    return rate


def _stated(told: dict[str, Any], name: str) -> Any:
    if told.get(name) is None:
        raise MotionFormatError(f"the dataset states no {name}: give {name}= or set the attribute {name!r}")
    return told[name]
