"""The command line: what it writes, prints and refuses."""

import errno
import hashlib
import json
import os
import re
import subprocess
import sys
import time
import tomllib
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import jax
import numpy as np
import pytest

from motionrecover import __version__, corrupt, load, metrics, save, synthesize
from motionrecover.cli import main, terminal
from motionrecover.motion import Motion
from motionrecover.recovery import RecoveryError
from motionrecover.skeleton import Skeleton

# As long as `demo --seconds 1`, so that one compiled program serves all tests.
TRUTH = synthesize(1.0, seed=3)
BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  End Site
  {
    OFFSET 0 1.7 0
  }
}
MOTION
Frames: 3
Frame Time: 0.01
1 2 3 10 20 30
1 2 3 10 20 30
1 2 3 10 20 30
"""
STATED = "# fps: 30\n# unit: m\n# up: y\n"
HIP_KNEE = STATED + "# parents: -1, 0\nhip_x,hip_y,hip_z,knee_x,knee_y,knee_z\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with truth.npz and corrupted.csv."""
    monkeypatch.chdir(tmp_path)
    save(TRUTH, "truth.npz")
    positions, _ = corrupt.apply("iid-20", TRUTH.positions, 1)
    positions[5:9, 3] = np.nan
    save(TRUTH.with_positions(positions, "corrupted"), "corrupted.csv")
    return tmp_path


@pytest.fixture
def refuses(run):
    """Checks that a command line ends with one line of error that holds all the words, and leaves the folder alone."""

    def check(*arguments, words=()):
        before = {path: path.read_bytes() if path.is_file() else b"" for path in Path().rglob("*")}
        code, out, err = run(*arguments)
        assert (code, out) == (2, "")
        assert [line[:7] for line in err.splitlines() if not line.startswith("note: ")] == ["error: "]
        assert "Traceback" not in err
        assert not [word for word in words if word not in err], err
        assert {path: path.read_bytes() if path.is_file() else b"" for path in Path().rglob("*")} == before

    return check


def test_recover_from_csv_to_npz(folder, run):
    extras = ("--truth", "truth.npz", "--report", "out.html", "--figures", "figures")
    code, out, err = run("recover", "corrupted.csv", "-o", "out.npz", *extras)
    assert (code, err) == (0, "")
    assert "converged after" in out
    assert "wrote out.npz, out.npz.toml, out.html, figures/recovery.png, figures/changes.png" in out
    written = ["corrupted.csv", "figures", "out.html", "out.npz", "out.npz.toml", "truth.npz"]
    assert sorted(path.name for path in folder.iterdir()) == written
    assert sorted(path.name for path in Path("figures").iterdir()) == ["changes.png", "recovery.png"]
    assert "<th>preset</th><td>robust</td>" in Path("out.html").read_text(encoding="utf-8")
    before, after = load("corrupted.csv"), load("out.npz")
    assert after.observed.all()
    assert (after.names, after.fps, len(after)) == (before.names, before.fps, len(before))
    assert any(line.startswith("recovered with robust") for line in after.history)
    aje = [metrics.aje(clip.positions, TRUTH.positions, before.observed) for clip in (before, after)]
    assert aje[1] < 0.1 * aje[0]


def test_programs_are_kept_between_runs_unless_told_not_to(folder, run, monkeypatch):
    before = jax.config.jax_compilation_cache_dir
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        assert run("recover", "corrupted.csv", "-o", "first.npz", "--no-cache")[0] == 0
        assert not (folder / "cache").exists()
        assert run("recover", "corrupted.csv", "-o", "second.npz")[0] == 0
        assert jax.config.jax_compilation_cache_dir == str(folder / "cache" / "motionrecover")
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def test_recover_prints_one_json_object_with_the_same_numbers(folder, run):
    arguments = ("recover", "corrupted.csv", "-o", "out.csv", "--truth", "truth.npz", "--json", "--verbose")
    code, out, err = run(*arguments)
    facts = json.loads(out)
    assert code == 0
    assert "outlier share" in err
    assert facts["converged"] is True
    assert facts["samples"]["filled"] == 4
    after = load("out.csv")
    assert facts["aje_mm"]["after"] == pytest.approx(1000 * metrics.aje(after.positions, TRUTH.positions), rel=1e-6)
    assert facts["abe_mm"]["after"] < facts["abe_mm"]["before"]
    assert facts["bone_length_deviation_mm"]["after"] < 0.1 * facts["bone_length_deviation_mm"]["before"]
    assert 0.15 < facts["samples"]["repaired"] / facts["frames"] / facts["joints"] < 0.25
    assert facts["swaps"] == facts["never_seen"] == facts["partly_unknown"] == []


