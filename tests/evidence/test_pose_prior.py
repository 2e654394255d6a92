"""Poses of other people: their proportions, the prediction from them, its symmetries, and the names it hangs on."""

import numpy as np
import pytest
from helpers import TOLERANCE

from motionrecover import Skeleton, recover
from motionrecover.evidence.pose_prior import Poses, mean_from_poses, median_distances, proportioned
from motionrecover.poses import NAMES, poses_of, shipped
from motionrecover.robust import Change

SKELETON = Skeleton.standard("cmu25")
PEOPLE = poses_of(SKELETON.names)
FRAMES = 24
NEW = 3
"""The subject that the tests know nothing of, and their clip is made of: from one of his poses to another."""
STRANGERS = Poses(*(part[~np.isin(PEOPLE.bodies, [NEW, -1 - NEW])] for part in (PEOPLE.positions, PEOPLE.bodies)))


def clip():
    first, last = PEOPLE.positions[PEOPLE.bodies == NEW][[10, 12]]
    ease = (1 - np.cos(np.linspace(0, np.pi, FRAMES)))[:, None] / 2
    positions = np.zeros((FRAMES, 25, 3)) + ease[:, None] * [0.5, 0.0, 0.2]
    for parent, child in SKELETON.edges:
        start, end = first[child] - first[parent], last[child] - last[parent]
        bone = start + ease * (end - start)
        bone *= np.linalg.norm(start) / np.linalg.norm(bone, axis=-1, keepdims=True)
        positions[:, child] = positions[:, parent] + bone
    return positions


TRUTH = clip()


@pytest.fixture(scope="module", autouse=True)
def strangers():
    """A quarter of them, to be quick."""
    everyone = shipped()
    with pytest.MonkeyPatch.context() as patch:
        keep = ~np.isin(everyone.bodies, [NEW, -1 - NEW]) & (np.arange(len(everyone.bodies)) % 4 == 0)
        patch.setattr("motionrecover.poses.shipped", lambda: Poses(everyone.positions[keep], everyone.bodies[keep]))
        yield


def hidden(joint, skeleton=SKELETON, truth=TRUTH):
    data = truth.copy()
    data[:, joint] = np.nan
    return recover(data, skeleton, fill_unseen=True, dtype=np.float64)


def test_the_shipped_poses_are_people_and_their_mirror_images():
    people = shipped()
    half = len(people.bodies) // 2
    assert people.positions.shape[1] == len(NAMES)
    np.testing.assert_array_equal(people.bodies[half:], -1 - people.bodies[:half])
    left, right = NAMES.index("lwrist"), NAMES.index("rwrist")
    np.testing.assert_array_equal(people.positions[half:, left], people.positions[:half, right] * [-1, 1, 1])
    size = np.linalg.norm(
        people.positions[:, NAMES.index("head")] - people.positions[:, NAMES.index("ltibia")], axis=-1
    )
    assert 1.1 < np.median(size) < 1.7


def test_poses_get_the_bones_of_the_body_and_keep_their_directions():
    body = proportioned(STRANGERS, median_distances(TRUTH))
    bones = {frozenset(edge) for edge in SKELETON.edges}
    assert {frozenset(bone) for bone in body.tree} == bones
    i, j = np.array(body.tree).T
    own = TRUTH[:, i] - TRUTH[:, j]
    before, after = (x[:, i] - x[:, j] for x in (STRANGERS.positions, body.positions))
    np.testing.assert_allclose(
        np.linalg.norm(after, axis=-1), np.tile(np.linalg.norm(own[0], axis=-1), (len(after), 1))
    )
    cosine = np.sum(before * after, -1) / np.linalg.norm(before, axis=-1) / np.linalg.norm(after, axis=-1)
    np.testing.assert_allclose(cosine, 1, atol=1e-9)


def test_lengths_that_are_not_known_follow_the_body():
    distances = median_distances(TRUTH)
    elbow = SKELETON.names.index("lhumerus")
    unknown = distances.copy()
    unknown[elbow], unknown[:, elbow] = np.nan, np.nan
    body = proportioned(STRANGERS, unknown)
    i, j = np.array(body.tree).T
    off = np.abs(np.log(body.lengths / distances[i, j]))
    guessed = (i == elbow) | (j == elbow)
    assert off[~guessed].max() < 1e-9
    assert 0 < off[guessed].max() < 0.15
    assert (body.deviations[guessed] > 0.01 * body.lengths[guessed]).all()
    np.testing.assert_allclose(proportioned(STRANGERS, 1000 * unknown).lengths, 1000 * body.lengths)


