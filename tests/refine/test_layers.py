"""Layers against plain loops and their definitions."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers import TOLERANCE

from motionrecover.intake import fill
from motionrecover.refine.layers import LSTM, BatchNorm, BiLSTM, blank, dropout, interpolate, scan_lstm

KEY = jax.random.key(0)


def rng():
    return np.random.default_rng(0)


def logistic(x):
    return 1 / (1 + np.exp(-x))


def plain_lstm(x, w, u, b):
    """One LSTM over frames x (frame, input), a gate at a time in PyTorch's order: input, forget, cell, output."""
    size = u.shape[0]
    h, c, out = np.zeros(size), np.zeros(size), []
    for frame in x:
        gates = [frame @ w[:, k] + h @ u[:, k] + b[k] for k in np.arange(4 * size).reshape(4, size)]
        c = logistic(gates[1]) * c + logistic(gates[0]) * np.tanh(gates[2])
        h = logistic(gates[3]) * np.tanh(c)
        out.append(h)
    return np.array(out)


def test_bilstm_is_a_plain_loop_with_gates_in_the_order_of_pytorch():
    lstm = BiLSTM.make(3, 4, rng(), count=2)
    x = np.asarray(jax.random.normal(KEY, (2, 5, 7, 3), jnp.float32))
    found = np.asarray(lstm(x))
    for k in range(2):
        w, u = np.asarray(lstm.input_weight[k]), np.asarray(lstm.hidden_weight[k])
        b = np.asarray(lstm.input_bias[k] + lstm.hidden_bias[k])
        for clip in range(5):
            forward = plain_lstm(x[k, clip], w[0], u[0], b[0])
            backward = plain_lstm(x[k, clip, ::-1], w[1], u[1], b[1])[::-1]
            expected = np.concatenate([forward, backward], -1)
            np.testing.assert_allclose(found[k, clip], expected, atol=TOLERANCE["network"])


def test_the_gradient_of_the_scan_is_that_of_its_definition():
    def plain(gates, hidden_weight):
        h = c = jnp.zeros((*gates.shape[1:3], hidden_weight.shape[1]))
        out = []
        for now in gates:
            i, f, g, o = jnp.split(now + jnp.einsum("kbh,khj->kbj", h, hidden_weight), 4, -1)
            c = jax.nn.sigmoid(f) * c + jax.nn.sigmoid(i) * jnp.tanh(g)
            h = jax.nn.sigmoid(o) * jnp.tanh(c)
            out.append(h)
        return jnp.stack(out)

    keys = jax.random.split(KEY, 3)
    gates, weight = jax.random.normal(keys[0], (4, 2, 3, 8)), jax.random.normal(keys[1], (2, 2, 8))
    slope = jax.random.normal(keys[2], (4, 2, 3, 2))

    def slopes(scan):
        return jax.jit(jax.grad(lambda *at: (slope * scan(*at)).sum(), (0, 1)))(gates, weight)

    for found, expected in zip(slopes(scan_lstm), slopes(plain), strict=True):
        np.testing.assert_allclose(found, expected, atol=TOLERANCE["adjoint"])


def test_bilstm_of_reversed_frames_with_swapped_directions_is_reversed():
    lstm = BiLSTM.make(3, 4, rng())
    swapped = jax.tree.map(lambda a: a[:, ::-1], lstm)
    x = jax.random.normal(KEY, (1, 2, 6, 3), jnp.float32)
    forward, backward = jnp.split(swapped(x[:, :, ::-1])[:, :, ::-1], 2, -1)
    np.testing.assert_allclose(lstm(x), jnp.concatenate([backward, forward], -1), atol=TOLERANCE["network"])


def test_lstm_is_a_plain_loop():
    lstm = LSTM.make(3, 4, rng())
    x = np.asarray(jax.random.normal(KEY, (2, 5, 3), jnp.float32))
    for clip in range(2):
        expected = plain_lstm(x[clip], *map(np.asarray, (lstm.input_weight, lstm.hidden_weight, lstm.bias)))
        np.testing.assert_allclose(lstm(x)[clip], expected, atol=TOLERANCE["network"])


def test_batch_norm_by_its_definition_in_training_and_after():
    x = np.asarray(3 + 2 * jax.random.normal(KEY, (4, 6, 5), jnp.float32))
    norm = BatchNorm.make(5, scale=0.5)
    y, norm = norm(x, True)
    expected = 0.5 * (x - x.mean((0, 1))) / np.sqrt(x.var((0, 1)) + 1e-5)
    np.testing.assert_allclose(y, expected, atol=TOLERANCE["network"])
    np.testing.assert_allclose(norm.running.mean, 0.1 * x.mean((0, 1)), rtol=1e-5)
    np.testing.assert_allclose(norm.running.variance, 0.9 + 0.1 * x.var((0, 1), ddof=1), rtol=1e-5)
    mean, variance = norm.running
    again, same = norm(x, False)
    np.testing.assert_allclose(again, 0.5 * (x - mean) / np.sqrt(variance + 1e-5), atol=TOLERANCE["network"])
    assert (same.running.mean == norm.running.mean).all()


def test_dropout_keeps_the_mean_and_rests_without_a_key():
    x = jnp.ones((200, 200), jnp.float32)
    dropped = dropout(x, 0.2, KEY)
    np.testing.assert_allclose(np.unique(dropped), [0, 1.25])
    assert abs(float(dropped.mean()) - 1) < 0.01
    assert dropout(x, 0.2, None) is x


def test_interpolation_is_that_of_numpy_and_never_seen_joints_are_at_the_mean_pose():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(3, 12, 4, 3)).astype(np.float32)
    observed = rng.random((3, 12, 4)) > 0.6
    observed[1, :, 2] = False
    holed = np.where(observed[..., None], x, np.nan)
    expected = np.stack([fill(clip) for clip in holed])
    np.testing.assert_allclose(interpolate(holed, observed), expected, atol=TOLERANCE["network"])
    np.testing.assert_array_equal(blank(holed, observed), np.where(observed[..., None], x, 0))
