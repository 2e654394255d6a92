"""Bones of files that bring none: a standard's by the joint names, or the distances'."""

import warnings

import numpy as np
import pytest

from motionrecover import Motion, load, save, save_skeleton
from motionrecover.evidence.contacts import foot_joints
from motionrecover.evidence.rigid_graph import infer_graph
from motionrecover.io import MotionFormatWarning
from motionrecover.io.bones import fitted, recognised
from motionrecover.skeleton import STANDARDS, Skeleton

SPELLINGS = {
    "as it is": lambda name: name,
    "capitals": str.upper,
    "prefix": lambda name: f"mixamorig:{name}",
    "numbered prefix": lambda name: f"mixamorig1:{name}",
    "flat prefix": lambda name: f"mixamorig_{name}",
    "subject": lambda name: f"Subject 1:{name}",
    "part": lambda name: f"body_{name}",
    "spaces": lambda name: name.replace("_", " "),
    "no underscores": lambda name: name.replace("_", ""),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
@pytest.mark.parametrize("standard", STANDARDS)
def test_standards_are_recognised_in_any_order_and_spelling(standard, spelling):
    skeleton = Skeleton.standard(standard)
    names = [SPELLINGS[spelling](name) for name in skeleton.names]
    found = recognised(names[::-1])
    assert found is not None
    assert found == (standard, Skeleton(names, skeleton.edges))


def test_part_of_a_standard_has_the_bones_that_are_left():
    kinect = Skeleton.standard("kinect25")
    fingerless = [name for name in kinect.names if not name.startswith(("HandTip", "Thumb"))]
    assert recognised(fingerless) == ("kinect25", kinect.select(fingerless))
    earless = [name for name in Skeleton.standard("coco17").names if "ear" not in name]
    found = recognised(earless)
    assert found is None, "without ears, a face has no bone to the shoulders"
    faceless = [name for name in earless if "eye" not in name and name != "nose"]
    assert recognised(faceless) == ("coco17", Skeleton.standard("coco17").select(faceless))
    mixamo = [f"mixamorig:{name}" for name in Skeleton.standard("mixamo25").names if not name.endswith("_End")]
    assert recognised(mixamo) is not None


@pytest.mark.parametrize(
    "names",
    [
        ["hip", "knee"],
        ["left_hip", "left_knee", "left_ankle"],
        [*Skeleton.standard("coco17").names, "tail"],
        ["Nose", *Skeleton.standard("coco17").names],
        [f"marker{k}" for k in range(39)],
    ],
)
def test_other_names_are_no_standard(names):
    assert recognised(names) is None


@pytest.mark.parametrize(
    ("standard", "feet"), [("mixamo25", 6), ("body25", 8), ("coco17", 2), ("mediapipe33", 6), ("plugingait39", 6)]
)
def test_feet_of_the_standards_are_found_by_name(standard, feet):
    skeleton = Skeleton.standard(standard)
    assert len(foot_joints(skeleton)) == feet
    subject = fitted(standard, [f"Subject:{name}" for name in skeleton.names])
    assert subject is not None
    assert foot_joints(subject) == foot_joints(skeleton)


def test_plug_in_gait_bones_keep_their_length(shared_data):
    ezc3d = pytest.importorskip("ezc3d")
    others = {"FWT": "ASI", "BWT": "PSI", "SHN": "TIB", "RBAC": "RBAK"}
    skeleton = Skeleton.standard("plugingait39")
    spreads = []
    for path in sorted((shared_data / "markers").glob("cmu*.c3d")):
        file = ezc3d.c3d(str(path))
        names = [name.rpartition(":")[2] for name in file["parameters"]["POINT"]["LABELS"]["value"]]
        for old, new in others.items():
            names = [name.replace(old, new) for name in names]
        positions = file["data"]["points"][:3].transpose(2, 1, 0)[:, [names.index(name) for name in skeleton.names]]
        lengths = skeleton.bone_lengths_of(positions)
        spreads.append(lengths.std(0) / lengths.mean(0))
    assert len(spreads) == 3
    assert np.median(spreads) < 0.03
    assert np.quantile(spreads, 0.9) < 0.08
    assert np.max(spreads) < 0.22


def cloud(frames=60):
    """Two segments of five markers that turn on their own (frame, marker, 3), under names of no standard."""
    rng = np.random.default_rng(0)
    t = np.linspace(0, 1, frames)[:, None]
    parts = []
    for _ in range(2):
        x, y, z = rng.uniform(-0.2, 0.2, (5, 3)).T
        angle = rng.uniform(2, 5) * t
        turned = [np.cos(angle) * x + np.sin(angle) * z, y + 0 * angle, np.cos(angle) * z - np.sin(angle) * x]
        parts.append(np.stack(turned, -1) + rng.normal(size=3) + np.sin(9 * t * rng.normal(size=3))[:, None])
    return np.concatenate(parts, 1)


NAMES = tuple(f"marker{k}" for k in range(10))


@pytest.fixture
def bare(tmp_path):
    """A CSV file of the cloud without bones."""
    path = save(Motion(cloud(), Skeleton(NAMES), 100), tmp_path / "cloud.csv")
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith(("# parents", "# bones"))))
    return path


