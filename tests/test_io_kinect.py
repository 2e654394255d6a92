"""Kinect v2 CSV: told from other CSV, tracking states as confidence, times as frames."""

import numpy as np
import pytest

from motionrecover.io import load, save
from motionrecover.io.kinect import INFERRED
from motionrecover.skeleton import Skeleton

SKELETON = Skeleton.standard("kinect25")
PERIOD = 333_333
SAMPLES = np.random.default_rng(0).uniform(-2, 2, (8, 25, 3)).round(6)


def write(folder, times=None, states=None, samples=SAMPLES, name="take.csv", end=",\n"):
    """A recording as the sensor's programs write it: no header, a comma behind the last number."""
    times = PERIOD * np.arange(len(samples)) + 10**11 if times is None else times
    states = np.full(samples.shape[:2], 2) if states is None else states
    lines = []
    for time, frame, state in zip(times, samples, states, strict=True):
        cells = [f"{x},{y},{z},{s}" for (x, y, z), s in zip(frame.tolist(), state, strict=True)]
        lines.append(f"{time},{','.join(cells)}{end}")
    (folder / name).write_text("".join(lines))
    return folder / name


def test_a_recording_is_metres_with_y_up_on_kinect25(tmp_path):
    motion = load(write(tmp_path))
    np.testing.assert_array_equal(motion.positions, SAMPLES)
    assert (motion.skeleton, motion.fps, motion.unit, motion.up) == (SKELETON, 30.0, 1, "y")
    assert motion.observed.all()
    assert "kinect25" in motion.history[-1]


def test_states_are_confidence(tmp_path):
    states = np.full((8, 25), 2)
    states[2, 3], states[4, 5] = 1, 0
    motion = load(write(tmp_path, states=states))
    assert motion.confidence is not None
    assert (motion.confidence[2, 3], motion.confidence[4, 5], motion.confidence[0, 0]) == (INFERRED, 0, 1)
    assert np.argwhere(~motion.observed).tolist() == [[4, 5]]
    assert np.isnan(motion.positions[4, 5]).all()


def test_dropped_frames_are_missing_and_wobbling_times_are_not(tmp_path):
    times = PERIOD * np.array([0, 1, 2, 3, 5, 6, 9, 10]) + np.array([0, 9000, -9000, 0, 9000, 0, -9000, 0])
    motion = load(write(tmp_path, times))
    assert len(motion) == 11
    assert np.flatnonzero(~motion.observed.any(1)).tolist() == [4, 7, 8]
    np.testing.assert_array_equal(motion.positions[motion.observed.any(1)], SAMPLES)
    assert motion.fps == 30.0
    assert "3 of them dropped" in motion.history[-1]


def test_arguments_go_before_the_file(tmp_path):
    path = write(tmp_path)
    motion = load(path, fps=15, unit="mm", up="z", skeleton=SKELETON.select(SKELETON.names[::-1]))
    assert (motion.fps, motion.names[0]) == (15, SKELETON.names[-1])
    np.testing.assert_allclose(
        motion.positions[0, -1], [SAMPLES[0, 0, 0] / 1000, *(SAMPLES[0, 0, [2, 1]] * [1e-3, -1e-3])]
    )
    assert len(load(path, skip_first=True)) == 7


@pytest.mark.parametrize("end", ["\n", "\r\n", ",\r\n", " , \n\n"])
def test_ends_of_lines_that_mean_the_same(tmp_path, end):
    np.testing.assert_array_equal(load(write(tmp_path, end=end)).positions, SAMPLES)


def test_the_content_chooses_among_formats_of_one_ending(tmp_path):
    recording = write(tmp_path)
    motion = load(recording)
    table = save(motion, tmp_path / "table.csv")
    again = load(table)
    np.testing.assert_array_equal(again.positions, motion.positions)
    np.testing.assert_array_equal(again.confidence, motion.confidence)
    assert save(motion, recording, overwrite=True) == recording, "what a file holds does not matter when it is replaced"
    assert recording.read_text() == table.read_text()


@pytest.mark.parametrize(
    ("line", "old", "new", "words"),
    [
        (3, ",2,\n", ",\n", ["line 3", "100 numbers", "101"]),
        (3, ",2,\n", ",7,\n", ["line 3", "'7'", "tracking state"]),
        (4, str(SAMPLES[3, 1, 1]), "left", ["line 4", "'left'"]),
        (5, str(10**11 + 4 * PERIOD), str(10**11), ["line 5", "order of their times"]),
        (8, str(10**11 + 7 * PERIOD), str(10**12), ["frames", "cut it"]),
    ],
)
def test_what_is_no_recording(tmp_path, refused, line, old, new, words):
    path = write(tmp_path)
    lines = path.read_text().splitlines(keepends=True)
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new)
    path.write_text("".join(lines))
    refused(lambda: load(path), "take.csv", *words)


def test_times_of_another_clock_need_a_rate(tmp_path, refused):
    path = write(tmp_path, np.arange(8) * 33)
    refused(lambda: load(path), "33 apart", "fps=")
    assert load(path, fps=30).fps == 30
    refused(lambda: load(write(tmp_path, samples=SAMPLES[:1])), "one line", "fps=")


def test_every_shared_recording_loads_without_options(shared_data):
    paths = sorted((shared_data / "kinect").glob("*.csv"))
    assert len(paths) == 6
    for path in paths:
        motion = load(path)
        rows = np.loadtxt(path, delimiter=",", usecols=range(101))
        np.testing.assert_array_equal(
            motion.positions[motion.observed.any(1)].reshape(len(rows), -1, 3)[:, 3], rows[:, 13:16]
        )
        assert (motion.skeleton, motion.fps) == (SKELETON, 30.0)
        span = (rows[-1, 0] - rows[0, 0]) / 1e7
        assert abs((len(motion) - 1) / motion.fps - span) < 1 / motion.fps
        assert motion.confidence is not None
        assert (motion.confidence == INFERRED).sum() == (rows[:, 4::4] == 1).sum()
