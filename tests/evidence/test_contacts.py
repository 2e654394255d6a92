import numpy as np
import pytest
from helpers import TREES

from motionrecover import Skeleton, metrics, synthesize
from motionrecover.corrupt import noise
from motionrecover.evidence import contacts
from motionrecover.evidence.contacts import find_contacts, foot_joints, plant
from motionrecover.io import load


@pytest.fixture(scope="module")
def walker():
    motion = synthesize(8, 120, seed=1)
    return motion.positions, foot_joints(motion.skeleton)


def still(track, fps):
    """Where a foot that never slides is set down: the frames around it are less than 0.1 mm/s apart."""
    return np.linalg.norm(np.gradient(track, 1 / fps, axis=0), axis=-1) < 1e-4


def widened(mask, frames):
    return np.convolve(mask, np.ones(2 * frames + 1), "same") > 0.5


def overlap(a, b):
    return (a & b).sum() / (a | b).sum()


def stroll(steps, rise=0.0, fps=100):
    """A hip, a head and two feet that stand, step in turn by 0.6 m and `rise`, and stand; each foot's stance."""
    beat = fps // 2
    at = np.array([[0.0, 0.0, -0.1], [0.0, 0.0, 0.1]])
    feet, stance = np.repeat(at[:, None], beat, 1), np.ones((2, beat), bool)
    for step in range(steps):
        swing, there = step % 2, at.copy()
        there[swing, :2] = at[1 - swing, :2] + (0.6, rise)
        share = np.clip(np.linspace(-0.25, 1.25, beat, endpoint=False), 0, 1)  # a quarter of a beat on both feet
        way = at[:, None] + share[:, None] * (there - at)[:, None]
        way[swing, :, 1] += (0.1 + 0.6 * abs(rise)) * np.sin(np.pi * share)
        feet, at = np.concatenate([feet, way], 1), there
        stance = np.concatenate([stance, np.stack([(share == 0) | (share == 1) | (k != swing) for k in (0, 1)])], 1)
    feet = np.concatenate([feet, np.repeat(at[:, None], beat, 1)], 1)
    stance = np.concatenate([stance, np.ones((2, beat), bool)], 1)
    up = np.array([0, 1, 0])
    return np.stack([feet.mean(0) + 0.9 * up, feet.mean(0) + 1.6 * up, *feet], 1), stance.T


NAMED = {
    "lhipjoint lfemur ltibia lfoot ltoes rfoot rtoes lhand": "lfoot ltoes rfoot rtoes",
    "Hips LeftUpLeg LeftLeg LeftFoot LeftToeBase LeftToeBase_end LeftHand": "LeftFoot LeftToeBase LeftToeBase_end",
    "mixamorig:Hips mixamorig:LeftFoot mixamorig:LeftToe_End": "mixamorig:LeftFoot mixamorig:LeftToe_End",
    "SpineBase KneeLeft AnkleLeft FootLeft HandTipLeft": "AnkleLeft FootLeft",
    "left_knee left_ankle left_foot left_hand": "left_ankle left_foot",
    "MidHip LKnee LAnkle LBigToe LSmallToe LHeel LEye": "LAnkle LBigToe LSmallToe LHeel",
    "pelvis calf_l foot_l ball_l hand_l": "foot_l ball_l",
    "LKNE LANK LHEE LTOE LMT5 LFHD": "LANK LHEE LTOE LMT5",
}


@pytest.mark.parametrize("names", NAMED)
def test_feet_by_name(names):
    skeleton = Skeleton(names.split())
    assert [skeleton.names[joint] for joint in foot_joints(skeleton)] == NAMED[names].split()


def test_feet_without_names_are_the_lowest_ends(walker):
    positions, feet = walker
    nameless = Skeleton([str(j) for j in range(25)], TREES["cmu25"].edges)
    assert foot_joints(nameless) == []
    toes = [j for j in feet if TREES["cmu25"].names[j].endswith("toes")]
    holed = np.where(np.random.default_rng(0).random((len(positions), 1, 1)) < 0.3, np.nan, positions)
    for given in (positions, holed, 1000 * positions + 77):
        assert foot_joints(nameless, given) == toes
    assert foot_joints(nameless, positions[..., [0, 2, 1]], up="z") == toes
    assert foot_joints(nameless, np.full((3, 25, 3), np.nan)) == []


