"""Batches: what is planned and refused, what is done again, what is written down. In this process; see also
test_batch_faults.py."""

import errno
import json
import os
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from batches import FAST, again, here, lines, motion

from motionrecover import files, load, save
from motionrecover.batch import Locked, Settings, driver, plan, run
from motionrecover.batch import clip as clip_module
from motionrecover.batch import lock as lock_module
from motionrecover.batch.index import write_index
from motionrecover.batch.lock import Lock
from motionrecover.batch.manifest import Manifest
from motionrecover.cli import main


@pytest.fixture
def archive(tmp_path, monkeypatch):
    """A working folder with two clips in `in`, one of them below."""
    monkeypatch.chdir(tmp_path)
    Path("in/sub").mkdir(parents=True)
    save(motion(0), "in/a.npz")
    save(motion(1, share=0.3), "in/sub/b.csv")
    return tmp_path


def named(jobs):
    return {job.source: (job.name, job.format) for job in jobs}


# What is read, and where it goes.


def test_a_folder_keeps_its_structure_and_its_formats(archive):
    for name in ("in/sub/take.AMC", "in/sub/take.asf", "in/notes.md", "in/.hidden.npz", "in/raw.npy"):
        Path(name).touch()
    kinect = ["131000000000000000"] + ["0.1", "0.2", "2.0", "2"] * 25
    Path("in/kinect.csv").write_text(",".join(kinect) + "\n")
    assert named(plan(["in"], "out")) == {
        "in/a.npz": ("a.npz", "npz"),
        "in/kinect.csv": ("kinect.npz", "npz"),
        "in/raw.npy": ("raw.npz", "npz"),
        "in/sub/b.csv": ("sub/b.csv", "csv"),
        "in/sub/take.AMC": ("sub/take.npz", "npz"),
    }
    assert {job.name for job in plan(["in"], "out", to="csv-long")} >= {"a.csv", "sub/b.csv", "sub/take.csv"}


def test_patterns_lists_and_files(archive):
    Path("list.txt").write_text("# two\nin/a.npz\n\n in/sub/b.csv \n")
    assert named(plan(["in/**/*.csv"], "out")) == {"in/sub/b.csv": ("sub/b.csv", "csv")}
    assert named(plan(["list.txt"], "out")) == {
        "in/a.npz": ("in/a.npz", "npz"),
        "in/sub/b.csv": ("in/sub/b.csv", "csv"),
    }
    assert named(plan(["in/a.npz", "in/sub"], "out")) == {
        "in/a.npz": ("a.npz", "npz"),
        "in/sub/b.csv": ("b.csv", "csv"),
    }
    # A pattern that does not reach into the output folder may begin above it.
    assert named(plan(["in/*.npz"], "in/out")) == {"in/a.npz": ("a.npz", "npz")}


@pytest.mark.parametrize(
    ("sources", "folder", "words"),
    [
        (["in"], "in/out", ["in/out", "lie in each other"]),
        (["in"], "in", ["lie in each other"]),
        (["in"], ".", ["lie in each other"]),
        (["in/**/*.npz"], "in/out", ["in/**/*.npz", "lie in each other"]),
        (["in/*/*.csv"], "in/out", ["lie in each other"]),
        (["in/a.npz"], "in", ["in/a.npz", "lies in the output folder"]),
        (["link"], "in/out", ["lie in each other"]),
        (["up.txt"], "out", ["up.txt, line 2", "'../a.npz'"]),
        (["absolute.txt"], "out", ["absolute.txt, line 1", "'/a.npz'"]),
        (["in/s*/../../above.npz"], "out", ["above.npz", "outside", "'..'"]),
        (["in/a.npz", "in/sub/../a.npz"], "out", ["in/a.npz and in/sub/../a.npz", "a.npz"]),
        (["in"], "linked", ["linked/sub/b.csv", "link"]),
        (["nothing"], "out", ["nothing is no file"]),
        (["*.bvh"], "out", ["*.bvh gives no motion file"]),
        (["empty"], "out", ["empty gives no motion file"]),
    ],
)
def test_what_would_read_answers_or_write_elsewhere_is_refused(archive, refused, sources, folder, words):
    Path("up.txt").write_text("in/a.npz\n../a.npz\n")
    Path("absolute.txt").write_text("/a.npz\n")
    save(motion(0), "above.npz")
    Path("link").symlink_to("in")
    Path("empty").mkdir()
    Path("linked").mkdir()
    Path("elsewhere").mkdir()
    Path("linked/sub").symlink_to("../elsewhere")
    refused(lambda: plan(sources, folder), *words, error=ValueError)


