"""Poses datasets of movement: the layout of its validator, round trips, and what is refused."""

import sys

import numpy as np
import pytest
from hypothesis import given
from test_io_csv import motions

from motionrecover import Motion, Skeleton, from_xarray, to_xarray
from motionrecover.io import MotionFormatWarning

xarray = pytest.importorskip("xarray")

COCO = Skeleton.standard("coco17")
POSITIONS = np.random.default_rng(0).normal(size=(6, 17, 3))


def dataset(individuals=("a", "b"), positions=POSITIONS, **attrs):
    """A dataset as movement makes it."""
    both = np.stack([positions + k for k in range(len(individuals))], -1).transpose(0, 2, 1, 3)
    names = ("time", "space", "keypoints", "individuals")
    return xarray.Dataset(
        {"position": (names, both), "confidence": (("time", *names[2:]), np.full_like(both[:, 0], 0.5))},
        coords={
            "time": np.arange(len(both)) / 25,
            "space": list("xyz"[: both.shape[1]]),
            "keypoints": list(COCO.names),
            "individuals": list(individuals),
        },
        attrs={"fps": 25.0, "time_unit": "seconds", "source_software": "Anipose", "ds_type": "poses"} | attrs,
    )


@given(motion=motions())
def test_round_trip_is_exact(motion):
    again = from_xarray(to_xarray(motion))
    expected = np.where(motion.observed[..., None], motion.positions, np.nan)
    np.testing.assert_array_equal(again.positions, expected)
    np.testing.assert_array_equal(again.observed, motion.observed)
    assert (again.skeleton.names, again.skeleton.edges) == (motion.skeleton.names, motion.skeleton.edges)
    assert (again.fps, again.history[:-1]) == (motion.fps, motion.history)
    if motion.confidence is not None and np.isfinite(motion.confidence).any():
        np.testing.assert_array_equal(again.confidence, motion.confidence)


def test_the_layout_is_that_of_movement():
    data = to_xarray(Motion(POSITIONS, COCO, 25), individual="Aeon")
    assert data["position"].dims == ("time", "space", "keypoints", "individuals")
    assert data["confidence"].dims == ("time", "keypoints", "individuals")
    assert data["confidence"].isnull().all()
    assert (data.attrs["ds_type"], data.attrs["time_unit"], data.attrs["fps"]) == ("poses", "seconds", 25.0)
    np.testing.assert_allclose(data["time"], np.arange(6) / 25)
    elbow = data["position"].sel(keypoints="left_elbow", individuals="Aeon", space="y")
    np.testing.assert_array_equal(elbow, POSITIONS[:, 7, 1])


def test_one_of_several_individuals_is_named():
    with pytest.warns(MotionFormatWarning, match="up=") as said:
        motion = from_xarray(dataset(), individual="b", unit="mm")
    assert said[0].filename == __file__
    np.testing.assert_allclose(motion.positions, (POSITIONS + 1) / 1000)
    assert (motion.skeleton, motion.fps) == (COCO, 25)
    np.testing.assert_array_equal(motion.confidence, np.full((6, 17), 0.5))
    assert "Anipose" in motion.history[0]
    assert "coco17" in motion.history[0]


def test_order_of_dimensions_and_frames_as_unit_of_time_do_not_matter():
    data = dataset(["a"], time_unit="frames", unit="cm", up="z").assign_coords(time=np.arange(6))
    turned = data.transpose("individuals", "keypoints", "time", "space")
    np.testing.assert_array_equal(from_xarray(turned).positions, from_xarray(data).positions)
    np.testing.assert_allclose(from_xarray(data).positions[0, 0], POSITIONS[0, 0, [0, 2, 1]] * [0.01, 0.01, -0.01])


@pytest.mark.parametrize(
    ("change", "asked", "words"),
    [
        (lambda data: data.drop_vars("position"), {}, ["'position'"]),
        (lambda data: data.isel(individuals=0), {}, ["four dimensions"]),
        (lambda data: data.isel(space=[0, 1]), {}, ["x, y and z"]),
        (lambda data: data.isel(time=[0, 1, 4]), {}, ["1 to 3 frames apart", "fps="]),
        (lambda data: data.drop_attrs(), {"unit": "m"}, ["no fps"]),
        (lambda data: data, {"individual": "c"}, ["'c'", "['a', 'b']"]),
        (lambda data: data, {"individual": None}, ["individual="]),
        (lambda data: data, {"unit": None}, ["no unit", "unit="]),
        (lambda data: data, {"skeleton": "smpl24"}, ["the dataset", "pelvis"]),
    ],
)
def test_what_is_no_dataset(refused, change, asked, words):
    arguments = {"individual": "a", "unit": "m", "up": "y"} | asked
    refused(lambda: from_xarray(change(dataset()), **arguments), *words)


def test_without_xarray_the_command_that_installs_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r"pip install motionrecover\[xarray\]"):
        to_xarray(Motion(POSITIONS, COCO, 25))
