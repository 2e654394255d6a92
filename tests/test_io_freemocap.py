"""FreeMoCap NPY: names, errors and units of a recording folder, and one sentence for each defect."""

import json
import pickle
import warnings

import numpy as np
import pytest

from motionrecover.io import MotionFormatWarning, load
from motionrecover.skeleton import Skeleton

MEDIAPIPE = Skeleton.standard("mediapipe33")
BODY = np.random.default_rng(0).normal(scale=500, size=(9, 33, 3))
ERRORS = "mediapipe_3dData_numFrames_numTrackedPoints_reprojectionError.npy"


@pytest.fixture
def recording(tmp_path):
    """A recording's output folder: the body, and all tracked points."""
    (tmp_path / "raw_data").mkdir()
    np.save(tmp_path / "mediapipe_body_3d_xyz.npy", BODY)
    np.save(tmp_path / "mediaPipeSkel_3d_body_hands_face.npy", np.concatenate([BODY, np.ones((9, 520, 3))], 1))
    return tmp_path


def read(path, **asked):
    """The motion, with what was assumed left unsaid."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MotionFormatWarning)
        return load(path, **{"fps": 30} | asked)


@pytest.mark.parametrize("name", ["mediapipe_body_3d_xyz.npy", "mediaPipeSkel_3d_body_hands_face.npy"])
def test_the_body_is_mediapipe33_in_millimetres_with_z_up(recording, name):
    with pytest.warns(MotionFormatWarning, match="millimetres with z up"):
        motion = load(recording / name, fps=30)
    assert motion.skeleton == MEDIAPIPE
    x, y, z = np.moveaxis(BODY / 1000, -1, 0)
    np.testing.assert_allclose(motion.positions, np.stack([x, z, -y], -1))
    assert (motion.unit, motion.up, motion.fps, motion.confidence) == (0.001, "z", 30, None)


def test_nothing_is_assumed_that_is_given(recording):
    motion = load(recording / "mediapipe_body_3d_xyz.npy", fps=30, unit="cm", up="y")
    np.testing.assert_allclose(motion.positions, BODY / 100)
    assert len(motion.history) == 1


def test_names_come_from_the_file_beside_it(recording):
    names = [f"marker {k}" for k in range(5)]
    listed = {"body": {"names": names, "connections": []}, "face": {"names": ["nose"]}}
    (recording / "rtmpose_names_and_connections_dict.json").write_text(json.dumps(listed))
    (recording / "raw_data" / "rtmpose_3dData.npy").write_bytes((recording / "mediapipe_body_3d_xyz.npy").read_bytes())
    chain = Skeleton(names, [(k, k + 1) for k in range(4)])
    motion = read(recording / "raw_data" / "rtmpose_3dData.npy", skeleton=chain, unit="m", up="y")
    assert motion.names == tuple(names)
    np.testing.assert_array_equal(motion.positions, BODY[:, :5])
    assert read(recording / "mediapipe_body_3d_xyz.npy").skeleton == MEDIAPIPE, "another tracker's names are not taken"


def test_a_skeleton_names_the_markers_of_any_array(tmp_path):
    np.save(tmp_path / "take.npy", BODY[:, :17].astype(np.float32))
    motion = read(tmp_path / "take.npy", skeleton="coco17")
    assert motion.skeleton == Skeleton.standard("coco17")
    assert motion.positions.dtype == np.float32


def test_confidence_is_the_usual_error_over_the_error(recording):
    errors = np.full((9, 553), 4.0)
    errors[2, 3], errors[4, 5], errors[6, 7] = 8, 1, np.nan
    np.save(recording / "raw_data" / ERRORS, errors)
    motion = read(recording / "mediapipe_body_3d_xyz.npy")
    assert motion.confidence is not None
    assert (motion.confidence[2, 3], motion.confidence[4, 5], motion.confidence[0, 0]) == (0.5, 1, 1)
    assert np.isnan(motion.confidence[6, 7])
    assert "4 px" in motion.history[0]


@pytest.mark.parametrize("errors", [np.ones((8, 553)), np.ones((9, 32)), np.ones(9), np.zeros((9, 33))])
def test_errors_that_do_not_fit_are_left_out_and_said_so(recording, errors):
    np.save(recording / "raw_data" / ERRORS, errors)
    motion = read(recording / "mediapipe_body_3d_xyz.npy")
    assert motion.confidence is None
    assert f"left out {ERRORS}" in motion.history[0]


def test_gaps_are_missing(recording):
    body = BODY.copy()
    body[3, 4] = np.nan
    np.save(recording / "mediapipe_body_3d_xyz.npy", body)
    assert np.argwhere(~read(recording / "mediapipe_body_3d_xyz.npy").observed).tolist() == [[3, 4]]


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.zeros((9, 33, 2)), ["shape (9, 33, 2)"]),
        (np.zeros((9, 33)), ["shape (9, 33)"]),
        (np.zeros((9, 33, 3), int), ["int64"]),
        (np.zeros((0, 33, 3)), ["0 frames"]),
        (np.zeros((9, 20, 3)), ["20 markers", "33"]),
    ],
)
def test_what_is_no_body(tmp_path, refused, array, words):
    np.save(tmp_path / "mediapipe_body_3d_xyz.npy", array)
    refused(lambda: read(tmp_path / "mediapipe_body_3d_xyz.npy"), "mediapipe_body_3d_xyz.npy", *words)


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("it was unpickled",))


def test_headers_are_checked_before_anything_is_read(recording, refused):
    path = recording / "mediapipe_body_3d_xyz.npy"
    whole = path.read_bytes()
    for content, words in [
        (whole[:-8], ["7120 bytes", "7128"]),
        (whole + b"more", ["7132 bytes"]),
        (whole.replace(b"(9, 33, 3)", b"(9, 33, 9)"), ["21384"]),
        (whole[:20], ["no NPY file"]),
        (whole.replace(b", }", b", {"), ["no NPY file"]),
        (whole.replace(b"<f8", b",f8"), ["no NPY file"]),
        (b"not an array", ["no NPY file"]),
        (b"", ["empty"]),
    ]:
        path.write_bytes(content)
        refused(lambda: read(path), path.name, *words)
    np.save(path, np.array([Bomb()], object), allow_pickle=True)
    refused(lambda: read(path), "objects")
    path.write_bytes(pickle.dumps(Bomb()))
    refused(lambda: read(path), "no NPY file")


def test_what_a_recording_does_not_say_has_to_be_given(recording, refused):
    path = recording / "mediapipe_body_3d_xyz.npy"
    refused(lambda: load(path), "fps=", "--fps")
    other = recording / "take.npy"
    other.write_bytes(path.read_bytes())
    refused(lambda: read(other), "33 markers without names", "--skeleton")
    for text in ("{", '{"body": {}}', '{"body": {"names": "nose"}}', "[]"):
        (recording / "mediapipe_names_and_connections_dict.json").write_text(text)
        refused(lambda: read(path), "mediapipe_names_and_connections_dict.json")