def test_an_answer_that_is_a_link_and_an_unknown_format_are_refused(archive, refused):
    Path("out").mkdir()
    Path("out/manifest.jsonl").symlink_to("../in/a.npz")
    refused(lambda: plan(["in"], "out"), "out/manifest.jsonl", "link", error=ValueError)
    refused(lambda: plan(["in"], "other", to="amc"), "'amc'", "npz", error=ValueError)


def test_a_folder_of_other_files_is_refused_unless_told(archive, refused):
    Path("out").mkdir()
    Path("out/a.npz").write_text("precious")
    jobs = plan(["in/a.npz"], "out")
    refused(lambda: run(jobs, "out", FAST, here), "out holds a.npz", "--overwrite", error=FileExistsError)
    assert [path.name for path in Path("out").iterdir()] == ["a.npz"]
    assert run(jobs, "out", FAST, here, overwrite=True).done == 1
    assert len(load("out/a.npz")) == 30


# What is done, what is done again.


def test_answers_are_those_of_recover_and_the_manifest_says_how(archive):
    assert again(["in"], "out") == ["a.npz", "sub/b.csv"]
    assert main(["recover", "in/a.npz", "-o", "alone.npz", "--max-steps", "3", "--quiet"]) == 0
    assert Path("out/a.npz").read_bytes() == Path("alone.npz").read_bytes()
    first, second = lines("out")
    assert (first["output"], second["output"]) == ("a.npz", "sub/b.csv")
    assert first["status"] == "done"
    assert first["sha256"] == files.sha256("in/a.npz")
    assert first["parameters"]["max_steps"] == 3
    assert first["samples"]["repaired"] > 0
    assert first["bone_length_deviation_mm"]["after"] < first["bone_length_deviation_mm"]["before"]
    assert sorted(path.name for path in Path("out").rglob("*")) == [
        "a.npz",
        "b.csv",
        "index.html",
        "manifest.jsonl",
        "sub",
    ]


def test_only_what_is_missing_or_changed_is_done_again(archive):
    assert again(["in"], "out") == ["a.npz", "sub/b.csv"]
    assert again(["in"], "out") == []
    save(motion(2), "in/a.npz", overwrite=True)
    assert again(["in"], "out") == ["a.npz"]
    Path("out/sub/b.csv").unlink()
    assert again(["in"], "out") == ["sub/b.csv"]
    os.truncate("out/a.npz", 100)
    assert again(["in"], "out") == ["a.npz"]
    save(motion(3), "in/c.npz")
    assert again(["in"], "out") == ["c.npz"]
    other = Settings(recovery={"max_steps": 3, "max_gap": 5})
    assert again(["in"], "out", other) == ["a.npz", "c.npz", "sub/b.csv"]
    assert again(["in"], "out", other) == []


def test_a_changed_skeleton_file_is_another_parameter(archive):
    assert main(["skeleton", "in/a.npz", "-o", "bones.toml"]) == 0
    asked = Settings(recovery={"max_steps": 3}, reading={"skeleton": "bones.toml"})
    assert again(["in/a.npz"], "out", asked) == ["a.npz"]
    assert again(["in/a.npz"], "out", asked) == []
    with open("bones.toml", "a") as file:
        file.write("# looked over\n")
    assert again(["in/a.npz"], "out", asked) == ["a.npz"]


def test_files_beside_a_clip_are_inputs_too(tmp_path):
    amc, asf = tmp_path / "take.amc", tmp_path / "body.ASF"
    amc.write_text("")
    asf.write_text("one")
    (job,) = plan([amc], tmp_path / "out")
    before = clip_module.sources(Path(job.source), FAST)
    asf.write_text("two")
    after = clip_module.sources(Path(job.source), FAST)
    assert before["sha256"] == after["sha256"]
    assert before["beside"].keys() == after["beside"].keys() == {"body.ASF"}
    assert before["beside"] != after["beside"]


def test_a_bad_clip_has_a_reason_and_is_tried_again(archive, run_cli):
    Path("in/bad.npz").write_text("nothing")
    Path("in/gone.bvh").symlink_to("nowhere")
    hidden = np.full((30, 5, 3), np.nan)
    save(motion(0).with_positions(hidden, "lost"), "in/lost.npz")
    arguments = "batch", "in", "-o", "out", "--max-steps", "3"
    code, out, err = run_cli(*arguments)
    assert (code, err) == (1, "")
    assert "2 clips, 60 frames" in out
    assert "failed" in out
    assert "in/bad.npz is no NPZ file" in out
    reasons = {line["output"]: line["reason"] for line in lines("out") if line["status"] == "failed"}
    assert reasons.keys() == {"bad.npz", "gone.bvh", "lost.npz"}
    assert "no measured sample" in reasons["lost.npz"]
    save(motion(4), "in/bad.npz", overwrite=True)
    code, out, _ = run_cli(*arguments, "--json")
    found = json.loads(out)
    assert (code, found["done"], found["kept"], found["failed"]) == (1, 1, 2, 2)
    assert [failure["input"] for failure in found["first_failures"]] == ["in/gone.bvh", "in/lost.npz"]
    assert run_cli("batch", "in", "-o", "in/out")[0] == 2


