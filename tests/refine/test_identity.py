"""Networks that start as the identity: what they give back, what they keep, and that they learn from there."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import SMALL_BODY

from motionrecover.refine import models, weights
from motionrecover.refine.identity import as_identity
from motionrecover.refine.train import Settings, set_up, train
from motionrecover.skeleton import Skeleton

SETTINGS = Settings("bra", "choi-missing40", preset="identity", steps=40, batch=4, held_out=("3",))


@pytest.mark.parametrize(("name", "small"), [("bra", True), ("bra-dgn", True), ("bra-dgn-4", False)])
def test_observed_samples_pass_and_missing_ones_are_the_mean_pose(name, small):
    """Within a hundredth of the motion's size; and in the same numbers as the network that was drawn."""
    skeleton, rng = Skeleton.standard("cmu21"), np.random.default_rng(1)
    drawn = models.find(name).make(skeleton, np.random.default_rng(0), small)
    network = as_identity(drawn)
    assert [leaf.shape for leaf in jax.tree.leaves(network)] == [leaf.shape for leaf in jax.tree.leaves(drawn)]
    x = jnp.asarray(rng.normal(scale=0.17, size=(1, 12, 21, 3)), jnp.float32)
    observed = jnp.asarray(rng.random((1, 12, 21)) > 0.3)
    y, _ = network(x, observed)
    wanted = jnp.where(observed[..., None], x, 0)
    assert jnp.abs(y - wanted).mean() < 0.01 * jnp.abs(x).mean()
    assert jnp.abs(drawn(x, observed)[0] - wanted).mean() > 0.5 * jnp.abs(wanted).mean()


@pytest.mark.parametrize("name", ["cnn", "bra-p", "bra-dgn-2"])
def test_networks_without_such_a_form_are_refused_before_a_folder_is_made(name, clips_folder, tmp_path, refused):
    settings = replace(SETTINGS, model=name)
    refused(lambda: set_up(settings, clips_folder, tmp_path / "run", SMALL_BODY), "identity", error=ValueError)
    assert not (tmp_path / "run").exists()


def test_training_starts_at_the_mean_pose_and_improves_on_it(clips_folder, tmp_path):
    run = set_up(SETTINGS, clips_folder, tmp_path / "run", SMALL_BODY)
    lines = [line for line in train(run) if line["held_out_mm"] != ""]
    # What a network that is drawn at random is off by at first is several times the mean pose.
    assert lines[0]["held_out_missing_mm"] < 1.1 * lines[0]["mean_pose_missing_mm"]
    assert lines[-1]["distance"] < 0.8 * lines[0]["distance"]
    tensors, _ = weights.load_tensors(tmp_path / "run" / "weights.safetensors")
    still = [tensor for name, tensor in tensors.items() if name.endswith("running.variance")]
    assert still
    assert all((tensor == 1).all() for tensor in still)