def test_planted_feet_are_found(walker):
    positions, feet = walker
    found = find_contacts(positions, 120, feet)
    for column, joint in zip(found.T, feet, strict=True):
        true = still(positions[:, joint], 120) & (positions[:, joint, 1] < 0.05)  # a kick is still, too, at its end
        near = widened(true, 24)  # heels roll and feet slow down before they are set down
        assert column[true].all()
        assert not (column & ~near).any()


@pytest.mark.parametrize("rise", [0.0, 0.06, -0.06, 0.17, -0.17])
def test_on_the_flat_on_slopes_and_on_stairs(rise):
    positions, stance = stroll(9, rise)
    found = find_contacts(positions, 100, [2, 3])
    before = slice(480)  # the last foot comes to rest on a step above the other one, which looks like a leg held up
    for column, true in zip(found[before].T, stance[before].T, strict=True):  # to half a window of 0.1 s
        assert not (column & ~widened(true, 5)).any()
        assert not (~column & ~widened(~true, 5)).any()


def test_a_leg_held_up_is_no_contact():
    positions, _ = stroll(2)
    held = np.repeat(positions[:1], 300, 0)
    lifted = np.interp(np.arange(300), [50, 90, 200, 240], [0, 0.3, 0.3, 0])
    held[:, 3, 1] += lifted
    found = find_contacts(held, 100, [2, 3])
    assert found[:, 0].all()
    assert not found[lifted > 0.05, 1].any()
    assert found[lifted == 0, 1].mean() > 0.95


def test_two_places_are_two_contacts():
    track = np.zeros((400, 3, 3))
    track[:, 2, 1] = 1.7
    track[:, 0, 0] = np.interp(np.arange(400), [200, 240], [0, 0.1])  # 0.25 m/s at 100 Hz
    found = find_contacts(track, 100, [0, 1])
    assert found[:, 1].all()
    assert found[:195, 0].all()
    assert found[245:, 0].all()
    assert not found[:, 0].all()


@pytest.mark.parametrize("fps", [30, 60, 240])
def test_frame_rates_agree(walker, fps):
    positions, feet = walker
    found = find_contacts(positions, 120, feet)
    other = find_contacts(synthesize(8, fps, seed=1).positions, fps, feet)
    step = max(fps // 120, 1)
    assert overlap(other[::step], found[:: 120 * step // fps]) > 0.95


def test_the_answer_ignores_yaw_place_unit_and_naming_of_axes(walker):
    positions, feet = walker
    found = find_contacts(positions, 120, feet)
    turn = np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]])
    np.testing.assert_array_equal(find_contacts(positions @ turn.T + (5, -3, 2), 120, feet), found)
    np.testing.assert_array_equal(find_contacts(1000 * positions, 120, feet), found)
    np.testing.assert_array_equal(find_contacts(positions[..., [2, 0, 1]], 120, feet, up="z"), found)
    np.testing.assert_array_equal(find_contacts(positions, 120, feet[::-1]), found[:, ::-1])


def test_noise_changes_little(walker):
    positions, feet = walker
    found = find_contacts(positions, 120, feet)
    assert overlap(find_contacts(noise(positions, 0.003, seed=0)[0], 120, feet), found) > 0.93


def test_missing_samples_are_no_contact(walker):
    positions, feet = walker
    holed = positions.copy()
    holed[300:330, feet[0]] = np.nan
    holed[:, 20] = np.nan
    found = find_contacts(holed, 120, feet)
    assert not found[300:330, 0].any()
    np.testing.assert_array_equal(found[:, 1:], find_contacts(positions, 120, feet)[:, 1:])
    assert not find_contacts(np.full((50, 25, 3), np.nan), 120, feet).any()
    assert find_contacts(positions[:1], 120, feet).shape == (1, 4)
    assert find_contacts(positions, 120, []).shape == (len(positions), 0)


