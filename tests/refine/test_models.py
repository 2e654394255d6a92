"""The networks: exact sizes, what they may not depend on, and that they learn."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from helpers import SMALL_BODY, TOLERANCE, clip

from motionrecover.refine import models
from motionrecover.refine.bra import BRA
from motionrecover.refine.bra_dgn import BRADGN, Block, incidence, towards_centre
from motionrecover.refine.bra_p import BRAP
from motionrecover.refine.cnn import CNN
from motionrecover.refine.ebf import EBF
from motionrecover.refine.missing_marker import LSTMNet, WindowNet
from motionrecover.refine.normalise import Normaliser
from motionrecover.skeleton import Skeleton


def rng():
    return np.random.default_rng(0)


JOINTS = len(SMALL_BODY.names)
TINY = {
    "bra": partial(BRA.make, JOINTS, widths=(24, 32)),
    "bra_p": partial(BRAP.make, JOINTS, widths=(24, 32), dropout=0.0),
    "bra_dgn": partial(BRADGN.make, SMALL_BODY, widths=(8,)),
    "cnn": partial(CNN.make, JOINTS, filters=32, width=5),
    "ebf": partial(EBF.make, JOINTS, widths=(64,), reach=4),
    "window": partial(WindowNet.make, JOINTS, width=64, window=4, spread=0.0, dropout=0.0),
    "lstm": partial(LSTMNet.make, JOINTS, width=48, spread=0.0, dropout=0.0),
}
TRAINING = jax.random.key(7)


def batch(frames=12, count=3):
    """Clean and noisy motion about its mean, and the mask: windows of a moving body."""
    motion = clip(SMALL_BODY, frames * count, seed=2)
    motion = motion - motion[:, :1]
    clean = (motion - motion.mean(0)).reshape(count, frames, JOINTS, 3).astype(np.float32)
    rng = np.random.default_rng(0)
    return clean, clean + rng.normal(scale=0.1, size=clean.shape).astype(np.float32), rng.random(clean.shape[:3]) > 0.2


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("cnn", 806_719),
        ("cnn+constraint", 806_719),
        ("bra", 3_501_757),
        ("ebd", 3_501_757),
        ("bra-dgn", 3_450_870),
        ("ebd-dgn", 3_450_870),
        ("bra-dgn-released", 3_450_870),
        ("bra-dgn-2", 3_446_010),
        ("bra-dgn-4", 3_457_854),
        ("bra-dgn-5", 3_462_606),
        ("bra-p", 2 * 3_499_071),
    ],
)
def test_parameter_counts_are_the_published_ones(name, count):
    assert models.parameter_count(name) == count


def test_every_model_has_a_small_form_for_any_skeleton():
    for name in models.MODELS:
        assert 0 < models.parameter_count(name, SMALL_BODY, small=True) < models.parameter_count(name, SMALL_BODY)


@pytest.mark.parametrize("name", TINY)
def test_stored_values_of_missing_samples_never_matter(name):
    network = TINY[name](rng=rng())
    _, noisy, observed = batch()
    observed[:, :, 4] = False
    run = eqx.filter_jit(lambda x: network(x, observed)[0])
    answers = [np.asarray(run(np.where(observed[..., None], noisy, v).astype(np.float32))) for v in (0, np.nan, 1e6)]
    assert np.isfinite(answers[0]).all()
    assert (answers[0] == answers[1]).all()
    assert (answers[0] == answers[2]).all()


@pytest.mark.parametrize("name", TINY)
def test_one_batch_is_learnt_by_heart(name):
    """The loss falls 50-fold in 120 steps."""
    network = TINY[name](rng=rng())
    clean, noisy, observed = batch(count=2)
    if name == "ebf":  # a filter makes nothing new: what it can take away are spikes
        noisy, observed = np.where(observed[..., None], clean, clean + 0.5), np.ones_like(observed)
    parameters, rest = eqx.partition(network, models.is_parameter(network))
    optimiser = optax.adam(optax.cosine_decay_schedule(0.03 if name == "ebf" else 0.02, 120, 0.02))

    def loss(parameters, rest):
        network = eqx.combine(parameters, rest)
        y, new = network(noisy, observed, TRAINING)
        return ((y - clean) ** 2).mean(), eqx.filter(new, models.is_parameter(new), inverse=True)

    @eqx.filter_jit
    def learn(parameters, rest):
        def step(carry, _):
            parameters, rest, moments = carry
            (value, rest), grads = jax.value_and_grad(loss, has_aux=True)(parameters, rest)
            updates, moments = optimiser.update(grads, moments)
            return (eqx.apply_updates(parameters, updates), rest, moments), value

        return jax.lax.scan(step, (parameters, rest, optimiser.init(parameters)), length=121)[1]

    history = np.asarray(learn(parameters, rest))
    assert history[0] > 50 * history[-1], history[[0, -1]]


def test_a_graph_block_is_its_equations():
    """Three joints in a chain 0 - 1 - 2 with centre 1, everything by hand."""
    inward = towards_centre(Skeleton(["a", "thorax", "c"], [("a", "thorax"), ("thorax", "c")]))
    assert inward == (1, 1, 1)
    sources, targets = incidence(inward)
    # Edges 0, 1, 2 leave joint 1; edge j ends in joint j; joint 1 has four ends, the others one.
    np.testing.assert_allclose(sources, np.array([[0, 0, 0], [0.25, 0.25, 0.25], [0, 0, 0]]) + 1e-6)
    np.testing.assert_allclose(targets, np.diag([1, 0.25, 1]) + 1e-6)
    v, e = rng().normal(size=(2, 3, 2))
    for released in (False, True):
        block = Block.make((sources, targets), 2, 4, rng(), released=released)
        nodes, edges, _ = block(jnp.float32(v), jnp.float32(e), False)
        for joint in range(3):
            incoming = [sum(a[joint, k] * e[k] for k in range(3)) for a in (sources, targets)]
            row = np.concatenate([v[joint], *incoming]) @ block.node_update.weight + block.node_update.bias
            np.testing.assert_allclose(nodes[joint], np.maximum(row / np.sqrt(1 + 1e-5), 0), atol=TOLERANCE["network"])
            seen = e if released else v
            ends = [sum(a[k, joint] * seen[k] for k in range(3)) for a in (sources, targets)]
            row = np.concatenate([e[joint], *ends]) @ block.edge_update.weight + block.edge_update.bias
            np.testing.assert_allclose(edges[joint], np.maximum(row / np.sqrt(1 + 1e-5), 0), atol=TOLERANCE["network"])


def test_a_graph_block_does_not_depend_on_the_order_of_joints():
    inward, order = towards_centre(SMALL_BODY), rng().permutation(JOINTS)
    place = np.argsort(order)
    relabelled = tuple(int(place[inward[joint]]) for joint in order)
    v, e = rng().normal(size=(2, 3, 6, JOINTS, 3)).astype(np.float32)
    first, second = (Block.make(incidence(graph), 3, 4, rng()) for graph in (inward, relabelled))
    for found, expected in zip(second(v[:, :, order], e[:, :, order], True)[:2], first(v, e, True)[:2], strict=True):
        np.testing.assert_allclose(found, expected[:, :, order], atol=TOLERANCE["network"])


def test_graph_networks_need_a_tree_and_a_known_update():
    ring = Skeleton("abc", [(0, 1), (1, 2), (2, 0)])
    with pytest.raises(ValueError, match="no tree"):
        BRADGN.make(ring, rng())
    with pytest.raises(ValueError, match="edge_update"):
        BRADGN.make(SMALL_BODY, rng(), edge_update="both")
    with pytest.raises(ValueError, match="received the model 'brad'"):
        models.find("brad")


def test_any_number_of_frames_is_refined():
    for name, make in TINY.items():
        network = make(rng=rng())
        for frames in (1, 7):
            _, noisy, observed = batch(frames, 2)
            assert eqx.filter_eval_shape(network, noisy, observed)[0].shape == noisy.shape, name


def test_the_post_pass_is_the_perceptual_autoencoder():
    _, noisy, observed = batch()
    network = TINY["bra_p"](rng=rng())
    denoised = network.denoiser(noisy, observed)[0]
    expected = network.perceptual(denoised, np.ones_like(observed))[0]
    np.testing.assert_array_equal(network(noisy, observed)[0], expected)
    alone = BRAP(network.perceptual, network.denoiser, False)
    np.testing.assert_array_equal(alone(noisy, observed)[0], denoised)
    assert network.perceive(denoised).shape == (3, 12, 32)


def test_constrained_answers_have_bones_nearer_to_those_measured():
    clean, _, observed = batch()
    pose = clip(SMALL_BODY, 1)[0].astype(np.float32)
    network = CNN.make(JOINTS, rng(), 32, 5, constrained=SMALL_BODY.edges)
    i, j = np.array(SMALL_BODY.edges).T

    def lengths(x):
        return np.linalg.norm((x + pose)[:, :, i] - (x + pose)[:, :, j], axis=-1)

    def off(y):
        wanted = np.nanmean(np.where(observed[:, :, i] & observed[:, :, j], lengths(clean), np.nan), 1)
        return np.abs(lengths(np.asarray(y)) - wanted[:, None]).mean()

    free, _ = network(clean, observed)
    constrained = network.constrain(clean, observed, lambda x: x + pose)
    assert off(constrained) < 0.5 * off(free)
    normaliser = Normaliser(pose, np.ones(3, np.float32))
    np.testing.assert_array_equal(models.refined(network, clean, observed, normaliser), constrained)
