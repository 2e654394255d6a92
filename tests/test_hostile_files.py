"""Damaged and absurd files of every format load or are refused with one sentence, soon and in little memory."""

import time
from collections import Counter

import numpy as np
import pytest
from test_io_c3d import composed, steps_and_words

from motionrecover.io import load, save
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton
from tests.mutate import damaged, memory_of, tried
from tests.whole_files import Case, absurd, cases

pytestmark = pytest.mark.filterwarnings("ignore::motionrecover.io.MotionFormatWarning")

FORMATS = ("bvh", "amc", "c3d", "trc", "csv", "csv-long", "npz", "kinect", "freemocap", "toml")
DRAWS = 200
SECONDS = 5
"""Of CPU time."""
MEMORY = 20
"""Times the size of the file, of 100 kB and more."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    found = cases(folder)
    words = steps_and_words(10)
    integers = (composed(*words, scale=scale, analog=np.zeros((10, 3))) for scale in (0.1, -0.1))
    found["c3d"] += [Case("clip.c3d", content) for content in integers]
    return found


def test_every_format_is_damaged(whole):
    assert set(whole) == set(FORMATS)


@pytest.mark.parametrize("format", FORMATS)
def test_whole_files_load(tmp_path, whole, format):
    for case in whole[format]:
        assert tried(case, case.content, tmp_path) == "loaded"


@pytest.mark.parametrize("format", FORMATS)
def test_a_damaged_file_loads_or_is_refused(tmp_path, whole, format):
    outcomes = Counter()
    for draw in range(DRAWS):
        case = whole[format][draw % len(whole[format])]
        content = damaged(case.content, np.random.default_rng([draw, FORMATS.index(format)]))
        folder = tmp_path / str(draw)
        folder.mkdir()
        begun = time.process_time()
        outcomes[tried(case, content, folder)] += 1
        assert time.process_time() - begun < SECONDS
    assert min(outcomes["loaded"], outcomes["refused"]) > 0.05 * DRAWS, outcomes


@pytest.mark.parametrize(("name", "case"), absurd().items(), ids=absurd())
def test_an_absurd_file_takes_neither_time_nor_memory(tmp_path, name, case):
    begun = time.process_time()
    tried(case, case.content, tmp_path, saves=False)
    assert time.process_time() - begun < SECONDS
    assert memory_of(case, case.content, tmp_path) < MEMORY * max(100_000, case.size(case.content))


def chain(joints, frames=2, scale=1.0):
    positions = np.zeros((frames, joints, 3))
    positions[..., 1] = scale * np.arange(joints)
    return Motion(positions, Skeleton.from_parents([f"j{k}" for k in range(joints)], range(-1, joints - 1)), 30)


def test_a_deep_skeleton_is_no_matter_of_recursion(tmp_path):
    motion = chain(1500)
    for name in ("deep.npz", "deep.csv"):
        assert load(save(motion, tmp_path / name)).skeleton == motion.skeleton


def test_what_hardly_changes_is_packed_no_closer_than_it_is_read(tmp_path, refused):
    motion = chain(20, frames=20_000)
    assert len(load(save(motion, tmp_path / "still.npz"))) == 20_000
    np.savez_compressed(tmp_path / "packed.npz", positions=motion.positions, names=motion.names, fps=30)
    refused(lambda: load(tmp_path / "packed.npz"), "packed.npz", "numpy.savez")


@pytest.mark.parametrize("format", ["bvh", "c3d", "trc", "csv", "csv-long", "npz"])
def test_the_farthest_positions_are_written(tmp_path, format):
    motion = chain(3, scale=4e8)
    back = load(save(motion, tmp_path / "far", format=format), format=format, unit="m" if format == "bvh" else None)
    np.testing.assert_allclose(back.positions[:, :3], motion.positions, rtol=1e-6)


@pytest.mark.parametrize("name", ["a{b", "a  b", " a", "a\udc80", "a\tb", ""])
def test_names_that_a_format_cannot_hold_leave_no_file(tmp_path, name):
    motion = Motion(np.arange(12.0).reshape(2, 2, 3), Skeleton([name, "b"], [(0, 1)]), 30)
    for format in ("bvh", "c3d", "trc", "csv", "csv-long", "npz"):
        path = tmp_path / "clip"
        try:
            save(motion, path, format=format)
        except ValueError:
            assert not list(tmp_path.iterdir())
        else:
            assert set(load(path, format=format, unit="m" if format == "bvh" else None).names) >= {name, "b"}
            path.unlink()
