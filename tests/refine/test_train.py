"""Training: the same bits after a stop or a kill, stages that leave alone what they should, and what is refused."""

import csv
import os
import signal
import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import SMALL_BODY

from motionrecover.refine import load_refiner, models, weights
from motionrecover.refine import train as training
from motionrecover.refine.schedule import PRESETS, plan, rate_at
from motionrecover.refine.step import Given, Task, fresh_moments, step
from motionrecover.refine.train import Settings, TrainingError, set_up, train

CNN = Settings("cnn", "choi-missing20-noise3", steps=20, batch=4, held_out=("3",))


def run_through(settings, data, folder, stop=None, resume=False):
    for line in train(set_up(settings, data, folder, SMALL_BODY, resume)):
        if line["step"] == stop:
            return


def results(folder):
    tensors, _ = weights.load_tensors(folder / "weights.safetensors")
    with (folder / "log.csv").open(newline="") as file:
        lines = [{k: v for k, v in line.items() if k != "seconds"} for line in csv.DictReader(file)]
    return {name: tensor.tobytes() for name, tensor in tensors.items()}, lines


def test_twenty_steps_are_ten_and_ten_bit_for_bit(clips_folder, tmp_path, monkeypatch):
    """Of the network with the most state: two autoencoders one after the other, dropout and Adam's moments."""
    model = models.MODELS["bra-p"]
    short = replace(model, convention=replace(model.convention, window=16))
    monkeypatch.setitem(models.MODELS, "bra-p", short)
    settings = replace(CNN, model="bra-p")
    run_through(settings, clips_folder, tmp_path / "whole")
    run_through(settings, clips_folder, tmp_path / "halves", stop=10)
    assert not (tmp_path / "halves" / "weights.safetensors").exists()
    first = weights.load_tensors(tmp_path / "halves" / "checkpoint.safetensors")[0]
    run_through(settings, clips_folder, tmp_path / "halves", resume=True)
    assert results(tmp_path / "halves") == results(tmp_path / "whole")

    last = weights.load_tensors(tmp_path / "whole" / "checkpoint.safetensors")[0]
    same = {name: (first[name] == last[name]).all() for name in first if name in last and name.startswith("model.")}
    assert all(each for name, each in same.items() if name.startswith("model.perceptual"))
    assert not any(each for name, each in same.items() if name.startswith("model.denoiser"))


KILLED = """
import sys, time
from motionrecover.refine.train import Settings, set_up, train
from motionrecover.skeleton import Skeleton
tree = Skeleton(["root", "hip", "knee", "chest", "hand"], [(0, 1), (1, 2), (0, 3), (3, 4)])
settings = Settings("cnn", "choi-missing20-noise3", steps=20, batch=4, held_out=("3",))
for line in train(set_up(settings, sys.argv[1], sys.argv[2], tree)):
    print(line["step"], flush=True)
    time.sleep(0.2)
"""


