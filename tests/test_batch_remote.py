"""Batches from and to URLs, on file systems of fsspec that need no network."""

import json
import os
import signal
from pathlib import Path

import pytest
from batches import FAST, again, command, done, here, lines, motion, within

from motionrecover import save
from motionrecover.batch import Settings, plan, remote, run

fsspec = pytest.importorskip("fsspec")

IN, OUT = "memory://takes", "memory://clean"


@pytest.fixture
def memory(tmp_path, monkeypatch):
    """A file system with a clip in `takes`, one below, and a folder with the same; its own folder for manifests."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    files = fsspec.filesystem("memory")
    files.store.clear()
    Path("in/sub").mkdir(parents=True)
    save(motion(0), "in/a.npz")
    save(motion(1), "in/sub/b.csv")
    for name in ("a.npz", "sub/b.csv"):
        files.put_file(f"in/{name}", f"/takes/{name}")
    yield files
    files.store.clear()


def names(files, folder):
    return sorted(path.removeprefix(f"/{folder}/") for path in files.find(f"/{folder}"))


def test_answers_at_urls_are_those_of_folders_and_only_what_changed_is_done_again(memory, tmp_path):
    assert again([IN], OUT) == ["a.npz", "sub/b.csv"]
    assert names(memory, "clean") == ["a.npz", "index.html", "manifest.jsonl", "sub/b.csv"]
    again(["in"], "out")
    for name in ("a.npz", "sub/b.csv"):
        assert memory.cat(f"/clean/{name}") == Path("out", name).read_bytes()
    again([IN], "fetched")
    again([f"file://{tmp_path}/in"], f"file://{tmp_path}/local")
    for name in ("a.npz", "sub/b.csv"):
        assert Path("fetched", name).read_bytes() == Path("local", name).read_bytes() == Path("out", name).read_bytes()
    assert again([IN], OUT) == again([f"{IN}/"], OUT) == []
    memory.put_file("in/a.npz", "/takes/c.npz")
    assert again([IN], OUT) == ["c.npz"]
    memory.pipe_file("/takes/c.npz", b"nothing")
    assert again([IN], OUT) == ["c.npz"]
    record = json.loads(memory.cat("/clean/manifest.jsonl").splitlines()[-1])
    assert record["reason"].startswith("memory:///takes/c.npz is no NPZ file")
    memory.rm("/clean/sub/b.csv")
    memory.pipe_file("/clean/sub/.0123456789abcdef.csv", b"half")
    assert again([f"{IN}/**/*.csv"], OUT) == ["sub/b.csv"]
    assert "sub/.0123456789abcdef.csv" not in names(memory, "clean")


def test_another_machine_goes_on_from_the_manifest_that_was_sent(memory, monkeypatch, tmp_path):
    again([IN], OUT)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    assert again([IN], OUT) == []

    def stopped(work, jobs):
        yield from list(here(work, jobs))[:1]
        raise KeyboardInterrupt

    memory.put_file("in/a.npz", "/takes/0.npz")
    memory.put_file("in/a.npz", "/takes/1.npz")
    with pytest.raises(KeyboardInterrupt):
        run(plan([IN], OUT), OUT, FAST, stopped)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "third"))
    assert again([IN], OUT) == ["1.npz"]


def test_pages_go_with_the_answers_they_are_on(memory):
    pytest.importorskip("plotly")
    again([f"{IN}/a.npz"], OUT, Settings(recovery={"max_steps": 3}, report=True))
    assert "a.npz.html" in names(memory, "clean")
    assert again([f"{IN}/a.npz"], OUT, Settings(recovery={"max_steps": 4})) == ["a.npz"]
    assert "a.npz.html" not in names(memory, "clean")


def test_files_beside_a_clip_are_fetched_and_stamped(memory):
    memory.pipe({"/amc/a.amc": b"motion", "/amc/body.asf": b"one", "/amc/notes.txt": b"no"})
    before = remote.stamp("memory://amc/a.amc", None)
    assert before == remote.stamp("memory://amc/a.amc", None)
    with remote.fetched("memory://amc/a.amc", None) as path:
        assert {each.name: each.read_bytes() for each in path.parent.iterdir()} == {
            "a.amc": b"motion",
            "body.asf": b"one",
        }
    assert not path.exists()
    memory.pipe_file("/amc/body.asf", b"two")
    assert remote.stamp("memory://amc/a.amc", None) != before


def test_names_that_lead_out_and_overlapping_urls_are_refused(memory, refused, tmp_path):
    def refuse(sources, folder, *words):
        refused(lambda: plan(sources, folder), *words, error=ValueError)

    for folder in ("out", OUT):
        for key, word in (("/takes/../../x.npz", "'..'"), ("/takes//etc/x.npz", "'//'")):
            memory.pipe_file(key, b"")
            refuse([IN], folder, "outside the output folder", word)
            memory.store.pop(key)
    refuse([IN], f"{IN}/out", "lie in each other")
    refuse([f"{IN}/sub"], IN, "lie in each other")
    refuse([f"{IN}/*.npz"], "memory:///takes/", "lie in each other")
    refuse([f"file://{tmp_path}/in"], "in/out", "lie in each other")
    refuse(["in"], f"file://{tmp_path}/in/out", "lie in each other")
    refuse(["memory://nothing"], OUT, "gives no motion file")
    memory.pipe_file("/takes/long.zarr/position/zarr.json", b"")
    memory.pipe_file("/takes/long.zarr/position/c.npy", b"")
    refuse([IN], "out", "long.zarr", "copy stores")
    refuse([f"{IN}/long.zarr"], "out", "long.zarr", "copy stores")
    memory.pipe_file("/full/precious.txt", b"")
    jobs = plan(["in"], "memory://full")
    refused(lambda: run(jobs, "memory://full", FAST, here), "precious.txt", "--overwrite", error=FileExistsError)
    refuse(["strange://x/y"], "out", "strange")


def test_a_batch_at_urls_killed_in_the_middle_ends_like_one_that_was_not(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("FSSPEC_DIR", json.dumps({"path": str(tmp_path / "bucket"), "target_protocol": "file"}))
    (tmp_path / "bucket/in").mkdir(parents=True)
    for seed in range(4):
        save(motion(seed), tmp_path / f"bucket/in/{seed}.npz")
    done(command(tmp_path / "bucket", "undisturbed", workers=1))
    process = command(tmp_path, "dir://out", source="dir://in", workers=1)
    home = remote.home("dir://out")
    within(120, lambda: lines(home))
    process.send_signal(signal.SIGKILL)
    process.communicate()
    kept = len(lines(home))
    out, _ = done(command(tmp_path, "dir://out", "--json", source="dir://in", workers=1))
    assert json.loads(out)["kept"] == kept
    bucket = tmp_path / "bucket"
    assert {path.name for path in (bucket / "out").iterdir()} == {
        *(f"{seed}.npz" for seed in range(4)),
        "index.html",
        "manifest.jsonl",
    }
    for seed in range(4):
        name = f"{seed}.npz"
        assert (bucket / "out" / name).read_bytes() == (bucket / "undisturbed" / name).read_bytes()
    written = [line["output"] for line in lines(bucket / "out")]
    assert len(written) == len(set(written)) == 4
    assert sorted(os.listdir(home)) == ["index.html", "manifest.jsonl"]
