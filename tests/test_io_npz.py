"""NPZ: exact round trips, the layout of the shared clips, and one sentence for each defect."""

import io
import pickle
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from test_io_csv import motions, same

from motionrecover.io import MotionFormatWarning, load, save
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

ARRAYS = {
    "positions": np.arange(12, dtype=np.float32).reshape(2, 2, 3),
    "names": np.array(["hip", "knee"]),
    "parents": np.array([-1, 0]),
    "fps": np.array(120.0),
    "skeleton": np.array("made up"),
    "source": np.array("clip.amc"),
}


def write(folder, without=(), **changes):
    path = folder / "clip.npz"
    np.savez(path, **{name: value for name, value in (ARRAYS | changes).items() if name not in without})
    return path


@settings(deadline=None, max_examples=60, derandomize=True)
@given(motion=motions())
def test_round_trip_is_exact(tmp_path_factory, motion):
    path = tmp_path_factory.mktemp("npz") / "clip.npz"
    clean = tuple(line.replace("\0", "") for line in motion.history)
    motion = Motion(motion.positions, motion.skeleton, motion.fps, motion.observed, motion.confidence, history=clean)
    same(motion, load(save(motion, path)))


def test_without_parents_there_are_no_bones(tmp_path):
    with pytest.warns(MotionFormatWarning, match="no distance stays the same"):
        motion = load(write(tmp_path, ["parents"]))
    assert motion.skeleton == Skeleton(["hip", "knee"])


def test_saved_file_has_the_layout_of_the_shared_clips(tmp_path):
    skeleton = Skeleton.standard("cmu31")
    path = save(Motion(np.zeros((2, 31, 3)), skeleton, 120), tmp_path / "clip.npz")
    with np.load(path) as arrays:
        assert {"positions", "names", "parents", "fps", "skeleton", "source"} <= set(arrays.files)
        assert tuple(arrays["parents"]) == skeleton.parents
        assert arrays["skeleton"] == "cmu31"


def test_plain_layout_is_metres_with_y_up(tmp_path):
    motion = load(write(tmp_path))
    np.testing.assert_array_equal(motion.positions, ARRAYS["positions"])
    assert motion.positions.dtype == np.float32
    assert (motion.fps, motion.unit, motion.up, motion.names) == (120, 1, "y", ("hip", "knee"))
    assert "clip.amc" in motion.history[-1]


def test_arguments_go_before_the_file_and_the_file_before_the_layout(tmp_path):
    path = write(tmp_path, unit=np.array(0.01), up=np.array("z"))
    np.testing.assert_allclose(load(path).positions[0, 1], [0.03, 0.05, -0.04])
    motion = load(path, unit="mm", up="y", fps=10, skeleton=Skeleton(["knee", "hip"], [(0, 1)]))
    np.testing.assert_allclose(motion.positions[0, 0], [0.003, 0.004, 0.005])
    assert (motion.fps, motion.names) == (10, ("knee", "hip"))


@pytest.mark.parametrize(
    ("without", "changes", "words"),
    [
        ("positions", {}, ["'positions'"]),
        ("names", {}, ["'names'"]),
        ("fps", {}, ["fps=", "--fps"]),
        ("", {"positions": np.zeros((2, 6))}, ["positions of shape (2, 6)"]),
        ("", {"positions": np.zeros((0, 2, 3))}, ["0 frames"]),
        ("", {"positions": np.full((1, 2, 3), np.inf)}, ["infinite", "'hip'"]),
        ("", {"positions": np.full((1, 2, 3), "a")}, ["<U1"]),
        ("", {"names": np.array(["hip"])}, ["names of shape (1,)", "(2,)"]),
        ("", {"names": np.array(["hip", "hip"])}, ["'hip'", "more than once"]),
        ("", {"parents": np.array([-1, 0, 1])}, ["parents of shape (3,)"]),
        ("", {"parents": np.array([-1, 7])}, ["7"]),
        ("", {"parents": np.array([-1, np.inf])}, ["parents", "whole numbers"]),
        ("parents", {"edges": np.array([0, 1])}, ["edges of shape (2,)"]),
        ("", {"rest_offsets": np.zeros((2, 2))}, ["rest_offsets of shape (2, 2)"]),
        ("", {"observed": np.ones((2, 3))}, ["observed of shape (2, 3)"]),
        ("", {"confidence": np.ones(2)}, ["confidence of shape (2,)"]),
        ("", {"fps": np.array(-1.0)}, ["-1.0"]),
        ("", {"fps": np.array([30.0, 30.0])}, ["fps of shape (2,)"]),
        ("", {"unit": np.array("yard")}, ["'yard'"]),
        ("", {"up": np.array("w")}, ["'w'"]),
        ("", {"names": np.array([{}, []], object)}, ["plain arrays"]),
    ],
)
def test_each_defect_is_told_in_one_sentence(tmp_path, refused, without, changes, words):
    path = write(tmp_path, without=[without], **changes)
    refused(lambda: load(path), str(path), *words)


def test_damaged_and_foreign_files_are_told_in_one_sentence(tmp_path, refused):
    path = write(tmp_path)
    whole = path.read_bytes()
    for size in (10, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:size])
        refused(lambda: load(path), str(path), "damaged")
    middle = len(whole) // 4
    path.write_bytes(whole[:100] + bytes(middle) + whole[100 + middle :])
    refused(lambda: load(path), str(path), "damaged")
    for content in (b"", b"  "):
        path.write_bytes(content)
        refused(lambda: load(path), str(path), "empty")
    single = io.BytesIO()
    np.save(single, np.zeros(3))
    for content in (single.getvalue(), pickle.dumps([1, 2]), b"just text"):
        path.write_bytes(content)
        refused(lambda: load(path), str(path), "no NPZ file")
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("positions", "text")
    refused(lambda: load(path), str(path))
    refused(lambda: load(tmp_path / "none.npz"), "none.npz", "does not exist")


def test_real_clips_load(shared_data):
    for name in ("05_01", "09_10"):
        motion = load(shared_data / "cmu" / "npz" / f"{name}.npz")
        assert motion.skeleton == Skeleton.standard("cmu31")
        assert (motion.fps, motion.positions.dtype) == (120, np.float32)
