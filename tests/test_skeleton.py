"""Skeletons and motions: construction, selection, and what they refuse."""

import numpy as np
import pytest

from motionrecover import Motion, Skeleton
from motionrecover.skeleton import STANDARDS

TREES = ("cmu31", "cmu25", "cmu21", "kinect25", "smpl24", "mixamo25", "mixamo65", "body25")
GRAPHS = ("coco17", "mediapipe33", "plugingait39")


@pytest.mark.parametrize("name", [*TREES, *GRAPHS])
def test_standards_are_connected_and_end_in_their_number_of_joints(name):
    skeleton = Skeleton.standard(name)
    assert name.endswith(str(len(skeleton.names)))
    assert len(skeleton.components) == 1
    assert skeleton.is_forest == (name in TREES)
    if name in TREES:
        assert skeleton.parents.count(-1) == 1
    assert set(STANDARDS) == {*TREES, *GRAPHS}


@pytest.mark.parametrize(("name", "whole"), [("cmu25", "cmu31"), ("cmu21", "cmu31"), ("mixamo25", "mixamo65")])
def test_smaller_standards_are_selections_of_larger_ones(name, whole):
    part = Skeleton.standard(name)
    assert Skeleton.standard(whole).select(part.names) == part


def test_cmu31_is_the_layout_of_the_recordings(shared_data):
    with np.load(shared_data / "cmu/npz/05_01.npz") as file:
        assert Skeleton.from_parents(file["names"], file["parents"]) == Skeleton.standard("cmu31")


@pytest.mark.parametrize(
    ("name", "pairs", "centre"),
    [
        ("cmu31", 12, "root lowerback upperback thorax lowerneck upperneck head"),
        ("cmu25", 9, "root lowerback upperback thorax lowerneck upperneck head"),
        ("cmu21", 8, "root lowerback upperback thorax upperneck"),
        ("kinect25", 10, "SpineBase SpineMid Neck Head SpineShoulder"),
        ("smpl24", 9, "pelvis spine1 spine2 spine3 neck head"),
        ("mixamo25", 9, "Hips Spine Spine1 Spine2 Neck Head HeadTop_End"),
        ("mixamo65", 29, "Hips Spine Spine1 Spine2 Neck Head HeadTop_End"),
        ("body25", 11, "Nose Neck MidHip"),
        ("coco17", 8, "nose"),
        ("mediapipe33", 16, "nose"),
        ("plugingait39", 17, "C7 T10 CLAV STRN RBAK"),
    ],
)
def test_standards_are_mirrored_but_for_their_middle(name, pairs, centre):
    skeleton = Skeleton.standard(name)
    sides = {joint for pair in skeleton.mirror for joint in pair}
    assert (len(skeleton.mirror), len(sides)) == (pairs, 2 * pairs)
    assert {skeleton.names[joint] for joint in set(range(len(skeleton.names))) - sides} == set(centre.split())
    assert all(skeleton.names[left][0] in "lL" or "left" in skeleton.names[left].lower() for left, _ in skeleton.mirror)
    other = dict(skeleton.mirror) | {right: left for left, right in skeleton.mirror}
    bones = {frozenset(bone) for bone in skeleton.edges}
    mirrored = {frozenset(other.get(joint, joint) for joint in bone) for bone in bones}
    assert mirrored == bones


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("lfemur", "rfemur"),
        ("HandLeft", "HandRight"),
        ("left_hip", "right_hip"),
        ("LEFT_HIP", "RIGHT_HIP"),
        ("mixamorig:LeftArm", "mixamorig:RightArm"),
        ("LeftFingerBase", "RightFingerBase"),
        ("LHipJoint", "RHipJoint"),
        ("LThumb_end", "RThumb_end"),
        ("LASI", "RASI"),
        ("hand.L", "hand.R"),
        ("hand_l", "hand_r"),
        ("l_hand", "r_hand"),
        ("Bip01 L Thigh", "Bip01 R Thigh"),
    ],
)
def test_sides_are_read_from_names(left, right):
    middle = ["lowerback", "Hips", "ball", "skull", "middle"]
    assert Skeleton([*middle, right, left]).mirror == ((6, 5),)
    assert Skeleton([*middle, left]).mirror == ()


