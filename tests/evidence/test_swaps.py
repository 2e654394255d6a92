"""Swaps: what is exchanged is found and undone, what is not is left alone, whatever the units and the pose."""

import itertools

import numpy as np
import pytest
from helpers import SKELETONS, TREES

from motionrecover import Skeleton, corrupt, synthesize
from motionrecover.evidence import swaps
from motionrecover.evidence.swaps import Swap, candidates, find_swaps, undo
from motionrecover.io import load

MOTION = synthesize(4, 120, seed=1)
CLEAN, SKELETON = MOTION.positions, MOTION.skeleton
LENGTHS = SKELETON.rest_lengths
EXCHANGES = {
    "left/right in mid-chain": [("ltibia", "rtibia")],
    "left/right leaves": [("ltoes", "rtoes")],
    "a bone in mid-chain": [("lfemur", "ltibia")],
    "a bone to a leaf": [("rradius", "rwrist")],
    "a trunk bone": [("thorax", "lowerneck")],
    "the legs": [(f"l{name}", f"r{name}") for name in ("hipjoint", "femur", "tibia", "foot", "toes")],
    "the forearms": [("lradius", "rradius"), ("lwrist", "rwrist")],
}


def exchanged(names, start, stop, positions=CLEAN, skeleton=SKELETON):
    """Positions with pairs of named joints exchanged from `start` to `stop`, and the swaps that say so."""
    made = [Swap(skeleton.names.index(i), skeleton.names.index(j), start, stop) for i, j in names]
    return undo(positions, made), sorted(made)


def dirty(positions, seed=0):
    """Noise of 3 mm on everything and 5 % of the samples thrown."""
    rng = np.random.default_rng(seed)
    return corrupt.joints(corrupt.noise(positions, 0.003, rng)[0], 0.05, seed=rng)[0]


def assert_found(found, made, slack=2):
    assert [(s.first_joint, s.second_joint) for s in found] == [(s.first_joint, s.second_joint) for s in made]
    ends = np.array([(s.start, s.stop) for s in found]) - [(s.start, s.stop) for s in made]
    assert np.abs(ends).max() <= slack, found


@pytest.mark.parametrize("frames", [5, 10, 30, 100])
@pytest.mark.parametrize("names", EXCHANGES.values(), ids=EXCHANGES)
def test_exchanges_of_a_clean_clip_are_found_to_the_frame(names, frames):
    corrupted, made = exchanged(names, 200, 200 + frames)
    found = find_swaps(corrupted, SKELETON)
    assert found == made
    np.testing.assert_array_equal(undo(corrupted, found), CLEAN)


@pytest.mark.parametrize("frames", [5, 30, 100])
@pytest.mark.parametrize("names", EXCHANGES.values(), ids=EXCHANGES)
def test_exchanges_under_noise_and_outliers_are_found_to_two_frames(names, frames):
    corrupted, made = exchanged(names, 150, 150 + frames, dirty(CLEAN))
    assert_found(find_swaps(corrupted, SKELETON), made)


@pytest.mark.parametrize("fps", [30, 120])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("protocol", ["clean", "mixed", "kinect", "rand30", "iid-20", "iid-50", "iid-80"])
def test_nothing_is_found_where_nothing_is_exchanged(protocol, seed, fps):
    positions = synthesize(6, fps, seed=seed).positions
    if protocol != "clean":
        positions, _ = corrupt.apply(protocol, positions, seed)
    assert find_swaps(positions, SKELETON) == []


@pytest.mark.parametrize("clip", ["05_02", "09_03", "13_30"])
def test_recordings_are_left_alone_until_joints_are_exchanged(clip, shared_data):
    motion = load(shared_data / "cmu/npz" / f"{clip}.npz")
    for every in (1, 4):
        positions = motion.positions[: 500 * every : every].astype(float)
        middle = len(positions) // 2
        for protocol in ("mixed", "iid-50"):
            assert find_swaps(corrupt.apply(protocol, positions)[0], motion.skeleton) == []
        assert find_swaps(positions, motion.skeleton) == []
        for names in EXCHANGES.values():
            corrupted, made = exchanged(names[:1], middle, middle + 8, positions, motion.skeleton)
            assert_found(find_swaps(corrupted, motion.skeleton), made)


def test_several_exchanges_are_told_apart():
    made = [*exchanged([("lfoot", "rfoot")], 100, 140)[1], *exchanged([("lfoot", "ltoes")], 300, 320)[1]]
    made += [*exchanged([("lhumerus", "rhumerus")], 110, 150)[1], *exchanged(EXCHANGES["the legs"], 400, 430)[1]]
    assert find_swaps(undo(CLEAN, made), SKELETON) == sorted(made)


@pytest.mark.parametrize("start", [0, len(CLEAN) - 40])
@pytest.mark.parametrize("kind", ["left/right leaves", "the legs"])
def test_exchanges_at_the_ends_of_a_clip(kind, start):
    corrupted, made = exchanged(EXCHANGES[kind], start, start + 40)
    assert find_swaps(corrupted, SKELETON) == made


def test_of_whole_limbs_most_frames_are_right():
    corrupted, _ = exchanged(EXCHANGES["the legs"], 0, 300)
    _, rest = exchanged(EXCHANGES["the legs"], 300, len(CLEAN))
    assert find_swaps(corrupted, SKELETON, LENGTHS) == rest


