"""Clips and windows for training: what is left out, what is held out, and in which order it comes."""

import numpy as np
import pytest
from helpers import SMALL_BODY, clip

from motionrecover import Motion, save
from motionrecover.refine.data import Clips, evenly, read_clips, split
from motionrecover.refine.normalise import CHOI


def test_unusable_files_are_left_out_and_listed(tmp_path):
    positions = clip(SMALL_BODY, 130, seed=1)
    holed, thrown = positions.copy(), positions.copy()
    holed[3, 2] = np.nan
    thrown[50, 4] += 2.0
    (tmp_path / "deeper").mkdir()
    save(Motion(positions, SMALL_BODY, 120.0), tmp_path / "deeper" / "1_01.npz")
    save(Motion(holed, SMALL_BODY, 120.0), tmp_path / "2_01.npz")
    save(Motion(thrown, SMALL_BODY, 120.0), tmp_path / "3_01.npz")
    save(Motion(positions[:, :3], SMALL_BODY.select(SMALL_BODY.names[:3]), 120.0), tmp_path / "4_01.npz")
    (tmp_path / "5_01.npz").write_bytes(b"PK")
    (tmp_path / "notes.txt").write_text("no clip")
    clips = read_clips(tmp_path, SMALL_BODY, CHOI)
    assert clips.names == ("deeper/1_01.npz",)
    assert clips.positions[0].shape == (65, 5, 3)
    assert clips.positions[0].dtype == np.float32
    assert len(clips.skipped) == 4
    for sentence, word in zip(clips.skipped, ("missing", "glitch", "chest, hand", "damaged"), strict=True):
        assert word in sentence
        assert "\n" not in sentence


def test_folders_without_clips_are_told(tmp_path, refused):
    refused(lambda: read_clips(tmp_path / "none", SMALL_BODY, CHOI), "no folder", error=ValueError)
    refused(lambda: read_clips(tmp_path, SMALL_BODY, CHOI), "no clip", error=ValueError)
    (tmp_path / "a.npz").write_bytes(b"junk")
    refused(lambda: read_clips(tmp_path, SMALL_BODY, CHOI), "first of 1", "a.npz", error=ValueError)


@pytest.fixture
def clips():
    """Ten subjects with two clips each, whose first number tells the clip."""
    names = tuple(f"{subject}_{take}.npz" for subject in range(10) for take in range(2))
    return Clips(names, tuple(np.full((96, 5, 3), k, np.float32) for k in range(20)), ())


def test_no_subject_is_on_both_sides(clips):
    trained, held_out = split(clips, 64, "subject", (), seed=0)
    sides = [{clips.subjects[c] for c in windows.where[:, 0]} for windows in (trained, held_out)]
    assert not sides[0] & sides[1]
    assert (len(sides[0]), len(sides[1])) == (7, 3)
    assert (len(trained), len(held_out)) == (28, 12)
    trained, held_out = split(clips, 64, "subject", ("3", "7"), seed=0)
    assert {clips.subjects[c] for c in held_out.where[:, 0]} == {"3", "7"}
    trained, held_out = split(clips, 64, "window", (), seed=0)
    assert (len(trained), len(held_out)) == (28, 12)
    assert not {*map(tuple, trained.where)} & {*map(tuple, held_out.where)}


def test_splits_that_leave_one_side_empty_are_told(clips, refused):
    refused(lambda: split(clips, 64, "subject", ("99",), 0), "'99'", "0, 1", error=ValueError)
    refused(lambda: split(clips, 128, "subject", (), 0), "0 windows", error=ValueError)
    refused(lambda: split(clips, 64, "subject", tuple("0123456789"), 0), "10 subjects", error=ValueError)


def test_each_window_comes_once_an_epoch_in_an_order_of_its_own(clips):
    windows, _ = split(clips, 64, "window", (), seed=0)
    size = 7
    assert windows.batches(size) == 4

    def epoch(k):
        return np.concatenate([windows.batch(4 * k + j, size, seed=5)[:, 0, 0, 0] for j in range(4)])

    assert sorted(epoch(0)) == sorted(windows.where[:, 0])
    assert sorted(epoch(1)) == sorted(epoch(0))
    assert (epoch(1) != epoch(0)).any()
    assert (epoch(1) == epoch(1)).all()
    assert [part.shape for part in evenly(windows, 8, 2)] == [(8, 64, 5, 3)] * 2
    assert [len(part) for part in evenly(windows, 50, 2)] == [50]
