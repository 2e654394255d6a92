"""The registry, and writing that never leaves half a file."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from motionrecover.io import Format, MotionFormatError, formats, load, save, write_beside
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

MOTION = Motion(np.arange(12.0).reshape(2, 2, 3), Skeleton(["hip", "knee"], [("hip", "knee")]), 30)


def test_formats_tell_what_they_read_and_write():
    table = {known.name: (known.suffixes, known.reads, known.writes) for known in formats()}
    assert table == {
        "bvh": ((".bvh",), True, True),
        "amc": ((".amc", ".asf"), True, False),
        "c3d": ((".c3d",), True, True),
        "trc": ((".trc",), True, True),
        "kinect": ((".csv",), True, False),
        "csv": ((".csv",), True, True),
        "csv-long": ((), True, True),
        "npz": ((".npz",), True, True),
        "freemocap": ((".npy",), True, False),
    }
    assert all(known.description for known in formats())


@pytest.mark.parametrize("name", ["clip.csv", "clip.CSV", "clip.npz"])
def test_the_ending_chooses_the_format_and_overwriting_is_asked_for(tmp_path, refused, name):
    path = tmp_path / name
    assert save(MOTION, str(path)) == path
    before = path.read_bytes()
    refused(lambda: save(MOTION, path), str(path), "overwrite=True", error=FileExistsError)
    assert path.read_bytes() == before
    save(MOTION.with_positions(-MOTION.positions, "mirrored"), path, overwrite=True)
    np.testing.assert_array_equal(load(path).positions, -MOTION.positions)
    assert list(tmp_path.iterdir()) == [path]


def test_a_format_is_given_by_name_or_from_outside(tmp_path, refused):
    path = save(MOTION, tmp_path / "clip.table", format="csv")
    np.testing.assert_array_equal(load(path, format="csv").positions, MOTION.positions)
    outside = Format(
        "count", (), "number of frames", write=lambda motion, path: path.write_text(str(len(motion))) and None
    )
    assert save(MOTION, tmp_path / "clip.count", format=outside).read_text() == "2"
    refused(lambda: load(tmp_path / "clip.count", format=outside), "clip.count", "not read")
    refused(lambda: load(path), str(path), ".table", "npz")
    refused(lambda: save(MOTION, tmp_path / "clip"), "clip", "format=")
    refused(lambda: load(path, format="fbx"), "'fbx'", "bvh", error=ValueError)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"fps": -1}, ["-1", "above 0"]),
        ({"fps": 0}, ["0", "above 0"]),
        ({"fps": np.nan}, ["nan"]),
        ({"unit": "yard"}, ["'yard'", "cm"]),
        ({"unit": 0}, ["0", "above 0"]),
        ({"unit": "-1"}, ["'-1'"]),
        ({"unit": np.inf}, ["inf"]),
        ({"up": "w"}, ["'w'", "x, y, z"]),
    ],
)
def test_unusable_arguments_are_told_in_one_sentence(tmp_path, refused, arguments, words):
    path = save(MOTION, tmp_path / "clip.npz")
    refused(lambda: load(path, **arguments), *words, error=ValueError)


def test_skip_first_keeps_the_masks(tmp_path):
    motion = Motion(
        MOTION.positions, MOTION.skeleton, 30, np.array([[1, 1], [0, 1]], bool), np.array([[1, 2], [3, 4]]) / 4
    )
    rest = load(save(motion, tmp_path / "clip.npz"), skip_first=True)
    assert rest.observed.tolist() == [[False, True]]
    assert rest.confidence.tolist() == [[0.75, 1.0]]
    assert len(rest) == 1


def test_a_failure_leaves_the_old_file_and_no_other(tmp_path, refused):
    path = tmp_path / "clip.csv"
    path.write_text("old")

    def broken():
        with write_beside(path, overwrite=True) as temporary:
            assert (temporary.parent, temporary.suffix) == (tmp_path, ".csv")
            temporary.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        broken()
    assert path.read_text() == "old"

    def full():
        with write_beside(path, overwrite=True):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    refused(full, str(path), "No space left", error=OSError)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_folders_that_cannot_be_written_to_are_told_in_one_sentence(tmp_path, refused, monkeypatch):
    refused(lambda: save(MOTION, tmp_path / "no" / "clip.csv"), "clip.csv", "no folder", error=FileNotFoundError)
    (tmp_path / "folder.csv").mkdir()
    for overwrite in (False, True):
        refused(
            lambda overwrite=overwrite: save(MOTION, tmp_path / "folder.csv", overwrite=overwrite),
            "is a folder",
            error=IsADirectoryError,
        )
    long = tmp_path / f"{'a' * 300}.csv"
    refused(lambda: save(MOTION, long), str(long), "could not be written", error=OSError)

    def forbidden(*_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(Path, "open", forbidden)
    refused(lambda: save(MOTION, tmp_path / "clip.csv"), "clip.csv", "Permission denied", error=OSError)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.csv"]


def test_a_link_is_followed_and_permissions_are_those_of_a_new_file(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    target, link, plain = tmp_path / "elsewhere" / "clip.csv", tmp_path / "clip.csv", tmp_path / "plain"
    target.write_text("old")
    link.symlink_to(target)
    save(MOTION, link, overwrite=True)
    assert link.is_symlink()
    np.testing.assert_array_equal(load(target).positions, MOTION.positions)
    plain.write_text("")
    assert target.stat().st_mode == plain.stat().st_mode


def test_importing_does_not_load_pybvh():
    code = "import sys, motionrecover.io; print(sorted({'pybvh'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_errors_of_this_package_are_value_errors():
    assert issubclass(MotionFormatError, ValueError)