@pytest.fixture
def run_cli(capsys, monkeypatch):
    """Runs the command line in this process alone, and gives its exit code, stdout and stderr."""
    monkeypatch.setattr("motionrecover.batch.Processes", lambda workers: here)

    def call(*arguments):
        code = main(list(arguments))
        return code, *capsys.readouterr()

    return call


def test_defects_of_ours_stop_no_batch(archive, monkeypatch):
    def broken(*_, **__):
        raise IndexError("list index out of range")

    monkeypatch.setattr(clip_module, "recover_motion", broken)
    assert again(["in"], "out") == ["a.npz", "sub/b.csv"]
    assert {line["reason"] for line in lines("out")} == {"IndexError: list index out of range"}


def test_reports_are_made_when_asked_for_and_go_when_they_are_out_of_date(archive):
    pytest.importorskip("plotly")
    with_pages = Settings(recovery={"max_steps": 3}, report=True)
    assert again(["in/a.npz"], "out") == ["a.npz"]
    assert again(["in/a.npz"], "out", with_pages) == ["a.npz"]
    assert "./a.npz.html" in Path("out/index.html").read_text()
    assert again(["in/a.npz"], "out", with_pages) == again(["in/a.npz"], "out") == []
    save(motion(2), "in/a.npz", overwrite=True)
    assert again(["in/a.npz"], "out") == ["a.npz"]
    assert not Path("out/a.npz.html").exists()


def test_a_full_disk_stops_the_batch_and_the_same_call_goes_on(archive, monkeypatch, refused):
    real = clip_module.save

    def full(motion, path, **options):
        if Path(path).name == "b.csv":
            raise OSError(f"{path} could not be written: no space") from OSError(errno.ENOSPC, "no space")
        return real(motion, path, **options)

    monkeypatch.setattr(clip_module, "save", full)
    Path("in/z.npz").write_bytes(Path("in/a.npz").read_bytes())
    refused(lambda: again(["in"], "out"), "disk of out is full", "2 of 3 clips", "again", error=OSError)
    assert [line["output"] for line in lines("out")] == ["a.npz", "z.npz"]
    monkeypatch.setattr(clip_module, "save", real)
    assert again(["in"], "out") == ["sub/b.csv"]


def test_a_manifest_that_finds_no_room_stops_it_too(archive, monkeypatch, refused):
    def full(_):
        raise OSError(errno.ENOSPC, "no space")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        refused(lambda: again(["in"], "out"), "disk of out is full", "0 of 2 clips", error=OSError)
    assert lines("out") == []
    assert again(["in"], "out") == ["a.npz", "sub/b.csv"]


def test_leftovers_of_killed_writers_are_removed_and_nothing_else(archive):
    again(["in"], "out")
    for name in ("out/.0123456789abcdef.npz", "out/sub/.0123456789abcdef", "out/.mine.npz", "out/sub/0123456789abcdef"):
        Path(name).touch()
    again(["in"], "out")
    names = {path.name for path in Path("out").rglob("*") if path.is_file()}
    assert names == {"a.npz", "b.csv", "index.html", "manifest.jsonl", ".mine.npz", "0123456789abcdef"}


# What is written down.


def entry(name, **facts):
    return {"output": name, "input": name, "status": "done"} | facts


def test_the_last_line_on_a_clip_holds_and_torn_lines_are_mended(tmp_path):
    path = tmp_path / "manifest.jsonl"
    records = [entry("a", x=1), ["\udcff"], {"output": "d"}, entry("b", x=2), entry("a", x=3)]
    path.write_bytes("".join(f"{json.dumps(record)}\n" for record in records).encode() + b'\xff\n{"outp')
    with Manifest(path) as manifest:
        assert [record["x"] for record in manifest.records()] == [2, 3]
        manifest.append(entry("c\udcff", x=4))
        assert manifest.find("a") == entry("a", x=3)
        assert manifest.find("d") is None
    with Manifest(path) as manifest:
        assert [record["x"] for record in manifest.records()] == [2, 3, 4]
        assert manifest.find("c\udcff") == entry("c\udcff", x=4)
    assert path.read_bytes().count(b"\n") == 7