def test_plant_holds_feet_and_leaves_the_rest_alone(walker):
    positions, feet = walker
    noisy, _ = noise(positions, 0.003, seed=0)
    found = find_contacts(noisy, 120, feet)
    planted, weights = plant(noisy, found, feet, 120, blend=0.08)
    given = noisy[:, feet]
    np.testing.assert_array_equal(weights == 1, found)
    np.testing.assert_array_equal(planted[weights == 0], given[weights == 0])
    assert not (weights[:, 0] > 0)[~widened(found[:, 0], 10)].any()
    held = found[1:] & found[:-1]
    assert np.abs(np.diff(planted, axis=0)[held]).max() == 0
    answer = noisy.copy()
    answer[:, feet] = planted
    assert metrics.foot_slide(answer, found, feet, 120) == 0 < metrics.foot_slide(noisy, found, feet, 120)
    # No pop: from frame to frame the correction changes by at most the steepest part of the cubic, 1.5 / (10 frames).
    change = np.linalg.norm(np.diff(planted - given, axis=0), axis=-1)[~(found[1:] | found[:-1])]
    assert change.max() <= 1.5 / 10 * np.linalg.norm(planted - given, axis=-1).max()
    assert change.max() > 0


def test_plant_between_close_contacts_and_at_the_ends():
    positions = np.zeros((9, 1, 3))
    positions[:, 0, 0] = np.arange(9)
    found = np.isin(np.arange(9), [0, 1, 5, 6, 8])[:, None]
    planted, weights = plant(positions, found, [0], 10, blend=1.0)
    np.testing.assert_allclose(planted[[0, 1, 5, 6, 8], 0, 0], [0.5, 0.5, 5.5, 5.5, 8], atol=1e-9)
    # Between 1 and 5 the corrections of -0.5 and +0.5 cross: s(1/4) = 27/32, s(1/2) = 1/2.
    np.testing.assert_allclose(planted[2:5, 0, 0], [2 - 11 / 32, 3, 4 + 11 / 32], atol=1e-9)
    np.testing.assert_allclose(weights[2:5, 0], [27 / 32, 1 / 2, 27 / 32], rtol=1e-12)
    with pytest.raises(ValueError, match="received contacts of shape"):
        plant(positions, found[:5], [0], 10)


def test_plant_turns_with_the_body(walker):
    positions, feet = walker
    found = find_contacts(positions, 120, feet)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    moved = plant(100 * (positions @ turn.T) + 7, found, feet, 120)
    plain = plant(positions, found, feet, 120)
    np.testing.assert_allclose(moved.targets, 100 * (plain.targets @ turn.T) + 7, atol=1e-8)
    np.testing.assert_array_equal(moved.weights, plain.weights)


def test_geometric_median_is_a_minimum_and_ignores_a_minority():
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(size=(30, 3)), rng.normal(50, 1, size=(14, 3))])
    found = contacts.geometric_median(points)

    def cost(point):
        return np.linalg.norm(points - point, axis=-1).sum()

    assert all(cost(found) < cost(found + step) for step in 0.1 * rng.normal(size=(50, 3)))
    assert np.linalg.norm(found) < 3
    np.testing.assert_array_equal(contacts.geometric_median(np.ones((5, 3))), np.ones(3))


@pytest.mark.parametrize(
    ("clip", "least", "most"), [("02_01", 0.45, 0.68), ("07_03", 0.45, 0.68), ("16_35", 0.1, 0.35)]
)
def test_stance_of_recorded_walks_and_of_a_run(shared_data, clip, least, most):
    motion = load(shared_data / "cmu" / "npz" / f"{clip}.npz")
    feet = foot_joints(motion.skeleton)
    found = find_contacts(motion.positions, motion.fps, feet)
    for side in "lr":
        leg = [k for k, joint in enumerate(feet) if motion.names[joint].lower().startswith(side)]
        assert least < found[:, leg].any(1).mean() < most
    assert overlap(find_contacts(noise(motion.positions, 0.003, seed=0)[0], motion.fps, feet), found) > 0.85
