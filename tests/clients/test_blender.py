"""Files that we wrote, in the real Blender; and Blender's armatures through the command and back."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import TOLERANCE, hit
from test_io_bvh_out import carried, motion_of

import motionrecover as mr
from motionrecover.io.border import to_metres
from motionrecover.io.bvh_out import posed

pytestmark = pytest.mark.clients
BLENDERS = ["blender-4.2", "blender-5.0"]
"""The oldest one that takes the extension, and the newest one for the same Python."""
REPOSITORY = Path(__file__).parents[2]
CMU = 0.0254 / 0.45


def take(folder, rig):
    """A BVH file with spikes in its rotations, and the motion without them."""
    values, rng = rig.values.copy(), np.random.default_rng(0)
    turns = np.flatnonzero([kind == "rotation" for own in rig.channels for kind, _ in own])
    values[rng.choice(np.arange(5, 115), 8, replace=False), rng.choice(turns[-60:], 8)] += 60
    return mr.save(motion_of(replace(rig, values=values)), folder / "take.bvh"), motion_of(rig)


@pytest.fixture
def person():
    """A rig that walks for a second."""
    return posed(mr.synthesize(1.0, seed=3)).rig


@pytest.fixture
def command(tmp_path):
    """The command `motionrecover` of this working tree, which need not be the installed one."""
    path = tmp_path / "motionrecover"
    path.write_text(f'#!/bin/sh\ncd "{REPOSITORY}" && exec "{sys.executable}" -m motionrecover "$@"\n')
    path.chmod(0o755)
    return path


def in_metres(seen, names):
    """Heads as Blender has them, z up, in metres with y up and in the order of `names`."""
    order = [seen["bones"].tolist().index(name) for name in names]
    return to_metres(seen["heads"], 1.0, "z")[:, order]


def same_motion(seen, motion, recovered):
    """Blender shows the names, hierarchy, frame rate and positions (frame, joint, 3) of a motion with a rig."""
    rig = motion.rig
    inner = [joint for joint, end in enumerate(rig.ends) if not end]
    above = dict(zip(seen["bones"].tolist(), seen["parents"].tolist(), strict=True))
    assert above == {rig.names[j]: "" if rig.parents[j] == -1 else rig.names[rig.parents[j]] for j in inner}
    assert seen["fps"] == pytest.approx(1 / rig.frame_time, rel=1e-6)
    columns = [motion.names.index(rig.names[joint]) for joint in inner]
    off = in_metres(seen, [rig.names[joint] for joint in inner]) - recovered[:, columns]
    assert np.linalg.norm(off, axis=-1).max() < TOLERANCE["other programs"]


@pytest.mark.parametrize("blender", BLENDERS)
def test_blender_shows_what_the_command_recovered(blender, client, command, person, tmp_path):
    path, _ = take(tmp_path, person)
    for ending in ("bvh", "npz"):
        told = ["recover", path, "-o", tmp_path / f"clean.{ending}", "--unit", "m", "--up", "y", "--quiet"]
        subprocess.run([command, *told], check=True)
    client(blender, "read_bvh_in_blender.py", tmp_path / "clean.bvh", 1, 120, tmp_path / "seen.npz")
    written = mr.load(tmp_path / "clean.bvh", unit="m", up="y")
    seen = np.load(tmp_path / "seen.npz")
    for positions in (written.positions, mr.load(tmp_path / "clean.npz").positions):
        same_motion(seen, written, positions)


@pytest.mark.parametrize("blender", BLENDERS)
@pytest.mark.parametrize("share", [0.0, 0.2])
def test_blender_shows_recovered_recordings(blender, share, client, shared_data, tmp_path):
    clip = mr.load(shared_data / "cmu" / "bvh" / "09_05.bvh", unit=CMU, skip_first=True)
    lengths = clip.skeleton.rest_lengths
    found = mr.recover(hit(clip.positions, share), clip.skeleton, fps=clip.fps, bone_lengths=lengths)
    path = mr.save(clip.with_positions(found.positions, "recovered"), tmp_path / "clean.bvh")
    client(blender, "read_bvh_in_blender.py", path, CMU, len(clip), tmp_path / "seen.npz")
    same_motion(np.load(tmp_path / "seen.npz"), mr.load(path, unit=CMU), found.positions)


@pytest.mark.parametrize("blender", BLENDERS)
@pytest.mark.parametrize("kind", ["as imported", "as from FBX"])
def test_the_extension_cleans_the_action_of_an_armature(blender, kind, client, command, person, tmp_path):
    # FBX files come from game engines, with a root on the floor.
    path, true = take(tmp_path, carried(person, np.zeros((120, 6))) if kind == "as from FBX" else person)
    broken = tmp_path / "broken"
    broken.write_text("#!/bin/sh\necho 'note: beside the point' >&2\necho 'error: what is wrong' >&2\nexit 2\n")
    broken.chmod(0o755)
    client(blender, "recover_in_blender.py", REPOSITORY / "integrations" / "blender", command, path, kind, tmp_path)
    seen = np.load(tmp_path / "seen.npz")
    words = ["cannot run no-such-command", "what is wrong", "apply its rotation", "are constrained: bake"]
    for said, word in zip(seen["refusals"].tolist(), words, strict=True):
        assert word in said
        assert "note" not in said
    assert seen["actions"].tolist() == ["take", "take.clean"]
    assert seen["fake_users"].all()
    assert seen["kept"]
    assert seen["same_curves"]
    assert seen["mood"]

    up = "y" if kind == "as from FBX" else "z"
    told = ["recover", tmp_path / "exported.bvh", "-o", tmp_path / "clean.npz", "--up", up, "--fps", "120", "--quiet"]
    subprocess.run([command, *told], check=True)
    expected = mr.load(tmp_path / "clean.npz")
    bones = seen["bones"].tolist()
    heads = in_metres(seen, bones)
    off = heads - expected.select(bones).positions
    assert np.linalg.norm(off, axis=-1).max() < TOLERANCE["other programs"]
    clean, spiked = true.select(bones).positions, mr.load(path, unit="m", up="y").select(bones).positions
    errors = [np.linalg.norm(each - clean, axis=-1).mean() for each in (heads, spiked)]
    assert errors[0] < 0.2 * errors[1]
