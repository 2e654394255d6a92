"""BVH out: inverse kinematics against poses that are known, files against the reader and pybvh."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pybvh
import pytest
from helpers import TOLERANCE, TREES, clip, hit
from scipy.spatial.transform import Rotation
from test_io_bvh import random_bvh, write

from motionrecover import recover, synthesize
from motionrecover.cli import main
from motionrecover.io import MotionFormatWarning, load, save
from motionrecover.io.bvh_out import posed
from motionrecover.io.kinematics import continuous_angles, euler_rotations, forward
from motionrecover.motion import Motion
from motionrecover.rig import Rig
from motionrecover.skeleton import Skeleton

ORDERS = ["".join(order) for order in itertools.permutations("XYZ")]
FRAMES = 40


def wander(rng, columns, reach, frames=FRAMES):
    """Smooth values (frame, column) that start anywhere."""
    t = np.linspace(0, 2 * np.pi, frames)[:, None]
    return rng.uniform(-reach, reach, columns) + reach / 2 * np.sin(t + rng.uniform(0, 7, columns))


def random_rig(rng, order="ZXY", joints=9, positions=()):
    """A tree of joints with end sites at the leaves; those in `positions` and the root have position channels too."""
    parents = [-1, *(int(rng.integers(max(0, j - 3), j)) for j in range(1, joints))]
    turns = tuple(("rotation", "XYZ".index(axis)) for axis in order)
    moves = tuple(("position", int(axis)) for axis in rng.permutation(3))
    names, above, channels, values, place = [], [], [], [], {}

    def add(joint):
        place[joint] = len(names)
        moving = joint == 0 or joint in positions
        names.append(f"J{joint}")
        above.append(-1 if joint == 0 else place[parents[joint]])
        channels.append(moves + turns if moving else turns)
        values.extend([wander(rng, 3, 0.5)] * moving + [wander(rng, 3, 60)])
        children = [child for child in range(joints) if parents[child] == joint]
        for child in children:
            add(child)
        if not children:
            names.append(f"J{joint}_end")
            above.append(place[joint])
            channels.append(())

    add(0)
    ends = tuple(not own for own in channels)
    offsets = rng.normal(scale=0.3, size=(len(names), 3)).round(4)
    channels, values = tuple(channels), np.concatenate(values, 1)
    return Rig(tuple(names), tuple(above), offsets, channels, ends, values, 0.04, 1.0, "y")


def motion_of(rig):
    translations, angles = rig.split()
    positions, _ = forward(rig.parents, translations, euler_rotations(angles, rig.orders))
    offsets = np.where(np.array(rig.parents)[:, None] == -1, 0, rig.offsets)
    return Motion(positions, Skeleton.from_parents(rig.names, rig.parents, offsets), 1 / rig.frame_time, rig=rig)


def turned(rig, degrees, rng):
    """The rig with its rotations off by as much."""
    values, column = rig.values.copy(), 0
    for own in rig.channels:
        for kind, _ in own:
            if kind == "rotation":
                values[:, column] += rng.normal(scale=degrees, size=len(values))
            column += 1
    return replace(rig, values=values)


def local(rig):
    """Rotations (frame, joint, 3, 3)."""
    return euler_rotations(rig.split()[1], rig.orders)


def between(rotations, others):
    """Degrees between rotations (..., 3, 3)."""
    return np.degrees(
        Rotation.from_matrix(np.swapaxes(rotations, -1, -2).reshape(-1, 3, 3) @ others.reshape(-1, 3, 3)).magnitude()
    ).reshape(rotations.shape[:-2])


@pytest.mark.parametrize("order", ORDERS)
def test_positions_come_back_from_rotations_that_were_off(tmp_path, order):
    rng = np.random.default_rng(ORDERS.index(order))
    true = motion_of(random_rig(rng, order))
    path = save(replace(true, rig=turned(true.rig, 10, rng)), tmp_path / "clip.bvh")
    found = load(path, unit=1, up="y")
    assert (found.names, found.skeleton, found.fps) == (true.names, true.skeleton, true.fps)
    assert found.rig.channels == true.rig.channels
    np.testing.assert_allclose(found.positions, true.positions, atol=TOLERANCE["inverse kinematics"])


@pytest.mark.parametrize("seed", range(4))
def test_joints_that_move_by_position_channels_are_placed_by_them(seed):
    rng = np.random.default_rng(seed)
    true = motion_of(random_rig(rng, positions=(2, 5)))
    spiked = true.rig.values.copy()
    moving = next(j for j, own in enumerate(true.rig.channels) if len(own) == 6 and j)
    column = sum(map(len, true.rig.channels[:moving]))
    spiked[7, column : column + 3] += 0.4
    found = posed(replace(true, rig=replace(true.rig, values=spiked)))
    np.testing.assert_allclose(found.positions, true.positions, atol=TOLERANCE["inverse kinematics"])
    assert between(local(found.rig), local(true.rig)).max() < 0.1


@pytest.mark.parametrize("seed", range(8))
def test_every_kind_of_channel_list_is_written_as_it_was(tmp_path, seed):
    text, _, _ = random_bvh(np.random.default_rng(seed))
    motion = load(write(tmp_path, text), unit="cm", up="z")
    again = load(save(motion, tmp_path / "again.bvh"), unit="cm", up="z")
    assert (again.names, again.skeleton, again.fps) == (motion.names, motion.skeleton, motion.fps)
    assert again.rig.channels == motion.rig.channels
    np.testing.assert_allclose(again.positions, motion.positions, atol=TOLERANCE["written digits"])


def test_hinges_turn_about_their_own_axis():
    rng = np.random.default_rng(0)
    names, turns = ("Hips", "Knee", "Foot", "Foot_end"), (("rotation", 0),)
    root = (*(("position", axis) for axis in range(3)), *(("rotation", axis) for axis in (2, 0, 1)))
    offsets = np.array([[0, 0, 0], [0, -0.4, 0.05], [0, -0.4, 0], [0, -0.05, 0.15]])
    values = np.concatenate([wander(rng, 3, 0.5), wander(rng, 3, 40), 40 + wander(rng, 3, 15)], 1)
    channels = (root, turns, (("rotation", 0), ("rotation", 2)), ())
    true = motion_of(Rig(names, (-1, 0, 1, 2), offsets, channels, (False,) * 3 + (True,), values, 0.01, 1.0, "y"))
    found = posed(replace(true, rig=turned(true.rig, 15, rng)))
    np.testing.assert_allclose(found.positions, true.positions, atol=TOLERANCE["weak direction"])


def test_frame_time_unit_axes_and_names_survive(tmp_path):
    text, _, _ = random_bvh(np.random.default_rng(3))
    path = write(tmp_path, text.replace("Frame Time: 0.04", "Frame Time: .0083333").replace("J3", "left arm"))
    motion = load(path, unit=0.056444, up="z")
    written = save(motion, tmp_path / "again.bvh").read_text()
    assert "Frame Time: 0.0083333\n" in written
    assert "JOINT left arm\n" in written
    again = load(tmp_path / "again.bvh", unit=0.056444, up="z")
    np.testing.assert_allclose(again.positions, motion.positions, atol=TOLERANCE["written digits"])
    np.testing.assert_allclose(again.rig.offsets, motion.rig.offsets)
    slow = save(replace(motion, fps=30), tmp_path / "slow.bvh")
    assert load(slow, unit=1, up="y").fps == 30


def test_pybvh_reads_the_same_positions(tmp_path):
    rig = random_rig(np.random.default_rng(5))
    moves = tuple(("position", axis) for axis in range(3))
    true = motion_of(replace(rig, channels=(moves + rig.channels[0][3:], *rig.channels[1:])))
    peer = pybvh.read_bvh_file(save(true, tmp_path / "clip.bvh"), world_up="+y")
    np.testing.assert_allclose(peer.node_positions(), true.positions, atol=TOLERANCE["written digits"])


@pytest.mark.parametrize("order", ORDERS)
def test_angles_run_on_through_full_turns_and_gimbal_lock(order):
    t = np.linspace(0, 1, 400)
    # Whole turns of the first and last angle, while the middle one goes through the lock and far beyond it.
    smooth = np.stack([8 * np.pi * t, 0.3 + 7 * t, -6 * np.pi * t], -1)
    locked = np.stack([3 * t, np.full_like(t, np.pi / 2), 2 * t], -1)
    for angles in (smooth, smooth % (2 * np.pi), locked, -locked):
        rotations = euler_rotations(angles[:, None], [order])[:, 0]
        found = continuous_angles(rotations, order, angles[0])
        np.testing.assert_allclose(euler_rotations(found[:, None], [order])[:, 0], rotations, atol=1e-9)
        assert np.abs(np.diff(found, axis=0)).max() < 0.1
    np.testing.assert_allclose(
        continuous_angles(euler_rotations(smooth[:, None], [order])[:, 0], order, smooth[0]), smooth, atol=1e-6
    )


def test_wrapped_angles_are_written_without_jumps(tmp_path):
    rig = random_rig(np.random.default_rng(1))
    rig = replace(rig, values=np.concatenate([rig.values[:, :3], rig.values[:, 3:] * 4], 1))
    wrapped = replace(rig, values=np.concatenate([rig.values[:, :3], (rig.values[:, 3:] + 180) % 360 - 180], 1))
    found = load(save(motion_of(wrapped), tmp_path / "clip.bvh"), unit=1, up="y").rig
    assert np.abs(np.diff(wrapped.values, axis=0)).max() > 300
    assert np.abs(np.diff(found.values, axis=0)).max() < 60
    np.testing.assert_allclose(local(found), local(wrapped), atol=1e-6)


def test_twist_is_kept_from_the_input():
    rng = np.random.default_rng(2)
    names, turns = ("Shoulder", "Elbow", "Hand", "Hand_end"), tuple(("rotation", axis) for axis in (2, 0, 1))
    channels = (tuple(("position", axis) for axis in range(3)) + turns, turns, turns, ())
    offsets = np.array([[0, 0, 0], [0.3, 0, 0], [0.25, 0, 0], [0.1, 0, 0]])
    rig = Rig(names, (-1, 0, 1, 2), offsets, channels, (False,) * 3 + (True,), wander(rng, 12, 30), 0.01, 1.0, "y")
    motion = motion_of(rig)
    positions, above = motion.positions.copy(), motion.positions[:, 2]
    # The hand turns by up to 20 degrees, about any axis.
    swing = Rotation.from_rotvec(0.2 * rng.normal(size=(FRAMES, 3)))
    positions[:, 3] = above + swing.apply(positions[:, 3] - above)
    found = posed(replace(motion, positions=positions))
    np.testing.assert_allclose(found.positions, positions, atol=TOLERANCE["inverse kinematics"])
    change = np.swapaxes(local(rig)[:, 2], 1, 2) @ local(found.rig)[:, 2]
    # The change in the hand's frame: none about the bone at its half, since the shortest arc is across it.
    along = Rotation.from_matrix(change).as_rotvec()[:, 0]
    assert np.abs(along).max() < 1e-3
    assert between(local(rig)[:, :2], local(found.rig)[:, :2]).max() < 0.01


def test_spikes_in_the_input_leave_no_twist_behind():
    rng = np.random.default_rng(4)
    true = motion_of(random_rig(rng))
    values = true.rig.values.copy()
    hit_frames = [9, 10, 23]
    values[hit_frames, 3:] += rng.choice([-1, 1], (3, values.shape[1] - 3)) * rng.uniform(30, 60, values.shape[1] - 3)
    found = posed(replace(true, rig=replace(true.rig, values=values)))
    np.testing.assert_allclose(found.positions, true.positions, atol=TOLERANCE["inverse kinematics"])
    leaves = [joint for joint, end in enumerate(true.rig.ends) if end]
    inner = [j for j in range(len(true.names)) if j not in leaves]
    assert between(local(found.rig), local(true.rig))[:, inner].max() < 10


def test_joints_without_data_keep_their_rotation(tmp_path):
    rng = np.random.default_rng(6)
    true = motion_of(random_rig(rng))
    kept = [name for name in true.names if not name.endswith("_end")]
    less = true.select(kept)
    found = load(save(less, tmp_path / "clip.bvh"), unit=1, up="y")
    np.testing.assert_allclose(found.positions, true.positions, atol=TOLERANCE["written digits"])
    holes = true.positions.copy()
    holes[5:9, 4:] = np.nan
    with pytest.warns(MotionFormatWarning, match="unknown positions, which BVH cannot leave out"):
        found = posed(replace(true, positions=holes, observed=None))
    np.testing.assert_allclose(found.positions, true.positions, atol=TOLERANCE["inverse kinematics"])
    assert not found.observed[5:9, 4:].any()


def test_bones_of_no_length_keep_their_rotation():
    rng = np.random.default_rng(7)
    rig = random_rig(rng)
    offsets = rig.offsets.copy()
    inner = [j for j in range(1, len(rig.names)) if not rig.ends[j]][:2]
    offsets[inner] = 0
    true = motion_of(replace(rig, offsets=offsets))
    root = local(true.rig)[:, :1]
    moved = Rotation.from_rotvec(0.3 * rng.normal(size=(FRAMES, 3))).as_matrix()
    at = true.positions[:, :1]
    positions = at + np.einsum("fij,fkj->fki", moved, true.positions - at)
    found = posed(replace(true, positions=positions))
    np.testing.assert_allclose(found.positions, positions, atol=TOLERANCE["inverse kinematics"])
    # The body turned as a whole: the root takes it all.
    assert between(local(found.rig)[:, 1:], local(true.rig)[:, 1:]).max() < 0.1
    assert between(local(found.rig)[:, :1], moved[:, None] @ root).max() < 0.1


def test_what_bones_cannot_follow_is_told():
    true = motion_of(random_rig(np.random.default_rng(8)))
    with pytest.warns(MotionFormatWarning, match=r"off by [\d.]+ mm in the mean"):
        found = posed(replace(true, positions=1.1 * true.positions))
    np.testing.assert_allclose(
        found.skeleton.bone_lengths_of(found.positions), np.tile(true.skeleton.rest_lengths, (FRAMES, 1)), atol=1e-9
    )
    assert found.history[-1].startswith("turned into rotations, off by ")


@pytest.mark.parametrize("name", ["bone", "chain", "star", "cmu25", "kinect25", "a person"])
def test_a_clip_of_another_format_gets_a_hierarchy(tmp_path, name):
    motion = synthesize(0.5) if name == "a person" else Motion(clip(TREES[name], FRAMES), TREES[name], 30)
    path = save(replace(motion, unit=0.001, up="z"), tmp_path / "clip.bvh")
    found = load(path, unit=1, up="y")
    same = found.select(motion.names)
    assert same.skeleton.parents == motion.skeleton.parents
    np.testing.assert_allclose(same.positions, motion.positions, atol=TOLERANCE["inverse kinematics"])
    assert found.fps == pytest.approx(motion.fps)
    added = [name for name in found.names if name not in motion.names]
    assert all(found.skeleton.rest_lengths[[found.names[k] in added for _, k in found.skeleton.edges]] == 0)
    if name in ("bone", "chain"):
        assert [each for each in added if not each.endswith("_end")] == []


def test_gaps_of_such_a_clip_are_bridged():
    motion = synthesize(1.0, seed=3)
    positions = motion.positions.copy()
    positions[30:50, 4:7] = np.nan
    with pytest.warns(MotionFormatWarning) as said:
        found = posed(replace(motion, positions=positions, observed=None))
    assert "60 unknown positions" in str(said[0].message)
    assert np.isfinite(found.positions).all()
    assert np.linalg.norm(np.diff(found.positions, axis=0), axis=-1).max() < 0.1


def test_joints_never_seen_stay_with_the_joint_above(refused, tmp_path):
    skeleton = TREES["chain"]
    positions = clip(skeleton, FRAMES)
    positions[:, [1, 4]] = np.nan
    with pytest.warns(MotionFormatWarning) as said:
        found = posed(Motion(positions, skeleton, 30))
    assert "80 unknown positions" in str(said[0].message)
    np.testing.assert_array_equal(found.positions[:, 1], found.positions[:, 0])
    np.testing.assert_array_equal(found.positions[:, 4], found.positions[:, 3])
    lost = Motion(np.full_like(positions, np.nan), skeleton, 30)
    refused(lambda: save(lost, tmp_path / "clip.bvh"), "without any known position")


def test_what_is_no_tree_is_refused_and_nothing_written(tmp_path, refused):
    loop = Skeleton("abc", [(0, 1), (1, 2), (0, 2)])
    pair = Skeleton("abcd", [(0, 1), (2, 3)])
    for skeleton, word in ((loop, "general graph"), (pair, "a, c")):
        motion = Motion(np.zeros((2, len(skeleton.names), 3)), skeleton, 30)
        refused(lambda motion=motion: save(motion, tmp_path / "clip.bvh"), "one tree", word)
    true = motion_of(random_rig(np.random.default_rng(0)))
    cut = replace(true, positions=true.positions[:5], observed=None)
    refused(lambda: save(cut, tmp_path / "clip.bvh"), "5 frames", "rig=motion.rig.frames(...)")
    save(replace(cut, rig=true.rig.frames(slice(5))), tmp_path / "cut.bvh")
    assert [path.name for path in tmp_path.iterdir()] == ["cut.bvh"]


def test_files_are_replaced_only_when_asked(tmp_path, refused):
    true = motion_of(random_rig(np.random.default_rng(0)))
    path = save(true, tmp_path / "clip.bvh")
    before = path.read_bytes()
    refused(lambda: save(true, path), "clip.bvh", "overwrite=True", error=FileExistsError)
    assert path.read_bytes() == before
    save(true, path, overwrite=True)
    assert list(tmp_path.iterdir()) == [path]


def test_skip_first_leaves_the_rotations_of_frame_0_out(tmp_path):
    true = motion_of(random_rig(np.random.default_rng(0)))
    path = save(true, tmp_path / "clip.bvh")
    rest = save(load(path, unit=1, up="y", skip_first=True), tmp_path / "rest.bvh")
    np.testing.assert_allclose(
        load(rest, unit=1, up="y").positions, true.positions[1:], atol=TOLERANCE["written digits"]
    )


def carried(rig, path):
    """The rig on a root that turns about and moves along the floor, where its own root is then moved within it."""
    parents = (-1, *(parent + 1 for parent in rig.parents))
    offsets = np.concatenate([[np.zeros(3)], rig.offsets])
    values = np.concatenate([path, rig.values], 1)
    channels, ends = (rig.channels[0], *rig.channels), (False, *rig.ends)
    return replace(
        rig, names=("Floor", *rig.names), parents=parents, offsets=offsets, channels=channels, ends=ends, values=values
    )


@pytest.mark.parametrize("moves", [True, False])
def test_no_bone_leads_to_the_hips_that_a_root_on_the_floor_carries(tmp_path, moves):
    rig = posed(synthesize(1.0, seed=3)).rig
    path = np.zeros((120, 6))
    if moves:
        path[:, :3], rig.values[:, [0, 2]] = rig.values[:, :3] * (1, 0, 1), 0
        path[:, 4] = 30
    whole = motion_of(carried(rig, path))
    motion = load(save(whole, tmp_path / "clip.bvh"), unit=1, up="y")
    assert ("Floor", "root") not in {tuple(motion.names[joint] for joint in edge) for edge in motion.skeleton.edges}
    assert len(motion.skeleton.edges) == len(motion.names) - 2
    np.testing.assert_allclose(
        motion.skeleton.bone_lengths_of(motion.positions), np.tile(motion.skeleton.rest_lengths, (120, 1)), atol=1e-5
    )
    found = posed(replace(motion, rig=turned(motion.rig, 5, np.random.default_rng(0))))
    np.testing.assert_allclose(found.positions, motion.positions, atol=TOLERANCE["inverse kinematics"])
    held = np.array(rig.values)
    held[:, :3] = held[0, :3]
    still = load(save(motion_of(carried(replace(rig, values=held), path)), tmp_path / "still.bvh"), unit=1, up="y")
    assert len(still.skeleton.edges) == len(still.names) - 1


@pytest.fixture(scope="module")
def take(tmp_path_factory):
    """A BVH file, and one with spikes in its rotations."""
    folder = tmp_path_factory.mktemp("take")
    true = posed(synthesize(1.0, seed=3))
    values, rng = true.rig.values.copy(), np.random.default_rng(0)
    frames = rng.choice(np.arange(5, 115), 8, replace=False)
    columns = rng.integers(6, values.shape[1], 8)
    values[frames, columns] += 60
    full = motion_of(replace(true.rig, values=values))
    save(full, folder / "spiked.bvh")
    save(true, folder / "clean.bvh")
    return folder


@pytest.mark.parametrize("name", ["clean", "spiked"])
def test_recover_from_bvh_to_bvh(take, capsys, name):
    path, out = take / f"{name}.bvh", take / f"{name}-out.bvh"
    assert main(["recover", str(path), "-o", str(out), "--json", "--unit", "m", "--up", "y"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["bone_lengths"] == "rest"
    assert facts["rotations_mm"]["mean"] < 0.5
    assert facts["rotations_mm"]["largest"] < 2
    assert out.read_text().split("MOTION")[0] == path.read_text().split("MOTION")[0]
    true, before, after = (load(each, unit=1, up="y") for each in (take / "clean.bvh", path, out))
    assert after.rig.frame_time == before.rig.frame_time
    error = [np.linalg.norm(clip.positions - true.positions, axis=-1) for clip in (before, after)]
    if name == "clean":
        assert error[1].max() < 0.0005
    else:
        assert error[1].mean() < 0.2 * error[0].mean()
    np.testing.assert_allclose(
        after.skeleton.bone_lengths_of(after.positions)[0], after.skeleton.rest_lengths, atol=1e-5
    )
    assert main(["recover", str(path), "-o", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_real_recording_comes_back_from_rotations_that_were_off(shared_data, tmp_path):
    rng = np.random.default_rng(0)
    true = load(shared_data / "cmu" / "bvh" / "09_01.bvh", unit=0.0254 / 0.45, skip_first=True)
    path = save(replace(true, rig=turned(true.rig, 3, rng)), tmp_path / "clip.bvh")
    found = load(path, unit=0.0254 / 0.45)
    np.testing.assert_allclose(found.positions, true.positions, atol=TOLERANCE["inverse kinematics"])
    same = load(save(true, tmp_path / "same.bvh"), unit=0.0254 / 0.45)
    assert (same.skeleton, same.rig.frame_time) == (true.skeleton, 0.0083333)
    np.testing.assert_allclose(same.positions, true.positions, atol=TOLERANCE["written digits"])
    assert np.abs(np.diff(same.rig.values[:, 3:], axis=0)).max() < 60


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_a_recovered_recording_is_written_as_it_was_recovered(shared_data, share):
    clip = load(shared_data / "cmu" / "bvh" / "09_05.bvh", unit=0.0254 / 0.45, skip_first=True)
    lengths = clip.skeleton.rest_lengths
    found = recover(hit(clip.positions, share), clip.skeleton, fps=clip.fps, bone_lengths=lengths)
    written = posed(clip.with_positions(found.positions, "recovered"))
    off = np.linalg.norm(written.positions - found.positions, axis=-1)
    assert off.max() < TOLERANCE["weak direction"]
    kept = clip.skeleton.bone_lengths_of(written.positions)
    np.testing.assert_allclose(kept, np.tile(lengths, (len(clip), 1)), atol=1e-9)