def test_recover_quietly_with_the_lengths_of_the_rest_pose(folder, run):
    assert run("recover", "corrupted.csv", "-o", "out.npz", "--bone-lengths", "rest", "-q") == (0, "", "")
    found = TRUTH.skeleton.bone_lengths_of(load("out.npz").positions)
    np.testing.assert_allclose(np.median(found, axis=0), TRUTH.skeleton.rest_lengths, rtol=0.02)


def test_existing_files_are_replaced_only_when_asked(folder, run, refuses):
    Path("out.npz").write_text("old")
    Path("out.html").write_text("old")
    Path("recovery.png").write_text("old")
    for arguments in (
        ("recover", "corrupted.csv", "-o", "out.npz"),
        ("recover", "corrupted.csv", "-o", "new.npz", "--report", "out.html"),
        ("recover", "corrupted.csv", "-o", "new.npz", "--figures", "."),
        ("view", "truth.npz", "--save", "out.npz"),
        ("corrupt", "truth.npz", "-o", "out.npz", "--protocol", "iid-20"),
        ("convert", "truth.npz", "out.npz"),
    ):
        refuses(*arguments, words=["exists already", "--overwrite"])
    assert run("recover", "corrupted.csv", "-o", "out.npz", "--figures", ".", "--overwrite")[0] == 0
    assert len(load("out.npz")) == len(TRUTH)
    assert Path("recovery.png").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_written_is_refused_before_the_work(folder, refuses, monkeypatch):
    def work(*_, **__):
        raise AssertionError("worked")

    monkeypatch.setattr("motionrecover.io.load", work)
    refuses("recover", "corrupted.csv", "-o", "out.amc", words=["out.amc", ".csv or .npz"])
    refuses("recover", "corrupted.csv", "-o", "out", words=["without an ending"])
    refuses("recover", "corrupted.csv", "-o", "no/out.npz", words=["no folder"])
    refuses("recover", "corrupted.csv", "-o", "out.npz", "--figures", "truth.npz", words=["truth.npz is no folder"])
    refuses("recover", "corrupted.csv", "-o", "out.npz", "--report", "out.txt", words=["out.txt", ".html"])
    refuses("recover", "corrupted.csv", "-o", "out.npz", "--preset", "best", words=["'best'", "str_yang2020"])
    refuses("convert", "truth.npz", "out.csv", "--to", "fbx", words=["fbx", ".csv or .npz"])

    def forbidden(*_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", forbidden)
        assert main(["recover", "corrupted.csv", "-o", "out.npz"]) == 2
    assert not Path("out.npz").exists()


@pytest.mark.parametrize(("error", "code"), [(RecoveryError("No sample."), 1), (KeyboardInterrupt(), 130)])
def test_work_that_fails_leaves_no_file(folder, run, monkeypatch, error, code):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(import_module("motionrecover.recovery"), "recover", fail)
    before = sorted(folder.iterdir())
    assert run("recover", "corrupted.csv", "-o", "out.npz") == (code, "", "error: No sample.\n" if code == 1 else "")
    assert sorted(folder.iterdir()) == before


def test_ctrl_c_does_not_wait_for_the_solver(folder):
    code = """if True:
        import os, signal, sys, time
        from importlib import import_module
        from motionrecover.cli import main

        def slow(*_, **__):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(60)

        import_module("motionrecover.recovery").recover = slow
        sys.argv = ["motionrecover", "recover", "corrupted.csv", "-o", "out.npz"]
        sys.exit(main())
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
    assert sorted(path.name for path in folder.iterdir()) == ["corrupted.csv", "truth.npz"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("nowhere.npz", None, ["does not exist"]),
        ("empty.csv", "", ["empty"]),
        ("clip.fbx", "fbx", [".fbx", "bvh"]),
        ("truncated.bvh", BVH[:150], ["truncated.bvh"]),
        ("binary.bvh", b"\xff\xfe\x00\x01" * 40, ["UTF-8"]),
        ("short_row.bvh", BVH[: -len(" 30\n")], ["line 16"]),
        ("lying_count.bvh", BVH.replace("Frames: 3", "Frames: 30"), ["30"]),
        ("damaged.npz", "PK and no zip", ["damaged"]),
        ("nothing.csv", HIP_KNEE + ",,,,,\n" * 4, ["no measured sample"]),
        ("lost_joint.csv", HIP_KNEE + "0,1,0,,,\n" * 4, ["knee", "never observed"]),
        ("one_frame.csv", HIP_KNEE + "0,1,0,0,0.5,0\n", ["1 frame", "at least 3"]),
        ("words.csv", HIP_KNEE + "0,1,0,0,half,0\n", ["line 6", "'half'"]),
        ("infinite.csv", HIP_KNEE + "0,1,0,0,inf,0\n", ["line 6", "inf"]),
        ("parts.csv", HIP_KNEE.replace("-1, 0", "-1, -1") + "0,1,0,0,0.5,0\n" * 4, ["without bones"]),
        ("no_unit.csv", HIP_KNEE.replace("# unit: m\n", "") + "0,1,0,0,0.5,0\n" * 4, ["--unit"]),
        ("one_point.csv", HIP_KNEE + "0,1,0,0,1,0\n" * 4, ["coincide"]),
    ],
)
def test_bad_files_are_refused_in_one_line(folder, refuses, name, content, words):
    if content is not None:
        Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
    refuses("recover", name, "-o", "out.npz", "--preset", "str_yang2020", words=words)


def test_settings_are_written_beside_the_answer_and_do_the_same_again(folder, run):
    settings = ("--max-gap", "3", "--plant-feet", "--truth", "truth.npz")
    assert run("recover", "corrupted.csv", "-o", "out.bvh", *settings, "-q")[0] == 0
    answer, told = Path("out.bvh").read_bytes(), Path("out.bvh.toml").read_bytes()
    said = tomllib.loads(told.decode())
    made = said.pop("provenance")
    assert said == {
        "input": "corrupted.csv",
        "output": "out.bvh",
        "preset": "robust",
        "bone-lengths": "estimate",
        "max-gap": 3,
        "fill-unseen": False,
        "plant-feet": True,
        "symmetric": False,
        "dtype": "float32",
        "truth": "truth.npz",
        "skip-first": False,
    }
    assert made["motionrecover"] == __version__
    assert made["input-sha256"] == hashlib.sha256(Path("corrupted.csv").read_bytes()).hexdigest()
    assert made["verdict"].startswith("Recovered in part")

    assert run("recover", "--config", "out.bvh.toml", "--overwrite", "-q") == (0, "", "")
    assert (Path("out.bvh").read_bytes(), Path("out.bvh.toml").read_bytes()) == (answer, told)
    save(load("corrupted.csv"), "corrupted.csv", overwrite=True)  # its history grows, and so its bytes differ
    code, _, err = run("recover", "--config", "out.bvh.toml", "-o", "again.csv", "--no-cache")
    assert (code, err) == (0, "note: corrupted.csv has changed since out.bvh.toml was written\n")
    again = tomllib.loads(Path("again.csv.toml").read_text())
    digest = again.pop("provenance")["input-sha256"]
    assert any(digest in line for line in load("again.csv").history)
    assert again == said | {"output": "again.csv"}


def test_a_settings_file_equals_the_flags_and_flags_go_before(folder, run):
    Path("mine.toml").write_text("input = 'corrupted.csv'\nunit = 0.01\nmax-gap = 3\nsymmetric = true\njson = true\n")
    code, by_file, err = run("recover", "--config", "mine.toml", "-o", "a.npz", "--unit", "m", "--dry-run")
    flags = ("--unit", "m", "--max-gap", "3", "--symmetric", "--json", "--dry-run")
    assert (code, err) == (0, "")
    assert run("recover", "corrupted.csv", "-o", "a.npz", *flags) == (0, by_file, "")
    assert run("recover", "--config", "mine.toml", "-o", "a.npz")[0] == 0
    found, expected = load("a.npz"), load("corrupted.csv", unit="cm")
    assert np.nanmax(np.abs(found.positions - expected.positions)) < 0.01
    assert tomllib.loads(Path("a.npz.toml").read_text())["unit"] == "0.01"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("max_gap = 3", ["'max_gap'", "nearest is 'max-gap'"]),
        ("presets = 'robust'", ["'presets'", "recover does not have", "'preset'"]),
        ("config = 'other.toml'", ["'config'"]),
        ("max-gap = 3.5", ["--max-gap"]),
        ("plant-feet = 'perhaps'", ["--plant-feet"]),
        ("fps = [30]", ["fps = [30]", "a number"]),
        ("fps = ", ["no TOML file", "end of document"]),
        (b"\xff\xfe", ["no TOML file"]),
    ],
)
def test_bad_settings_are_refused_in_one_line(folder, refuses, content, words):
    Path("bad.toml").write_bytes(content if isinstance(content, bytes) else content.encode())
    refuses("recover", "corrupted.csv", "-o", "out.npz", "--config", "bad.toml", words=words)
    refuses("recover", "corrupted.csv", "-o", "out.npz", "--config", "nowhere.toml", words=["nowhere.toml", "exist"])


def test_a_dry_run_checks_everything_and_writes_nothing(folder, run, refuses):
    arguments = ("recover", "corrupted.csv", "-o", "out.npz", "--report", "out.html", "--figures", "new", "--dry-run")
    before = sorted(folder.iterdir())
    code, out, err = run(*arguments)
    assert (code, err) == (0, "")
    assert "would recover it with robust, bone lengths: estimate, windows: 1" in out
    assert "would write out.npz, out.npz.toml, out.html, new/recovery.png, new/changes.png" in out
    facts = json.loads(run(*arguments, "--json")[1])
    assert (facts["windows"], facts["missing_share"]) == (1, pytest.approx(4 / TRUTH.observed.size))
    assert run(*arguments, "--quiet") == (0, "", "")
    assert sorted(folder.iterdir()) == before
    refuses(*arguments, "--preset", "str_yang2020", "--max-gap", "3", words=["options of robust"])
    Path("out.npz.toml").write_text("mine")
    refuses(*arguments, words=["out.npz.toml", "exists already"])


def test_progress_is_shown_on_a_terminal_alone(monkeypatch, capsys):
    def call(progress):
        for done in range(4):
            progress(done, 3)
            time.sleep(0.15)
        return "answer"

    assert terminal.work("recovering", False, call) == "answer"
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "100")
    assert terminal.work("recovering", True, call) == "answer"
    assert capsys.readouterr().err == ""
    assert terminal.work("recovering", False, call) == "answer"
    shown = capsys.readouterr().err
    assert "window 3 of 3" in shown
    assert "left 0:00:0" in re.sub(r"\x1b\[[0-9;]*m", "", shown)


def test_recover_says_what_it_leaves_open(folder, run):
    clip = load("truth.npz")
    positions = clip.positions.copy()
    positions[:, 3] = np.nan
    positions[5:12, 6] = np.nan
    save(replace(clip, positions=positions, observed=None), "holes.npz")
    code, out, _ = run("recover", "holes.npz", "-o", "out.npz", "--max-gap", "5")
    assert code == 0
    assert f"never seen: {clip.names[3]}" in out
    assert f"also in the answer: {clip.names[3]}, {clip.names[6]}" in out
    assert np.isnan(load("out.npz").positions[:, 3]).all()


def test_a_skeleton_in_two_parts_is_refused(folder, refuses):
    skeleton = Skeleton(["a", "b", "c", "d"], [("a", "b"), ("c", "d")])
    save(Motion(np.random.default_rng(0).normal(size=(5, 4, 3)), skeleton, 30), "parts.npz")
    refuses("recover", "parts.npz", "-o", "out.npz", "--preset", "str_yang2020", words=["2 parts", "'c'"])


@pytest.mark.parametrize(
    "arguments",
    [
        ["frobnicate"],
        ["recover"],
        ["recover", "corrupted.csv"],
        ["recover", "corrupted.csv", "-o", "out.npz", "--fast"],
        ["recover", "corrupted.csv", "-o", "out.npz", "--fps", "many"],
        ["recover", "corrupted.csv", "-o", "out.npz", "--fps", "-1"],
        ["recover", "corrupted.csv", "-o", "out.npz", "--unit", "yard"],
        ["recover", "corrupted.csv", "-o", "out.npz", "--up", "w"],
        ["recover", "corrupted.csv", "-o", "out.npz", "--max-steps", "0"],
        ["recover", "corrupted.csv", "-o", "out.npz", "--dtype", "float16"],
        ["recover", "corrupted.csv", "-o", "out.npz", "--skeleton", "cmu99"],
        ["recover", "corrupted.csv", "-o", "out.npz", "--truth", "nowhere.npz"],
        ["corrupt", "truth.npz", "-o", "out.npz", "--protocol", "heavy"],
        ["corrupt", "truth.npz", "-o", "out.npz", "--protocol", "gap99x10"],
        ["corrupt", "truth.npz", "-o", "out.npz", "--protocol", "iid-20", "--seed", "-1"],
        ["demo", "--output", "truth.npz"],
        ["demo", "--seconds", "0"],
        ["info", "."],
    ],
)
def test_bad_arguments_are_refused_in_one_line(folder, refuses, arguments):
    refuses(*arguments)


def test_corrupt_does_the_same_for_the_same_seed(folder, run):
    for name, seed in (("a.npz", 4), ("b.npz", 4), ("c.npz", 5)):
        assert run("corrupt", "truth.npz", "-o", name, "--protocol", "rand30", "--seed", seed)[0] == 0
    a, b, c = (load(name).positions for name in ("a.npz", "b.npz", "c.npz"))
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(a, corrupt.apply("rand30", TRUTH.positions, 4)[0])
    assert not np.array_equal(a, c, equal_nan=True)


def test_corrupt_swaps_joints_that_the_skeleton_ties(folder, run):
    assert run("corrupt", "truth.npz", "-o", "out.npz", "--protocol", "swap2x30", "--seed", "4")[0] == 0
    expected, hit = corrupt.apply("swap2x30", TRUTH.positions, 4, TRUTH.skeleton)
    np.testing.assert_array_equal(load("out.npz").positions, expected)
    assert hit.sum() == 2 * 2 * 30


def test_evaluate_matches_joints_by_name(folder, run):
    names = ["ltoes", "root", "lfoot", "ltibia"]
    part = load("corrupted.csv").select(names)
    save(part, "part.csv")
    code, out, err = run("evaluate", "part.csv", "--truth", "truth.npz", "--json")
    assert (code, err) == (0, "")
    facts = json.loads(out)
    true = TRUTH.positions[:, [TRUTH.names.index(name) for name in names]]
    assert facts["joints"] == names
    assert set(facts["joints_left_out"]) == set(TRUTH.names) - set(names)
    assert facts["aje_mm"] == pytest.approx(1000 * metrics.aje(part.positions, true, part.observed))
    assert facts["abe_mm"] == pytest.approx(1000 * metrics.abe(part.positions, true, part.skeleton, part.observed))
    assert facts["acceleration_ratio"] == pytest.approx(metrics.acceleration_ratio(part.positions, true, part.observed))
    assert list(facts["worst_joints_mm"].values()) == sorted(facts["worst_joints_mm"].values(), reverse=True)
    code, out, _ = run("evaluate", "part.csv", "--truth", "truth.npz")
    assert code == 0
    assert "4 joints of the same name" in out
    assert f"{facts['aje_mm']:.1f} mm" in out


def test_evaluate_refuses_what_does_not_fit(folder, run, refuses):
    save(synthesize(0.5), "short.npz")
    refuses("evaluate", "short.npz", "--truth", "truth.npz", words=["60", "120", "same frames"])
    other = Motion(np.zeros((len(TRUTH), 2, 3)), Skeleton("ab", [(0, 1)]), TRUTH.fps)
    save(other, "other.npz")
    refuses("evaluate", "other.npz", "--truth", "truth.npz", words=["no joint name in common", "a, b"])
    save(TRUTH.with_positions(np.full_like(TRUTH.positions, np.nan), "lost"), "lost.npz")
    refuses("evaluate", "lost.npz", "--truth", "truth.npz", words=["nothing to compare"])


def test_info_tells_what_was_read(folder, run):
    code, out, err = run("info", "corrupted.csv", "--json")
    assert (code, err) == (0, "")
    facts, clip = json.loads(out), load("corrupted.csv")
    assert (facts["frames"], facts["fps"], facts["joints"]) == (120, 120.0, list(TRUTH.names))
    assert (facts["skeleton"], facts["skeleton_parts"], facts["bones"]) == ("tree", 1, 24)
    assert facts["missing_share"] == pytest.approx(4 / clip.observed.size)
    step = facts["largest_step_at"]
    joint = clip.names.index(step["joint"])
    moved = clip.positions[step["frame"], joint] - clip.positions[step["frame"] - 1, joint]
    assert facts["largest_step_mm"] == pytest.approx(1000 * np.linalg.norm(moved))
    assert facts["history"] == list(clip.history)
    code, out, _ = run("info", "corrupted.csv")
    assert code == 0
    assert "tree of 24 bones" in out


def test_info_of_a_graph_and_of_one_frame(folder, run):
    skeleton = Skeleton("abc", [(0, 1), (1, 2), (2, 0)])
    save(Motion(np.array([[[0.0, 0, 0], [0, 0, 0], [1, 0, 0]]]), skeleton, 30), "graph.npz")
    code, out, _ = run("info", "graph.npz", "--json")
    facts = json.loads(out)
    assert code == 0
    assert (facts["skeleton"], facts["zero_length_bones"], facts["largest_step_mm"]) == ("graph", ["a-b"], 0)


def test_skeleton_lists_the_bones_of_a_cloud_and_writes_what_can_be_edited(folder, run, refuses):
    save(Motion(TRUTH.positions, Skeleton([f"m{k}" for k in range(25)]), 120), "cloud.npz")
    code, out, err = run("skeleton", "cloud.npz", "--skeleton", "infer", "-o", "cloud.toml", "--json")
    assert (code, err) == (0, "")
    facts = json.loads(out)
    assert (facts["frames"], facts["output"]) == (120, "cloud.toml")
    clip = load("cloud.npz", skeleton="cloud.toml")
    lengths = 1000 * clip.skeleton.bone_lengths_of(clip.positions)
    assert [bone["bone"] for bone in facts["bones"]] == [name.split("-") for name in clip.skeleton.bone_names]
    np.testing.assert_allclose([bone["length_mm"] for bone in facts["bones"]], np.median(lengths, 0), rtol=0.01)
    assert all(bone["spread_mm"] <= np.ptp(each) for bone, each in zip(facts["bones"], lengths.T, strict=True))
    assert {bone["frames"] for bone in facts["bones"]} == {120}
    assert sorted(name for part in facts["parts"] for name in part) == sorted(clip.names)
    text = Path("cloud.toml").read_text()
    assert text.count("seen in 120 of 120 frames") == len(facts["bones"])
    Path("cloud.toml").write_text("".join(line for line in text.splitlines(keepends=True) if '["m0"' not in line))
    fewer = len(load("cloud.npz", skeleton="cloud.toml").skeleton.edges)
    assert 0 < fewer < len(facts["bones"])
    refuses("skeleton", "cloud.npz", "--skeleton", "infer", "-o", "cloud.toml", words=["cloud.toml", "exists"])


def test_skeleton_of_a_file_with_bones_is_theirs(folder, run):
    code, out, err = run("skeleton", "corrupted.csv")
    assert (code, err) == (0, "")
    assert "24 bones" in out
    assert out.count(" mm ") == 2 * 24
    positions = np.full((2, 4, 3), [[np.nan], [1], [1], [2]])
    save(Motion(positions, Skeleton("abcd", [("a", "b"), ("b", "c")]), 30), "unseen.npz")
    code, out, _ = run("skeleton", "unseen.npz")
    assert (code, "nan" in out) == (0, False)
    assert out.count("no bone ties to the rest: d") == 1
    code, out, _ = run("skeleton", "unseen.npz", "--json")
    assert [(bone["length_mm"], bone["spread_share"], bone["frames"]) for bone in json.loads(out)["bones"]] == [
        (None, None, 0),
        (0, None, 2),
    ]


def test_convert_there_and_back_is_exact(folder, run):
    assert run("convert", "corrupted.csv", "a.npz", "-q") == (0, "", "")
    assert run("convert", "a.npz", "b.csv", "--to", "csv-long")[0] == 0
    first, last = load("corrupted.csv"), load("b.csv")
    np.testing.assert_array_equal(first.positions, last.positions)
    assert first.skeleton == last.skeleton
    assert Path("b.csv").read_text().count("joint,x,y,z") == 1


def test_any_tree_is_converted_to_bvh_and_graphs_are_refused(folder, run, refuses):
    assert run("convert", "truth.npz", "truth.bvh", "-q") == (0, "", "")
    again = load("truth.bvh", unit="m", up="y").select(TRUTH.names)
    np.testing.assert_allclose(again.positions, TRUTH.positions, atol=2e-5)
    save(Motion(np.zeros((2, 3, 3)), Skeleton("abc", [(0, 1), (1, 2), (0, 2)]), 30), "graph.npz")
    for arguments in (("convert", "graph.npz", "graph.bvh"), ("recover", "graph.npz", "-o", "graph.bvh")):
        refuses(*arguments, words=["BVH holds one tree"])


def test_assumptions_are_notes_on_stderr_once(folder, run):
    Path("clip.bvh").write_text(BVH)
    code, out, err = run("convert", "clip.bvh", "clip.npz")
    assert code == 0
    assert "wrote clip.npz" in out
    assert [line[:6] for line in err.splitlines()] == ["note: "]
    assert "--unit" in err
    assert run("convert", "clip.bvh", "quiet.npz", "-q") == (0, "", "")


def test_demo_writes_what_it_says(folder, run, refuses):
    Path("demo").mkdir()
    Path("demo/mine.txt").write_text("mine")
    code, out, err = run("demo", "--seconds", "1", "--json")
    assert (code, err) == (0, "")
    facts = json.loads(out)
    assert sorted(map(str, Path("demo").iterdir())) == sorted([*facts["written"], "demo/mine.txt"])
    assert len(facts["written"]) == 8
    np.testing.assert_array_equal(load("demo/recovered.csv").positions, load("demo/recovered.npz").positions)
    true, after = load("demo/truth.npz"), load("demo/recovered.npz")
    assert facts["aje_mm"]["recovered"] == pytest.approx(1000 * metrics.aje(after.positions, true.positions), rel=1e-6)
    assert facts["aje_mm"]["recovered"] < facts["aje_mm"]["corrupted"]
    refuses("demo", "--seconds", "1", words=["truth.npz", "--overwrite"])
    code, out, err = run("demo", "--seconds", "1", "--overwrite")
    assert (code, err) == (0, "")
    assert "look at demo/report.html" in out
    assert "motionrecover recover walk.bvh" in out


def test_the_demo_goes_without_matplotlib_and_plotly(folder, run, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    code, out, err = run("demo", "--seconds", "1")
    assert code == 0
    notes = err.splitlines()
    assert notes[0].startswith("note: a figure needs matplotlib")
    assert notes[1].startswith("note: a report needs plotly")
    assert "recovery.png" not in out
    assert "report.html" not in out
    assert len(list(Path("demo").iterdir())) == 5


def test_view_writes_what_the_viewer_would_show(folder, run):
    code, out, err = run("view", "corrupted.csv", "truth.npz", "--truth", "truth.npz", "--save", "out.rrd")
    assert (code, out, err) == (0, "wrote out.rrd\n", "")
    assert Path("out.rrd").stat().st_size > TRUTH.positions.size


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("motionrecover rec", {"recover"}),
        ("motionrecover recover --max-", {"--max-gap", "--max-steps"}),
        ("motionrecover recover --config nowhere.toml --preset s", {"str_yang2020"}),
        ("motionrecover info --skeleton cmu", {"cmu31", "cmu25", "cmu21"}),
        ("motionrecover recover walk", set()),  # the shell names files
    ],
)
def test_the_shell_completes(line, found):
    asked = {"_MOTIONRECOVER_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    command = [sys.executable, "-m", "motionrecover"]
    done = subprocess.run(command, env=os.environ | asked, capture_output=True, text=True, check=True)
    assert (set(done.stdout.split()), done.stderr) == (found, "")


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "corrupted.csv"),
        ("skeleton", "corrupted.csv"),
        ("evaluate", "corrupted.csv", "--truth", "truth.npz"),
        ("convert", "corrupted.csv", "a.npz"),
        ("corrupt", "truth.npz", "-o", "b.npz", "--protocol", "iid-20"),
        ("view", "truth.npz", "--save", "c.rrd"),
    ],
)
def test_quiet_prints_nothing(folder, run, arguments):
    assert run(*arguments, "-q") == (0, "", "")


def test_without_a_command_help_is_printed(run):
    code, out, err = run()
    assert (code, err) == (0, "")
    assert "Usage: motionrecover" in out


def test_the_command_and_the_module_run():
    script = Path(sys.executable).with_name("motionrecover")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == (f"motionrecover {__version__}\n", "")
    module = [sys.executable, "-m", "motionrecover", "--help"]
    done = subprocess.run(module, capture_output=True, text=True, check=True)
    assert "Usage: motionrecover" in done.stdout
    assert "evaluate" in done.stdout
