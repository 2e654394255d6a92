"""ASF + AMC against rotations composed by hand, and against the same clips in other formats."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from motionrecover.io import MotionFormatWarning, load, save
from motionrecover.skeleton import Skeleton

ASF = """# made up
:version 1.10
:name TEST
:units
  mass 1.0
  length 0.5
  angle deg
:documentation
  begin with nothing
:root
  order TX TY TZ RZ RY RX
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name thigh
    direction 0.6 -0.8 0
    length 5
    axis 10 20 30 ZXY
    dof rz rx
    limits (-10 10)
           (-20 20)
  end
  begin
    id 2
    name hip
    direction 1 0 0
    length 2
    axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root hip
    hip thigh
  end
"""
AMC = """#made up
:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 40 50 60
thigh 70 80
2
root 1 2 3 -40 -50 -60
thigh -70 -80
"""


def write(folder, asf=ASF, amc=AMC):
    (folder / "a.asf").write_text(asf)
    path = folder / "clip.amc"
    path.write_text(amc)
    return path


def test_positions_are_those_of_rotations_composed_one_by_one(tmp_path):
    motion = load(write(tmp_path), fps=60)
    assert motion.names == ("root", "hip", "thigh")
    assert motion.skeleton.parents == (-1, 0, 1)
    assert motion.fps == 60
    scale = 0.0254 / 0.5
    assert motion.unit == pytest.approx(scale)
    for frame, sign in zip(motion.positions / scale, (1, -1), strict=True):
        # Lower-case scipy sequences turn about fixed axes, the first letter first.
        root = Rotation.from_euler("zyx", np.multiply(sign, [40, 50, 60]), degrees=True)
        axis = Rotation.from_euler("zxy", [10, 20, 30], degrees=True)
        thigh = root * axis * Rotation.from_euler("zx", np.multiply(sign, [70, 80]), degrees=True) * axis.inv()
        hip = np.array([1, 2, 3]) + root.apply([2, 0, 0])
        np.testing.assert_allclose(frame, [[1, 2, 3], hip, hip + thigh.apply([3, -4, 0])], atol=1e-12)


def test_rest_offsets_are_direction_times_length(tmp_path):
    rest = load(write(tmp_path), fps=60, unit="m", up="z").skeleton.rest_offsets
    np.testing.assert_allclose(rest, [[0, 0, 0], [2, 0, 0], [3, 0, 4]], atol=1e-12)


def test_radians_are_honoured_in_both_files(tmp_path):
    expected = load(write(tmp_path), fps=60).positions
    radians = AMC.replace(":DEGREES", ":RADIANS")
    for old in ("40 50 60", "70 80", "-40 -50 -60", "-70 -80"):
        radians = radians.replace(
            f" {old}\n", " " + " ".join(repr(float(np.radians(float(v)))) for v in old.split()) + "\n"
        )
    asf = ASF.replace("angle deg", "angle rad")
    asf = asf.replace("axis 10 20 30", "axis " + " ".join(repr(float(np.radians(v))) for v in (10, 20, 30)))
    np.testing.assert_allclose(load(write(tmp_path, amc=radians), fps=60).positions, expected, atol=1e-12)
    silent = radians.replace(":RADIANS\n", "")
    np.testing.assert_allclose(load(write(tmp_path, asf, silent), fps=60).positions, expected, atol=1e-12)


def test_frame_rate_is_assumed_aloud(tmp_path):
    with pytest.warns(MotionFormatWarning, match=r"clip\.amc states no frame rate: assumed 120 .* fps= ") as said:
        motion = load(write(tmp_path))
    assert motion.fps == 120
    assert said[0].filename == __file__
    assert str(said[0].message) in motion.history


def test_skeleton_is_the_only_one_beside_or_asked_for(tmp_path, refused):
    path = write(tmp_path)
    expected = load(path, fps=60).positions
    (tmp_path / "b.asf").write_text(ASF)
    refused(lambda: load(path, fps=60), str(path), "2 .asf files", "--skeleton")
    np.testing.assert_array_equal(load(path, fps=60, skeleton=tmp_path / "b.asf").positions, expected)
    refused(lambda: load(path, fps=60, skeleton=tmp_path / "c.asf"), "c.asf", "does not exist")
    refused(lambda: load(path, fps=60, skeleton="cmu31"), str(path), ".asf")
    for other in ("a.asf", "b.asf"):
        (tmp_path / other).unlink()
    refused(lambda: load(path, fps=60), str(path), "0 .asf files", "--skeleton")


def test_a_skeleton_alone_is_no_motion(tmp_path, refused):
    write(tmp_path)
    refused(lambda: load(tmp_path / "a.asf"), "a.asf", ".amc")
    refused(lambda: save(load(tmp_path / "clip.amc", fps=1), tmp_path / "new.amc"), "new.amc", "not written")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (ASF, " ", ["empty"]),
        (ASF[ASF.index(":hierarchy") :], "", [":hierarchy", "whole file"]),
        ("length 0.5", "length zero", ["line 6", "'zero'"]),
        ("length 0.5", "length 0", ["line 6", "above 0"]),
        ("  length 0.5\n", "", ["unit="]),
        ("position 0 0 0", "position 0 1 0", ["line 13", "position"]),
        ("order TX TY TZ", "order TX TX TZ", ["line 11", "'tx'"]),
        ("0.6 -0.8 0", "0.6 -0.8", ["line 19", "3 finite numbers"]),
        ("    length 5\n", "", ["line 16", "length"]),
        ("30 ZXY", "30 ZXX", ["line 21", "'ZXX'"]),
        ("dof rz rx", "dof rz l", ["line 22", "'l'", "thigh"]),
        ("name hip", "name thigh", ["line 26", "again"]),
        ("  end\n:hierarchy", ":hierarchy", ["line 26", "no end"]),
        ("hip thigh", "hip shank", ["line 36", "'shank'"]),
        ("hip thigh", "hip root", ["line 36", "'root'"]),
        ("    hip thigh\n", "", ["thigh", ":hierarchy"]),
    ],
)
def test_each_defect_of_the_skeleton_is_told_in_one_sentence(tmp_path, refused, old, new, words):
    assert old in ASF
    path = write(tmp_path, asf=ASF.replace(old, new, 1))
    refused(lambda: load(path, fps=60), "a.asf", *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (AMC, "\n", ["empty"]),
        ("1\nroot", "root", ["line 4", "frame 1"]),
        ("root 1 2 3 40 50 60", "root 1 2 3 40 50", ["line 5", "6 finite numbers"]),
        ("thigh 70 80", "thigh 70 nan", ["line 6", "nan"]),
        ("thigh 70 80", "shank 70 80", ["line 6", "'shank'", "--skeleton"]),
        ("2\nroot", "4\nroot", ["line 7", "frame 4 after frame 1"]),
        ("thigh -70 -80\n", "", ["line 7", "'thigh'", "cut off"]),
        ("thigh -70 -80", "thigh -70", ["line 9", "2 finite numbers"]),
        (AMC[AMC.index("1\n") :], "", ["no frame"]),
    ],
)
def test_each_defect_of_the_motion_is_told_in_one_sentence(tmp_path, refused, old, new, words):
    assert old in AMC
    path = write(tmp_path, amc=AMC.replace(old, new, 1))
    refused(lambda: load(path, fps=60), str(path), *words)


def test_real_clips_agree_with_their_positions(shared_data):
    paths = sorted((shared_data / "cmu" / "amc").glob("*/*.amc"))
    assert len(paths) == 32
    standard = Skeleton.standard("cmu31")
    for path in paths:
        motion = load(path, fps=120)
        peer = load(shared_data / "cmu" / "npz" / f"{path.stem}.npz")
        assert (motion.names, motion.skeleton.edges) == (standard.names, standard.edges)
        np.testing.assert_allclose(motion.positions, peer.positions, atol=1e-6)


def test_real_clip_agrees_with_its_bvh_on_the_legs(shared_data):
    cmu = shared_data / "cmu"
    amc = load(cmu / "amc" / "05" / "05_01.amc", fps=120)
    bvh = load(cmu / "bvh" / "05_01.bvh", unit=0.0254 / 0.45, skip_first=True)
    joints = {"UpLeg": "hipjoint", "Leg": "femur", "Foot": "tibia", "ToeBase": "foot", "ToeBase_end": "toes"}
    for side in ("Left", "Right"):
        names = [side + name for name in joints], [side[0].lower() + name for name in joints.values()]
        np.testing.assert_allclose(bvh.select(names[0]).positions, amc.select(names[1]).positions, atol=1e-5)
