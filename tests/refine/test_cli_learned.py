"""The commands models, train and refine."""

import json

import numpy as np
import pytest
from helpers import SMALL_BODY, clip

from motionrecover import Motion, load, save, save_skeleton


def test_models_are_listed_with_their_exact_sizes(run):
    code, out, _ = run("models", "--json")
    assert code == 0
    counts = {model["name"]: model["parameters"] for model in json.loads(out)["models"]}
    assert counts["bra"] == 3_501_757
    assert counts["bra-dgn"] == 3_450_870
    assert [counts[f"bra-dgn-{k}"] for k in (2, 4, 5)] == [3_446_010, 3_457_854, 3_462_606]
    assert counts["cnn"] == 806_719
    code, out, _ = run("models")
    assert "806,719" in out


def test_a_folder_of_clips_becomes_a_refiner_with_two_commands(run, clips_folder, tmp_path):
    save_skeleton(SMALL_BODY, tmp_path / "body.toml")
    out = tmp_path / "run"
    how = ["--model", "cnn", "--data", clips_folder, "--protocol", "choi-missing40", "--out", out, "--steps", 3]
    how += ["--batch", 4, "--held-out", "3", "--skeleton", tmp_path / "body.toml"]
    code, said, err = run("train", *how)
    assert (code, err) == (0, "")
    assert "step 3 of 3" in said
    assert "subjects 3" in said
    assert {path.name for path in out.iterdir()} == {
        *("config.json", "log.csv", "loss.png", "checkpoint.safetensors", "weights.safetensors")
    }
    code, said, err = run("train", *how)
    assert code == 2
    assert "--resume" in err
    code, said, err = run("train", *how, "--resume")
    assert (code, err) == (0, "")
    assert "3 of 3 steps" in said

    positions = clip(SMALL_BODY, 50, seed=9)
    positions[10:20, 2] = np.nan
    save(Motion(positions, SMALL_BODY, 60.0), tmp_path / "in.npz")
    code, said, err = run("refine", tmp_path / "in.npz", "-o", tmp_path / "out.npz", "--model", out, "--json")
    assert (code, err) == (0, "")
    facts = json.loads(said)
    assert facts["joints_left"] == []
    assert facts["filled_share"] == pytest.approx(10 / 250)
    refined = load(tmp_path / "out.npz")
    assert refined.observed.all()
    kept = np.isfinite(positions)
    np.testing.assert_array_equal(refined.positions[kept], positions[kept])
    code, said, err = run("refine", tmp_path / "in.npz", "-o", tmp_path / "other.npz", "--model", "bra")
    assert code == 2
    assert "no weights of 'bra'" in err
    assert not (tmp_path / "other.npz").exists()