def test_a_cloud_gets_the_bones_of_its_distances_and_says_so(bare):
    with pytest.warns(MotionFormatWarning, match=r"10 joints without bones.*2 parts") as said:
        motion = load(bare)
    assert said[0].filename == __file__
    assert motion.skeleton == Skeleton(NAMES, infer_graph(cloud()).edges)
    assert str(said[0].message) in motion.history[-1]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load(bare, skeleton="infer").skeleton == motion.skeleton


def test_infer_goes_before_the_bones_of_the_file(tmp_path):
    path = save(Motion(cloud(), Skeleton(NAMES, [(0, 9)]), 100), tmp_path / "cloud.npz")
    assert len(load(path).skeleton.edges) == 1
    assert len(load(path, skeleton="infer").skeleton.edges) > 10


def test_what_keeps_no_distance_has_no_bones(bare):
    text = bare.read_text().splitlines(keepends=True)
    noise = np.random.default_rng(0).normal(size=(60, 30))
    head = [line for line in text if not line[0].isdigit()]
    bare.write_text("".join(head) + "".join(f"{k},{','.join(map(str, row))}\n" for k, row in enumerate(noise.tolist())))
    with pytest.warns(MotionFormatWarning, match="10 joints without bones: no distance stays the same"):
        assert load(bare).skeleton.edges == ()


def test_an_asked_standard_is_as_tolerant(tmp_path):
    standard = Skeleton.standard("smpl24")
    spelled = [name.title().replace("_", "") for name in standard.names]
    path = save(Motion(np.zeros((2, 24, 3)), Skeleton(spelled), 30), tmp_path / "clip.npz")
    assert load(path, skeleton="smpl24").skeleton == Skeleton(spelled, standard.edges)


@pytest.mark.parametrize(
    "skeleton",
    [
        *(Skeleton.standard(name) for name in STANDARDS),
        Skeleton(NAMES, infer_graph(cloud()).edges),
        Skeleton(['"', "\\", "a b", "é\t", "\x7f\x01", "#]"], [(3, 1), (0, 3), (5, 4), (1, 0)]),
        Skeleton(["alone"]),
    ],
    ids=lambda skeleton: skeleton.names[0],
)
def test_a_skeleton_file_gives_the_same_skeleton(tmp_path, skeleton):
    reasons = [f"reason {k}" for k in range(len(skeleton.edges))]
    path = save_skeleton(skeleton, tmp_path / "bones.toml", reasons=reasons)
    assert Skeleton.from_file(path) == skeleton
    assert path.read_text().count("# reason") == len(skeleton.edges)
    with pytest.raises(FileExistsError):
        save_skeleton(skeleton, path)
    assert save_skeleton(skeleton, path, overwrite=True) == path