def test_a_run_that_was_killed_goes_on_bit_for_bit(clips_folder, tmp_path):
    command = [sys.executable, "-c", KILLED, str(clips_folder), str(tmp_path / "killed")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, env=os.environ | {"JAX_ENABLE_X64": "1", "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if int(line) == 7:
                break
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    lines = (tmp_path / "killed" / "log.csv").read_text()
    assert 7 <= lines.count("\n") - 1 < 10
    with (tmp_path / "killed" / "log.csv").open("a") as file:
        file.write("11,0.")  # half a line
    run_through(CNN, clips_folder, tmp_path / "killed", resume=True)
    run_through(CNN, clips_folder, tmp_path / "whole")
    assert results(tmp_path / "killed") == results(tmp_path / "whole")


def test_incidence_rests_while_it_is_told_to(clips_folder, tmp_path):
    run = set_up(replace(CNN, model="bra-dgn-2"), clips_folder, tmp_path / "run", SMALL_BODY)
    network = run.model.make(SMALL_BODY, np.random.default_rng(0), True)
    moments, before = fresh_moments(network, "all"), weights.tensors_of(network, "")
    one = dict.fromkeys(("position", "distance", "bone", "smooth", "perceptual"), jnp.float32(1))
    given = Given(
        Task("bra-dgn-2", CNN.protocol, SMALL_BODY, "all"),
        jnp.asarray(run.normaliser.mean),
        jnp.asarray(run.normaliser.scale),
        clean=jnp.asarray(run.trained.batch(0, 4, 0)),
        key=jax.random.key(1),
        rate=jnp.float32(0.01),
        graph=jnp.float32(0),
        weights=one,
        so_far=dict.fromkeys(("loss", *one), jnp.float32(0)),
    )
    for graph in (0.0, 1.0):
        network, moments, so_far = step(given._replace(graph=jnp.float32(graph)), network, moments)
        after = weights.tensors_of(network, "")
        moved = {name: bool((after[name] != before[name]).any()) for name in before}
        assert moved["encoder.0.sources"] == moved["decoder.0.targets"] == bool(graph)
        assert moved["encoder.0.node_update.weight"]
        assert moved["node_norm.running.mean"]
        assert so_far["loss"] > so_far["position"] > 0


def test_the_published_epochs_and_rates_are_the_plan():
    phases = plan(models.find("bra-dgn"), PRESETS["paper"], 2962)
    assert phases[-1].stop == 400 * 2962
    assert [phase.stop // 2962 for phase in phases] == [10, 50, 200, 300, 400]
    assert [phase.stage.graph for phase in phases] == [False, False, True, True, True]
    assert [rate_at(phase.first, phases, PRESETS["paper"]) for phase in phases] == [1e-3, 1e-4, 1e-4, 1e-4, 1e-4]
    weights_of = phases[-1].stage.weights
    assert (weights_of.position, weights_of.bone, weights_of.smooth) == (1, 5e-4, 5e-4)
    assert [phase.stage.trains for phase in plan(models.find("bra-p"), PRESETS["paper"], 10)] == [
        "perceptual",
        "denoiser",
    ]


def test_the_small_preset_warms_up_and_cools_down_for_each_autoencoder():
    phases = plan(models.find("bra-p"), PRESETS["small"], 1, 1000)
    rates = [rate_at(step, phases, PRESETS["small"]) for step in range(1000)]
    assert rates[0] < 1e-4 < 9e-4 < max(rates) <= 1e-3
    np.testing.assert_allclose(rates[:500], rates[500:])
    assert rates[499] < 3e-5


def test_numbers_that_are_not_finite_stop_it_and_the_last_good_checkpoint_is_named(clips_folder, tmp_path, monkeypatch):
    run = set_up(CNN, clips_folder, tmp_path / "run", SMALL_BODY)
    good = training.rate_at
    monkeypatch.setattr(training, "rate_at", lambda step, *rest: np.nan if step == 7 else good(step, *rest))
    with pytest.raises(TrainingError, match=r"at step 9.*checkpoint\.safetensors of step 5") as caught:
        list(train(run))
    assert "\n" not in str(caught.value)
    assert load_refiner(tmp_path / "run").name == "cnn"


def test_folders_of_other_runs_are_refused(clips_folder, tmp_path, refused):
    folder = tmp_path / "run"
    refused(lambda: set_up(CNN, clips_folder, folder, SMALL_BODY, True), "no run to resume", error=TrainingError)
    set_up(CNN, clips_folder, folder, SMALL_BODY)
    refused(lambda: set_up(CNN, clips_folder, folder, SMALL_BODY), "holds files already", error=TrainingError)
    for change in ({"model": "bra"}, {"seed": 1}, {"protocol": "mixed"}, {"held_out": ("2",)}):
        other = replace(CNN, **change)
        name = next(iter(change))
        refused(lambda other=other: set_up(other, clips_folder, folder, SMALL_BODY, True), name, error=TrainingError)
    (folder / "config.json").write_text("{")
    refused(lambda: set_up(CNN, clips_folder, folder, SMALL_BODY, True), "no JSON", error=TrainingError)
    refused(lambda: set_up(replace(CNN, batch=999), clips_folder, tmp_path / "b", SMALL_BODY), "999", error=ValueError)
