"""A trained network on clips: rates, joints, windows, and what is kept. Networks here are stand-ins or untrained."""

import equinox as eqx
import numpy as np
import pytest
from helpers import SMALL_BODY, TOLERANCE, clip

from motionrecover.refine.bra import BRA
from motionrecover.refine.layers import blank
from motionrecover.refine.normalise import Convention, Normaliser, place
from motionrecover.refine.refiner import Refiner, noise_level
from motionrecover.skeleton import Skeleton

POSITIONS = clip(SMALL_BODY, 90, seed=4)
CONVENTION = Convention(16, "root", "removed", "axes")
SIDED = Skeleton(["root", "LeftHip", "RightHip", "chest"], [(0, 1), (0, 2), (0, 3)])


class Same(eqx.Module):
    """Gives back what it sees."""

    def __call__(self, x, observed, key=None):
        return blank(x, observed), self


class First(eqx.Module):
    """Gives back its window, moved by where the first joint but the root is at first: windows disagree."""

    def __call__(self, x, observed, key=None):
        return blank(x, observed) + x[:, :1, 1:2], self


def refiner(network, skeleton=SMALL_BODY, positions=POSITIONS):
    seen = np.ones(len(skeleton.names), bool)
    about = place(positions, seen, skeleton, CONVENTION, 60.0).inward(positions)
    return Refiner("stand-in", network, skeleton, CONVENTION, Normaliser.of([about], "axes"))


UNTRAINED = refiner(BRA.make(5, np.random.default_rng(0), (8, 8)))


def holed(seed=0, share=0.3):
    positions = POSITIONS.copy()
    positions[np.random.default_rng(seed).random(positions.shape[:2]) < share] = np.nan
    return positions


def test_what_the_network_says_comes_back_into_the_world():
    for frames in (1, 9, 16, 17, 90):
        found = refiner(Same())(POSITIONS[:frames], SMALL_BODY, fps=60.0, keep_observed=False)
        np.testing.assert_allclose(found.positions, POSITIONS[:frames], atol=TOLERANCE["network"])
        assert found.refined.all()
        assert not found.kept.any()


def test_other_rates_come_back_at_their_own():
    fine = np.repeat(POSITIONS, 2, 0)
    fine[1:-1:2] = (POSITIONS[:-1] + POSITIONS[1:]) / 2
    for positions, fps in ((fine, 120.0), (POSITIONS, 30.0)):
        found = refiner(Same())(positions, SMALL_BODY, fps=fps, keep_observed=False)
        np.testing.assert_allclose(found.positions, positions, atol=TOLERANCE["network"])
    found = refiner(Same())(POSITIONS, SMALL_BODY, fps=47.0, keep_observed=False)
    assert np.abs(found.positions - POSITIONS).max() < 0.02


def test_windows_leave_no_seams():
    found = refiner(First())(POSITIONS, SMALL_BODY, fps=60.0, keep_observed=False)
    off = found.positions - POSITIONS
    spread = np.abs(off - off.mean(0)).max()
    assert spread > 0.02
    assert np.abs(np.diff(off, axis=0)).max() < spread / 3


def test_observed_samples_are_kept_where_there_is_no_noise_and_gaps_meet_them():
    positions = holed()
    measured = np.isfinite(positions[..., 0])
    found = UNTRAINED(positions, SMALL_BODY, fps=60.0)
    assert (found.kept == measured).all()
    np.testing.assert_array_equal(found.positions[measured], POSITIONS[measured])
    assert np.isfinite(found.positions).all()
    assert np.linalg.norm(found.positions - POSITIONS, axis=-1)[~measured].max() < 0.1
    noisy = positions + np.random.default_rng(1).normal(scale=0.02, size=positions.shape)
    found = UNTRAINED(noisy, SMALL_BODY, fps=60.0)
    assert not found.kept.any()
    assert abs(found.noise - 0.02) < 0.003
    assert abs(noise_level(POSITIONS)) < 1e-3


def test_stored_values_of_missing_samples_never_matter():
    observed = np.isfinite(holed()[..., 0])
    answers = []
    for value in (np.nan, 0.0, 1e6):
        stored = np.where(observed[..., None], POSITIONS, value)
        answers.append(UNTRAINED(stored, SMALL_BODY, observed=observed, fps=60.0).positions)
    assert (answers[0] == answers[1]).all()
    assert (answers[0] == answers[2]).all()


def test_the_place_makes_no_difference_nor_the_heading_where_it_is_removed():
    positions = clip(SIDED, 40, seed=3)
    refine = refiner(BRA.make(4, np.random.default_rng(0), (8, 8)), SIDED, positions)
    lost = np.random.default_rng(0).random(positions.shape[:2]) < 0.2
    positions[lost] = np.nan
    turn = np.array([[np.cos(2), 0, -np.sin(2)], [0, 1, 0], [np.sin(2), 0, np.cos(2)]])
    plain = refine(positions, SIDED, fps=60.0).positions
    for rotation in (np.eye(3), turn):
        moved = refine(positions @ rotation + [5.0, -2.0, 30.0], SIDED, fps=60.0).positions
        expected = plain @ rotation + [5.0, -2.0, 30.0]
        np.testing.assert_allclose(moved, expected, atol=10 * TOLERANCE["network"])


def test_joints_are_found_by_name_and_others_stay():
    names = ["extra", "Knee", "HAND", "hip", "ro_ot", "chest"]
    skeleton = Skeleton(names, [(4, 3), (3, 1), (4, 5), (5, 2), (5, 0)])
    order = [2, 4, 1, 0, 3]
    positions = holed()
    wide = np.concatenate([np.full((90, 1, 3), 7.0), positions[:, order]], 1)
    wide[3, 0] = np.nan
    found = UNTRAINED(wide, skeleton, fps=60.0)
    np.testing.assert_array_equal(
        found.positions[:, 1:], UNTRAINED(positions, SMALL_BODY, fps=60.0).positions[:, order]
    )
    np.testing.assert_array_equal(found.positions[:, 0], wide[:, 0])
    assert found.refined.tolist() == [False] + 5 * [True]


def test_joints_never_seen_are_filled_also_the_root():
    for joint in range(5):
        positions = POSITIONS.copy()
        positions[:, joint] = np.nan
        found = UNTRAINED(positions, SMALL_BODY, fps=60.0)
        assert np.isfinite(found.positions).all()
        assert not found.kept[:, joint].any()


def test_what_cannot_be_refined_is_told(refused):
    part = SMALL_BODY.select(["root", "hip", "knee"])
    refused(lambda: UNTRAINED(POSITIONS[:, :3], part, fps=60.0), "chest, hand", "5 are", error=ValueError)
    refused(lambda: UNTRAINED(POSITIONS * np.nan, SMALL_BODY, fps=60.0), "without a sample", error=ValueError)
    refused(lambda: UNTRAINED(POSITIONS, SMALL_BODY, fps=0.0), "frame rate", error=ValueError)
    refused(lambda: UNTRAINED(POSITIONS[0], SMALL_BODY, fps=60.0), "shape", error=ValueError)
    with pytest.raises(TypeError):
        UNTRAINED(POSITIONS, SMALL_BODY)