def test_bones_outvote_most_frames():
    corrupted, made = exchanged(EXCHANGES["a bone in mid-chain"], 0, 300)
    assert find_swaps(corrupted, SKELETON, LENGTHS) == made


@pytest.mark.parametrize("frames", [1, 2])
def test_runs_too_short_for_a_swap_are_outliers(frames):
    corrupted, _ = exchanged(EXCHANGES["left/right leaves"], 200, 200 + frames)
    assert find_swaps(corrupted, SKELETON) == []


def test_gaps_are_bridged_and_ends_inside_them_are_left():
    joint = SKELETON.names.index("ltibia")
    corrupted, made = exchanged([("ltibia", "rtibia")], 200, 260)
    corrupted[225:235, joint] = np.nan
    assert find_swaps(corrupted, SKELETON) == made
    corrupted[255:263, joint] = np.nan
    assert find_swaps(corrupted, SKELETON) == [Swap(made[0].first_joint, made[0].second_joint, 200, 255)]


def test_the_answer_turns_moves_and_scales_with_the_clip():
    corrupted, made = exchanged(EXCHANGES["the forearms"], 200, 240, dirty(CLEAN))
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    found = find_swaps(corrupted, SKELETON)
    assert_found(found, made)
    assert find_swaps(1000 * corrupted @ turn + [5e3, -2e3, 1e3], SKELETON) == found
    assert find_swaps(corrupted[::-1], SKELETON) == [
        Swap(s.first_joint, s.second_joint, len(CLEAN) - s.stop, len(CLEAN) - s.start) for s in found
    ]


def test_the_order_of_the_joints_means_nothing():
    order = np.random.default_rng(0).permutation(len(SKELETON.names))
    skeleton = SKELETON.select([SKELETON.names[joint] for joint in order])
    corrupted, made = exchanged(EXCHANGES["the legs"], 200, 240, dirty(CLEAN))
    found = find_swaps(corrupted[:, order], skeleton)
    renamed = {(frozenset(order[[s.first_joint, s.second_joint]].tolist()), s.start, s.stop) for s in found}
    assert renamed == {(frozenset((s.first_joint, s.second_joint)), s.start, s.stop) for s in made}


def test_undoing_twice_changes_nothing():
    made = [Swap(1, 2, 3, 9), Swap(1, 4, 20, 30), Swap(3, 0, 0, 40)]
    for samples in (CLEAN, CLEAN[..., 0] > 0, CLEAN[..., 1]):
        once = undo(samples, made)
        assert (once != samples).any()
        assert once.dtype == samples.dtype
        np.testing.assert_array_equal(undo(once, made), samples)
    np.testing.assert_array_equal(undo(CLEAN, [made[0]])[3:9, 1], CLEAN[3:9, 2])


def test_candidates_are_sides_limbs_and_bones():
    named = [tuple((SKELETON.names[i], SKELETON.names[j]) for i, j in exchange) for exchange in candidates(SKELETON)]
    assert len(set(named)) == len(named) == 9 + 7 + 24
    for kind in EXCHANGES.values():
        assert tuple(kind) in named
    for skeleton in SKELETONS.values():
        for exchange in candidates(skeleton):
            joints = [joint for pair in exchange for joint in pair]
            assert len(set(joints)) == len(joints)


def test_sides_tied_to_each_other_are_no_limb():
    hips = Skeleton(["left_hip", "right_hip", "left_knee", "right_knee"], [(0, 1), (0, 2), (1, 3)])
    assert candidates(hips) == [((0, 1),), ((2, 3),), ((0, 2),), ((1, 3),)]


def test_states_are_the_shortest_of_all_paths():
    rng = np.random.default_rng(0)
    for count in (1, 2, 3, 9):
        for _ in range(20):
            ends, bones = rng.normal(-swaps.SWITCH, 5, count), rng.normal(0, 5, count)

            def cost(path, ends=ends, bones=bones):
                path = np.array(path)
                turns = np.flatnonzero(path[1:] != path[:-1]) + 1
                return (
                    (bones + swaps.TIE) @ path + (ends[turns] + swaps.SWITCH).sum() + swaps.SWITCH * path[[0, -1]].sum()
                )

            best = min(itertools.product((0, 1), repeat=count), key=cost)
            assert swaps._states(ends, bones).tolist() == list(best)


@pytest.mark.parametrize(
    ("positions", "skeleton"),
    [
        (CLEAN[:1], SKELETON),
        (CLEAN[:2], SKELETON),
        (CLEAN[:4], SKELETON),
        (np.full_like(CLEAN[:50], np.nan), SKELETON),
        (np.zeros((50, 25, 3)), SKELETON),
        (CLEAN[:50], Skeleton(SKELETON.names)),
        (CLEAN[:50, :2], TREES["bone"]),
    ],
)
def test_clips_that_say_nothing_have_no_swaps(positions, skeleton):
    assert find_swaps(positions, skeleton) == []


def test_a_joint_that_is_never_seen_hinders_no_other():
    corrupted, made = exchanged([("lfoot", "rfoot")], 200, 240)
    corrupted[:, SKELETON.names.index("head")] = np.nan
    corrupted[:, SKELETON.names.index("rwrist")] = np.nan
    assert find_swaps(corrupted, SKELETON) == made