def test_poses_that_are_learnt_are_predicted_and_surer_than_others():
    rng, body = np.random.default_rng(0), np.arange(40) % 4
    poses, others = STRANGERS.positions[:40], STRANGERS.positions[60:70]
    near, share = np.exp(-rng.random(24)), np.exp(-rng.random(24))
    joint, rest = 3, np.delete(np.arange(25), 3)
    args = poses[:, joint], poses[:, rest], others[:, rest], near, share, np.ones((10, 24))
    again, variance = mean_from_poses(*args[:2], args[1][:10], near, share, np.ones((10, 24)), 1e-9, body)
    np.testing.assert_allclose(again, poses[:10, joint], atol=1e-5)
    _, away = mean_from_poses(*args, 1e-9, body)
    assert away.min() > 100 * variance.max()


@pytest.mark.parametrize("name", ["lfemur", "rhumerus", "thorax"])
def test_a_joint_never_seen_is_where_people_have_it(name):
    joint = SKELETON.names.index(name)
    found = hidden(joint)
    error = np.linalg.norm(found.positions - TRUTH, axis=-1)
    assert error[:, joint].mean() < 0.05
    assert error[:, joint].mean() < 3 * found.uncertainty[:, joint].mean()
    assert (found.changed[:, joint] == Change.FILLED).all()
    np.testing.assert_array_equal(np.delete(found.positions, joint, 1), np.delete(TRUTH, joint, 1))


def test_symmetries():
    joint = SKELETON.names.index("lfemur")
    plain = hidden(joint).positions[:, joint]
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    moved = hidden(joint, truth=1000 * (TRUTH @ turn.T + [5, -2, 9])).positions[:, joint]
    np.testing.assert_allclose(moved / 1000, plain @ turn.T + [5, -2, 9], atol=1e-4)
    order = np.random.default_rng(1).permutation(25)
    names = [SKELETON.names[k] for k in order]
    mixed = Skeleton(names, [(SKELETON.names[i], SKELETON.names[j]) for i, j in SKELETON.edges])
    there = hidden(names.index("lfemur"), mixed, TRUTH[:, order]).positions[:, names.index("lfemur")]
    np.testing.assert_allclose(there, plain, atol=1e-4)


def test_a_long_gap_is_closer_with_poses(monkeypatch):
    data, joint = TRUTH.copy(), SKELETON.names.index("rradius")
    data[5:-5, joint] = np.nan
    errors = []
    for least in (8, 99):
        monkeypatch.setattr("motionrecover.poses.LEAST", least)
        answer = recover(data, SKELETON, dtype=np.float64)
        errors.append(np.linalg.norm(answer.positions - TRUTH, axis=-1)[5:-5, joint].mean())
    assert errors[0] < errors[1]


@pytest.mark.parametrize(
    ("standard", "least"),
    [("cmu31", 27), ("kinect25", 21), ("smpl24", 22), ("mixamo65", 23), ("body25", 16), ("coco17", 12)],
)
def test_standards_are_recognised(standard, least):
    """By a joint that another family calls otherwise, too: the left foot is the ankle in one, its ball in the other."""
    names = Skeleton.standard(standard).names
    people = poses_of(names)
    here = np.isfinite(people.positions[0, :, 0])
    assert here.sum() == least
    # Left of the body's middle is left in every family: x to the side.
    sides = {name: people.positions[:, k, 0].mean() for k, name in enumerate(names) if here[k]}
    for left, right in Skeleton.standard(standard).mirror:
        if here[left] and here[right]:
            assert sides[names[left]] == pytest.approx(-sides[names[right]], abs=TOLERANCE["equivariance"])


def test_other_names_show_no_pose():
    assert poses_of(["a", "b", "c", "root"]) is None
    assert poses_of([f"marker {k}" for k in range(40)]) is None