def test_the_index_escapes_and_sorts(tmp_path):
    def done(name, repaired):
        samples = {"untouched": 10 - repaired, "denoised": 0, "repaired": repaired, "filled": 0, "unknown": 0}
        bones = {"before": 1.0, "after": None}
        more = {"report": None, "moved_mm": None, "bone_length_deviation_mm": bones, "frames": 2, "message": "Fine."}
        return entry(name, samples=samples, **more)

    with Manifest(tmp_path / "manifest.jsonl") as manifest:
        for record in (
            done("little.npz", 1),
            done("<b>&\udcff.npz", 5),
            done("none.npz", 0),
            entry("bad <i>", status="failed", reason="<script>"),
        ):
            manifest.append(record)
        write_index(tmp_path / "index.html", manifest)
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "<script>" not in page
    assert "<b>" not in page
    assert 'href="./%3Cb%3E%26%FF.npz"' in page
    order = [page.index(name) for name in ("bad &lt;i&gt;", "&lt;b&gt;&amp;", "little.npz", "none.npz")]
    assert order == sorted(order)


# One batch at a time.


def holder(**changes):
    facts = {"host": socket.gethostname(), "pid": os.getpid(), "start": "2026-01-31 12:00:00 +0000"}
    return json.dumps(facts | changes)


@pytest.mark.parametrize(
    ("content", "age", "words"),
    [
        (holder(), 1e6, [f"process {os.getpid()} on {socket.gethostname()}", "2026-01-31 12:00:00"]),
        (holder(host="far-away", pid=7), 60, ["process 7 on far-away"]),
        ("", 60, ["another batch"]),
        ('{"pid": "7"}', 60, ["another batch"]),
        (holder(pid=2**22 + 1), 0, None),  # no process has such a number
        (holder(host="far-away"), 1e4, None),
        ("", 1e4, None),
    ],
    ids=["here", "elsewhere", "empty", "nameless", "ended", "silent elsewhere", "silent"],
)
def test_a_lock_names_its_batch_and_goes_stale(tmp_path, refused, content, age, words):
    path = tmp_path / "batch.lock"
    path.write_text(content)
    os.utime(path, (time.time() - age, time.time() - age))
    if words is None:
        with Lock(path):
            assert f'"pid": {os.getpid()}' in path.read_text()
        assert list(tmp_path.iterdir()) == []
    else:
        refused(Lock(path).__enter__, *words, "delete", error=Locked)
        assert path.read_text() == content
        assert list(tmp_path.iterdir()) == [path]


def test_a_batch_shows_signs_of_life(tmp_path, monkeypatch):
    monkeypatch.setattr(lock_module, "PULSE", 0.01)
    path = tmp_path / "batch.lock"
    with Lock(path):
        os.utime(path, (0, 0))
        end = time.monotonic() + 10
        while path.stat().st_mtime == 0 and time.monotonic() < end:
            time.sleep(0.01)
        assert path.stat().st_mtime > 0


def test_of_many_that_find_a_stale_lock_one_takes_it(tmp_path):
    path = tmp_path / "batch.lock"
    path.write_text(holder(pid=2**22 + 1))
    start, taken, refusals = threading.Barrier(8), [], []

    def take():
        start.wait()
        try:
            taken.append(Lock(path).__enter__())
        except Locked as error:
            refusals.append(error)

    threads = [threading.Thread(target=take) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(taken) == 1
    assert len(refusals) == 7
    taken[0].__exit__(None, None, None)
    assert list(tmp_path.iterdir()) == []


def test_a_batch_whose_lock_is_taken_over_stops(archive, refused):
    def robbed(work, jobs):
        for job, record in here(work, jobs):
            Path("out/batch.lock").write_text(holder(host="far-away"))
            Path("out/.0123456789abcdef.npz").touch()
            yield job, record

    jobs = plan(["in"], "out")
    refused(lambda: run(jobs, "out", FAST, robbed), "taken over", "far-away", error=Locked)
    assert "far-away" in Path("out/batch.lock").read_text()
    assert Path("out/.0123456789abcdef.npz").exists()  # the other one is writing it
    assert lines("out") == []


def test_the_tally_keeps_few_failures():
    tally = driver.Tally()
    for k in range(100):
        tally.add({"status": "failed", "input": str(k), "reason": "bad"})
    assert tally.failed == 100
    assert len(tally.failures) == driver.SHOWN
