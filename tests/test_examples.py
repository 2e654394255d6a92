"""The examples run, are short, and say what they should."""

import runpy
from pathlib import Path

import pytest

from motionrecover import Skeleton

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
SAYS = {
    "1_arrays": "spike: 228 mm before, ",
    "2_files_and_report": "took the bones from the file",
    "3_markers_without_bones": "160 samples were missing",
    "4_kinect_with_confidence": "guesses of confidence 0.0",
    "5_many_clips": "clip 2: No sample is observed",
    "6_what_was_found": "filled: ",
}


def test_every_example_is_known():
    assert [path.stem for path in EXAMPLES] == list(SAYS)


@pytest.mark.parametrize("path", EXAMPLES, ids=SAYS)
def test_an_example_runs(path, tmp_path, monkeypatch, capsys):
    assert len(path.read_text(encoding="utf-8").splitlines()) < 40
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    out, err = capsys.readouterr()
    assert SAYS[path.stem] in out
    assert err == ""
    if path.stem.startswith("2"):
        assert {"walk.html", "walk-clean.bvh"} <= {file.name for file in (tmp_path / "example-files").iterdir()}
    if path.stem.startswith("3"):
        assert len(Skeleton.from_file(tmp_path / "example-markers.toml").edges) > 24