def test_the_three_ways_to_write_a_skeleton(tmp_path):
    by_index = Skeleton("abc", [(0, 1), (1, 2)])
    assert Skeleton("abc", [("a", "b"), ("b", "c")]) == by_index
    assert Skeleton.from_parents("abc", [-1, 0, 1]) == by_index
    file = tmp_path / "skeleton.toml"
    for text in ('parents = ["", "a", "b"]', "parents = [-1, 0, 1]", 'edges = [["a", "b"], ["b", "c"]]'):
        file.write_text(f'names = ["a", "b", "c"]\n{text}\n')
        assert Skeleton.from_file(file) == by_index
    assert by_index.bone_names == ("a-b", "b-c")


def test_selection_keeps_rest_offsets_only_between_neighbours():
    skeleton = Skeleton.from_parents("abc", [-1, 0, 1], np.array([[0, 0, 0], [1.0, 0, 0], [0, 2, 0]]))
    np.testing.assert_array_equal(skeleton.rest_lengths, [1, 2])
    np.testing.assert_array_equal(skeleton.select("ab").rest_lengths, [1])
    bridged = skeleton.select("ac")
    assert bridged.edges == ((0, 1),)
    assert bridged.rest_lengths is None


def test_selection_of_a_graph_keeps_the_bones_among_the_joints():
    ring = Skeleton("abcd", [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2)])
    assert ring.select("cab") == Skeleton("cab", [("a", "b"), ("b", "c"), ("a", "c")])
    assert ring.select(ring.names) == ring


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Skeleton([]), "without joints"),
        (lambda: Skeleton("aa"), "more than once"),
        (lambda: Skeleton("ab", [(0, 2)]), "2 joints"),
        (lambda: Skeleton("ab", [("a", "c")]), "'c'"),
        (lambda: Skeleton("ab", [(0, 0)]), "itself"),
        (lambda: Skeleton("ab", [(0, 1), (1, 0)]), "same bone"),
        (lambda: Skeleton("ab", [(0, 1, 2)]), "pair"),
        (lambda: Skeleton("ab", [(0, 1)], [[0, 0, 0]]), "rest offsets"),
        (lambda: Skeleton.from_parents("abc", [1, 2, 0]), "cycle"),
        (lambda: Skeleton.from_parents("abc", [-1]), "3 joint names"),
        (lambda: Skeleton("abc", [(0, 2), (1, 2)]).parents, "parents"),
        (lambda: Skeleton("ab", [(0, 1)]).select(["c"]), "'c'"),
        (lambda: Skeleton("abc", [(0, 1), (1, 2), (2, 0)]).select(["d"]), "'d'"),
        (lambda: Skeleton.standard("robot"), "cmu31"),
    ],
)
def test_what_is_no_skeleton(make, words, refused):
    refused(make, words, error=ValueError)


@pytest.mark.parametrize("text", ["names = [", 'names = ["a"]', 'names = ["a"]\nparents = ["b"]', "\x00"])
def test_what_is_no_skeleton_file(text, tmp_path, refused):
    file = tmp_path / "skeleton.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=r"skeleton\.toml"):
        Skeleton.from_file(file)


CHAIN = Skeleton("ab", [(0, 1)])


def test_motion_completes_itself():
    positions = np.ones((4, 2, 3))
    positions[1, 0] = np.nan
    motion = Motion(positions, CHAIN, fps=30)
    assert motion.observed.tolist() == [[True, True], [False, True], [True, True], [True, True]]
    assert (len(motion), motion.seconds, motion.names) == (4, 4 / 30, ("a", "b"))
    assert motion.select("b").positions.shape == (4, 1, 3)
    assert motion.with_positions(np.zeros((4, 2, 3)), "zeroed").history == ("zeroed",)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"positions": np.ones((4, 3, 3))}, "shape (4, 3, 3)"),
        ({"positions": np.ones((0, 2, 3))}, "0 frames"),
        ({"positions": np.full((1, 2, 3), np.inf)}, "joint 'a'"),
        ({"fps": 0}, "frame rate of 0"),
        ({"up": "w"}, "up axis 'w'"),
        ({"observed": np.ones((1, 2), bool)}, "observed of shape (1, 2)"),
        ({"confidence": np.ones(2)}, "confidence of shape (2,)"),
        ({"confidence": np.full((4, 2), 1.5)}, "confidence"),
    ],
)
def test_what_is_no_motion(changes, words, refused):
    arguments = {"positions": np.ones((4, 2, 3)), "skeleton": CHAIN, "fps": 30, **changes}
    refused(lambda: Motion(**arguments), words, error=ValueError)
