"""BVH against forward kinematics composed by hand, against pybvh, and against the same clip in other formats."""

import numpy as np
import pybvh
import pytest
from scipy.spatial.transform import Rotation

from motionrecover.io import MotionFormatWarning, load

REGULAR = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Spine
  {
    OFFSET 0 0.8 0.1
    CHANNELS 3 Xrotation Zrotation Yrotation
    End Site
    {
      OFFSET 0 0.9 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0083333
1 2 3 10 20 30 40 50 60
2 3 4 -10 -20 -30 -40 -50 -60
"""
START = REGULAR.index("MOTION")


def write(folder, text, name="clip.bvh"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def random_bvh(rng, joints=7, frames=4):
    """Text, names and positions of a random skeleton with every kind of channel list."""
    parents = [-1, *(int(rng.integers(0, j)) for j in range(1, joints))]
    offsets = rng.normal(size=(joints, 3)).round(4)
    channels = []
    for joint in range(joints):
        turns = [f"{axis}rotation" for axis in rng.permutation(list("XYZ"))]
        moves = [f"{axis}position" for axis in rng.permutation(list("XYZ"))]
        kind = joint if joint < 5 else int(rng.integers(0, 5))
        channels.append([moves + turns, [], turns[:1], turns + moves, turns][kind])
    rows = [[rng.uniform(-180, 180, len(c)).round(3) for c in channels] for _ in range(frames)]

    names, order, positions = [], [], []

    def block(joint, depth):
        names.append(f"J{joint}")
        order.append(joint)
        key = "ROOT" if depth == 0 else "JOINT"
        lines = [f"{key} J{joint}", "{", "OFFSET " + " ".join(map(str, offsets[joint]))]
        lines.append(f"CHANNELS {len(channels[joint])} " + " ".join(channels[joint]))
        children = [child for child in range(joints) if parents[child] == joint]
        for child in children:
            lines += block(child, depth + 1)
        if not children:
            names.append(f"J{joint}_end")
            lines += ["End Site { ", "OFFSET 0 0.5 0", "}"]
        return [*lines, "}"]

    hierarchy = block(0, 0)
    for row in rows:
        world = {}
        frame = []
        for joint in order:
            local = offsets[joint].copy()
            turn = Rotation.identity()
            for channel, value in zip(channels[joint], row[joint], strict=True):
                if channel.endswith("position"):
                    local["XYZ".index(channel[0])] = value
                else:
                    turn = turn * Rotation.from_euler(channel[0].lower(), value, degrees=True)
            above, at = world.get(parents[joint], (Rotation.identity(), np.zeros(3)))
            world[joint] = (above * turn, at + above.apply(local))
            frame.append(world[joint][1])
            if joint not in parents:
                frame.append(world[joint][1] + world[joint][0].apply([0, 0.5, 0]))
        positions.append(frame)
    motion = [" ".join(str(v) for joint in order for v in row[joint]) for row in rows]
    text = "\n".join(["HIERARCHY", *hierarchy, "MOTION", f"Frames: {frames}", "Frame Time: 0.04", *motion])
    return text, names, np.array(positions)


@pytest.mark.parametrize("seed", range(8))
def test_positions_are_those_of_rotations_composed_one_by_one(tmp_path, seed):
    text, names, positions = random_bvh(np.random.default_rng(seed))
    motion = load(write(tmp_path, text), unit="m", up="y")
    assert list(motion.names) == names
    assert motion.fps == 25
    np.testing.assert_allclose(motion.positions, positions, atol=1e-9)


def test_regular_file_agrees_with_pybvh(tmp_path):
    path = write(tmp_path, REGULAR)
    peer = pybvh.read_bvh_file(path, world_up="+y")
    motion = load(path, unit=1, up="y")
    np.testing.assert_allclose(motion.positions, peer.node_positions(), atol=1e-12)
    assert motion.fps == pytest.approx(1 / peer.frame_time)


def test_names_bones_and_rest_offsets_come_from_the_hierarchy(tmp_path):
    skeleton = load(write(tmp_path, REGULAR), unit="cm", up="z").skeleton
    assert skeleton.names == ("Hips", "Spine", "Spine_end")
    assert skeleton.parents == (-1, 0, 1)
    # z up: (x, y, z) -> (x, z, -y)
    np.testing.assert_allclose(skeleton.rest_offsets, [[0, 0, 0], [0, 0.001, -0.008], [0, 0, -0.009]], atol=1e-12)


def test_two_end_sites_of_one_joint_get_two_names(tmp_path):
    text = REGULAR.replace("    End Site", "    End Site\n    {\n      OFFSET 1 0 0\n    }\n    End Site")
    assert load(write(tmp_path, text), unit=1).names == ("Hips", "Spine", "Spine_end", "Spine_end2")


@pytest.mark.parametrize(
    ("scale", "unit"), [(1, 1.0), (100, 0.01), (1000, 0.001), (1 / 0.0254, 0.0254), (0.45 / 0.0254, 0.0254 / 0.45)]
)
def test_unit_is_inferred_from_the_rest_pose_aloud(tmp_path, scale, unit):
    text = REGULAR.replace("0 0.8 0.1", f"0 {0.8 * scale} 0").replace("0 0.9 0", f"0 {0.9 * scale} 0")
    with pytest.warns(MotionFormatWarning, match=r"clip\.bvh states no unit: .* unit= ") as said:
        motion = load(write(tmp_path, text))
    assert motion.unit == pytest.approx(unit)
    assert motion.skeleton.rest_offsets[1][1] == pytest.approx(0.8)
    assert said[0].filename == __file__
    assert str(said[0].message) in motion.history


def test_z_up_is_inferred_only_where_rest_and_motion_agree(tmp_path):
    still = " ".join(["0"] * 9)
    lies = f"0 0 0 0 0 90 {' '.join(['0'] * 3)}"
    text = REGULAR[:START] + f"MOTION\nFrames: 1\nFrame Time: 0.1\n{still}\n"
    assert load(write(tmp_path, text), unit=1).up == "y"
    assert load(write(tmp_path, text.replace(still, lies)), unit=1).up == "y"
    upright = text.replace("0 0.8 0.1", "0 0.1 0.8").replace("0 0.9 0", "0 0 0.9")
    with pytest.warns(MotionFormatWarning, match=r"states no up axis: assumed z, .* up= "):
        motion = load(write(tmp_path, upright), unit=1)
    assert motion.up == "z"
    np.testing.assert_allclose(motion.positions[0], [[0, 0, 0], [0, 0.8, -0.1], [0, 1.7, -0.1]])
    assert load(write(tmp_path, upright), unit=1, up="y").up == "y"


def test_frame_rate_is_asked_for_or_rounded_only_where_printed_short(tmp_path):
    assert load(write(tmp_path, REGULAR), unit=1).fps == 120
    assert load(write(tmp_path, REGULAR.replace("0.0083333", "0.0417083")), unit=1).fps == pytest.approx(
        23.976, abs=1e-4
    )
    assert load(write(tmp_path, REGULAR), unit=1, fps=30).fps == 30
    assert load(write(tmp_path, REGULAR.replace("Frame Time: 0.0083333\n", "")), unit=1, fps=30).fps == 30


def test_skip_first_leaves_frame_0_out(tmp_path, refused):
    path = write(tmp_path, REGULAR)
    whole, rest = load(path, unit=1), load(path, unit=1, skip_first=True)
    np.testing.assert_array_equal(rest.positions, whole.positions[1:])
    one = write(tmp_path, REGULAR.replace("Frames: 2", "Frames: 1").rsplit("\n", 2)[0], "one.bvh")
    refused(lambda: load(one, unit=1, skip_first=True), "one.bvh", "skip_first")


def test_windows_line_ends_capitals_and_tight_braces_are_read(tmp_path):
    expected = load(write(tmp_path, REGULAR), unit=1).positions
    tight = REGULAR.replace("\n{", " {").replace("\n  {", " {").replace("\n", "\r\n").replace("position", "POSITION")
    path = tmp_path / "tight.BVH"
    path.write_bytes(b"\xef\xbb\xbf" + tight.encode())
    np.testing.assert_array_equal(load(path, unit=1).positions, expected)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("HIERARCHY", "<html>", ["line 1", "'<html>'"]),
        ("ROOT Hips", "JOINT Hips", ["line 2", "JOINT"]),
        ("  JOINT Spine\n", "  JOINT Hips\n", ["line 6", "'Hips'", "again"]),
        ("ROOT Hips\n{", "ROOT Hips\n", ["line 4", "'OFFSET'", "Hips"]),
        ("OFFSET 0 0.8 0.1", "OFFSET 0 0.8", ["line 8", "OFFSET"]),
        ("OFFSET 0 0.8 0.1", "OFFSET 0 inf 0.1", ["line 8", "finite"]),
        ("    OFFSET 0 0.8 0.1\n", "", ["line 13", "'Spine'", "OFFSET"]),
        ("CHANNELS 3", "CHANNELS 2", ["line 9", "CHANNELS"]),
        ("Xrotation Zrotation Yrotation", "Xrotation Zrotation Xrotation", ["line 9", "channels"]),
        ("Xrotation Zrotation Yrotation", "Xrotation Zrotation Wrotation", ["line 9", "Wrotation"]),
        ("}\nMOTION", "}\n}\nMOTION", ["line 16", "'}'"]),
        ("}\nMOTION", "MOTION", ["line 15", "cut off"]),
        (REGULAR[START:], "", ["line 16", "cut off"]),
        (REGULAR[120:], "", ["cut off"]),
        ("Frames: 2\n", "", ["line 16", "Frames:"]),
        ("Frames: 2", "Frames: 3", ["line 17", "'3'", "2 rows"]),
        ("Frames: 2", "Frames: 1", ["line 17", "'1'", "2 rows"]),
        ("Frames: 2", "Frames: two", ["line 17", "'two'"]),
        ("Frame Time: 0.0083333\n", "", ["line 16", "Frame Time", "fps="]),
        ("0.0083333", "-1", ["line 18", "'-1'"]),
        ("0.0083333", "", ["line 18", "Frame Time"]),
        ("30 40", "30 4O", ["line 19", "'4O'"]),
        ("30 40", "30 nan", ["line 19", "'nan'"]),
        ("30 40", "30 inf", ["line 19", "'inf'"]),
        ("30 40", "3040", ["line 19", "8 numbers", "9 channels"]),
        ("-40 -50 -60\n", "", ["line 20", "6 numbers", "9 channels"]),
        (REGULAR[REGULAR.index("1 2 3 10") :], "", ["line 16", "before the first frame"]),
        (REGULAR, " \n", ["empty"]),
        ("Spine", "Sp\0ine", ["line 6", "text"]),
    ],
)
def test_each_defect_is_told_in_one_sentence_with_file_and_line(tmp_path, refused, old, new, words):
    assert old in REGULAR
    path = write(tmp_path, REGULAR.replace(old, new, 1))
    refused(lambda: load(path, unit=1), str(path), *words)


def test_files_that_are_no_text_are_refused(tmp_path, refused):
    path = tmp_path / "clip.bvh"
    path.write_bytes(b"HIERARCHY\nROOT \xff\xfe\x80")
    refused(lambda: load(path), str(path), "line 2", "text")
    refused(lambda: load(tmp_path / "none.bvh"), "none.bvh", "does not exist")
    (tmp_path / "folder.bvh").mkdir()
    refused(lambda: load(tmp_path / "folder.bvh"), "folder.bvh", "cannot be read")


def test_a_rest_pose_without_extent_tells_no_unit(tmp_path, refused):
    path = write(tmp_path, REGULAR.replace("0 0.8 0.1", "0 0 0").replace("0 0.9 0", "0 0 0"))
    refused(lambda: load(path), str(path), "unit=")


def test_a_skeleton_is_refused(tmp_path, refused):
    path = write(tmp_path, REGULAR)
    refused(lambda: load(path, skeleton="cmu31", unit=1), str(path), "--skeleton")


def test_every_real_clip_is_a_person_at_120_frames_a_second(shared_data):
    paths = sorted((shared_data / "cmu" / "bvh").glob("*.bvh"))
    assert len(paths) == 11
    for path in paths:
        with pytest.warns(MotionFormatWarning, match="unit"):
            motion = load(path)
        assert (motion.fps, motion.up, len(motion.names)) == (120, "y", 38)
        assert motion.unit == pytest.approx(0.0254 / 0.45)
        lengths = motion.skeleton.bone_lengths_of(motion.positions)
        np.testing.assert_allclose(lengths, np.broadcast_to(motion.skeleton.rest_lengths, lengths.shape), atol=1e-6)
