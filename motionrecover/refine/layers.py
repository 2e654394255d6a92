"""Layers that the networks share. Features are the last axis, time (frame) is the axis before it.

In training a network is called with a key: dropout is drawn, and batch normalisation uses the batch's own statistics.
Without a key it refines. Either way it returns its output and itself, with the running statistics brought up to date.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

MOMENTUM = 0.1
"""Of running statistics, and `EPSILON` beside a variance: PyTorch's, with which the published networks were trained."""
EPSILON = 1e-5


class Running(NamedTuple):
    """Mean and variance of the training data, for refining: state that no gradient reaches."""

    mean: Array
    variance: Array


class Linear(eqx.Module):
    """y = x W + b, drawn uniformly within 1/sqrt(inputs)."""

    weight: Float[Array, "input output"]
    bias: Float[Array, " output"]

    @staticmethod
    def make(inputs: int, outputs: int, rng: np.random.Generator) -> Linear:
        """Drawn anew."""
        bound = inputs**-0.5
        return Linear(uniform(rng, (inputs, outputs), bound), uniform(rng, (outputs,), bound))

    def __call__(self, x: Float[Array, "*batch input"]) -> Float[Array, "*batch output"]:
        """Applied to the last axis."""
        return x @ self.weight + self.bias


class BatchNorm(eqx.Module):
    """(x - mean) / sqrt(variance) * weight + bias over all axes but those of `shape`, the last ones (Ioffe 2015)."""

    weight: Array
    bias: Array
    running: Running

    @staticmethod
    def make(*shape: int, scale: float = 1.0) -> BatchNorm:
        """`scale` is the first weight. Before the output it is the spread of the targets: from 1, where they have 0.15,
        the first thousand steps would only shrink it."""
        weight, bias, mean, variance = (jnp.asarray(np.full(shape, x, np.float32)) for x in (scale, 0, 0, 1))
        return BatchNorm(weight, bias, Running(mean, variance))

    def __call__(self, x: Array, training: bool) -> tuple[Array, BatchNorm]:
        """The output, and the layer with new running statistics."""
        running = self.running
        mean, variance = running
        if training:
            axes = tuple(range(x.ndim - self.weight.ndim))
            count = x.size // self.weight.size
            mean, variance = x.mean(axes), x.var(axes)
            new = jax.lax.stop_gradient(Running(mean, variance * count / max(count - 1, 1)))
            running = jax.tree.map(lambda old, now: (1 - MOMENTUM) * old + MOMENTUM * now, self.running, new)
        y = (x - mean) * (self.weight * jax.lax.rsqrt(variance + EPSILON)) + self.bias
        return y, BatchNorm(self.weight, self.bias, running)


class BiLSTM(eqx.Module):
    """K independent bidirectional LSTMs of H units a direction (Hochreiter & Schmidhuber; Schuster & Paliwal, 1997).

    For each of the K and each direction, with s the logistic function and * element by element,

        i, f, g, o = x_t W + h_{t-1} U + b + b',      c_t = s(f) * c_{t-1} + s(i) * tanh(g),    h_t = s(o) * tanh(c_t)

    the order of the gates and the two biases being PyTorch's, from which the published parameter counts come. Output:
    the forward h beside the backward h, (..., 2H).

    The products x_t W of all frames are one matrix product, and both directions of all K advance in one scan, the
    backward ones on reversed frames.
    """

    input_weight: Float[Array, "lstm 2 input gates"]
    hidden_weight: Float[Array, "lstm 2 hidden gates"]
    input_bias: Float[Array, "lstm 2 gates"]
    hidden_bias: Float[Array, "lstm 2 gates"]

    @staticmethod
    def make(inputs: int, hidden: int, rng: np.random.Generator, count: int = 1) -> BiLSTM:
        """`count` of them, drawn uniformly within 1/sqrt(hidden)."""
        shapes = ((inputs, 4 * hidden), (hidden, 4 * hidden), (4 * hidden,), (4 * hidden,))
        return BiLSTM(*(uniform(rng, (count, 2, *shape), hidden**-0.5) for shape in shapes))

    def __call__(self, x: Float[Array, "lstm batch frame input"]) -> Float[Array, "lstm batch frame twice_hidden"]:
        """Each LSTM on its own sequences."""
        bias = self.input_bias + self.hidden_bias
        gates = []
        for k, clips in enumerate(jnp.swapaxes(x, 1, 2)):
            # Products of two matrices: as one product of stacked ones, twice the time on a CPU.
            rows = clips.reshape(-1, clips.shape[-1])
            for direction in range(2):
                row = rows @ self.input_weight[k, direction] + bias[k, direction]
                gates.append(row.reshape(*clips.shape[:2], -1)[:: 1 - 2 * direction])
        hidden = scan_lstm(jnp.stack(gates, 1), self.hidden_weight.reshape(-1, *self.hidden_weight.shape[2:]))
        both = jnp.concatenate([hidden[:, ::2], hidden[::-1, 1::2]], -1)
        return jnp.moveaxis(both, 0, 2)


class LSTM(eqx.Module):
    """One LSTM in one direction: `BiLSTM` without the backward half and with one bias."""

    input_weight: Float[Array, "input gates"]
    hidden_weight: Float[Array, "hidden gates"]
    bias: Float[Array, " gates"]

    @staticmethod
    def make(inputs: int, hidden: int, rng: np.random.Generator) -> LSTM:
        """Drawn anew, the forget gates open (bias 1)."""
        bias = np.repeat(np.array([0, 1, 0, 0], np.float32), hidden)
        input_weight, hidden_weight = (uniform(rng, (rows, 4 * hidden), hidden**-0.5) for rows in (inputs, hidden))
        return LSTM(input_weight, hidden_weight, jnp.asarray(bias))

    def __call__(self, x: Float[Array, "batch frame input"]) -> Float[Array, "batch frame hidden"]:
        """h of every frame."""
        gates = jnp.einsum("bti,ij->tbj", x, self.input_weight) + self.bias
        return jnp.moveaxis(scan_lstm(gates[:, None], self.hidden_weight[None])[:, 0], 0, 1)


@jax.custom_vjp
def scan_lstm(
    gates: Float[Array, "frame lstm batch gates"], hidden_weight: Float[Array, "lstm hidden gates"]
) -> Float[Array, "frame lstm batch hidden"]:
    """h of every frame from x_t W + b of every frame: one scan for all LSTMs together.

    Its gradient is written out, since JAX's own adds up that of U frame by frame. Here the scan backwards gives those
    of the gates, and U's is one matrix product of all frames.
    """
    return _scan_forwards(gates, hidden_weight)[0]


def _scan_forwards(gates, hidden_weight):
    def step(state, now):
        h, c = state
        i, f, g, o = jnp.split(now + jnp.einsum("kbh,khj->kbj", h, hidden_weight), 4, -1)
        i, f, g, o = jax.nn.sigmoid(i), jax.nn.sigmoid(f), jnp.tanh(g), jax.nn.sigmoid(o)
        c = f * c + i * g
        h = o * jnp.tanh(c)
        return (h, c), (h, c, jnp.concatenate([i, f, g, o], -1))

    start = jnp.zeros((*gates.shape[1:3], hidden_weight.shape[1]), gates.dtype)
    _, (hidden, cells, opened) = jax.lax.scan(step, (start, start), gates)
    return hidden, (hidden, cells, opened, hidden_weight)


def _scan_backwards(kept, slope):
    hidden, cells, opened, hidden_weight = kept
    first, transposed = jnp.zeros_like(cells[:1]), jnp.swapaxes(hidden_weight, 1, 2)

    def step(state, now):
        dh, dc = state
        slope, opened, c, c_before = now
        i, f, g, o = jnp.split(opened, 4, -1)
        dh, flat_c = dh + slope, jnp.tanh(c)
        dc = dc + dh * o * (1 - flat_c**2)
        parts = dc * g * i * (1 - i), dc * c_before * f * (1 - f), dc * i * (1 - g**2), dh * flat_c * o * (1 - o)
        dgates = jnp.concatenate(parts, -1)
        return (jnp.einsum("kbj,kjh->kbh", dgates, transposed), dc * f), dgates

    before = jnp.concatenate([first, cells[:-1]])
    _, dgates = jax.lax.scan(step, (first[0], first[0]), (slope, opened, cells, before), reverse=True)
    h, d = (jnp.swapaxes(a, 0, 1).reshape(a.shape[1], -1, a.shape[-1]) for a in (hidden[:-1], dgates[1:]))
    return dgates, jnp.stack([h[k].T @ d[k] for k in range(len(h))])


scan_lstm.defvjp(_scan_forwards, _scan_backwards)


def dropout(x: Array, rate: float, key: PRNGKeyArray | None) -> Array:
    """Each element is 0 with probability `rate`, and the others 1/(1 - rate) times as large; x itself without a key."""
    if key is None or rate == 0:
        return x
    kept = jax.random.bernoulli(key, 1 - rate, x.shape)
    return jnp.where(kept, x / (1 - rate), 0)


def blank(
    x: Float[Array, "batch frame joint 3"], observed: Bool[Array, "batch frame joint"]
) -> Float[Array, "batch frame joint 3"]:
    """Missing samples at 0, the mean pose of normalised motion, whatever is stored there."""
    return jnp.where(observed[..., None], x, 0)


def interpolate(
    x: Float[Array, "batch frame joint 3"], observed: Bool[Array, "batch frame joint"]
) -> Float[Array, "batch frame joint 3"]:
    """Missing samples on straight lines in time, the ends held; 0 for a joint never observed."""
    frames = x.shape[1]
    here = jnp.arange(frames)[None, :, None]
    last = jax.lax.cummax(jnp.where(observed, here, -1), axis=1)
    following = jax.lax.cummin(jnp.where(observed, here, frames), axis=1, reverse=True)
    before = jnp.where(last < 0, following, last)
    after = jnp.where(following == frames, last, following)
    way = jnp.clip((here - before) / jnp.maximum(after - before, 1), 0, 1).astype(x.dtype)[..., None]

    def at(index):
        return jnp.take_along_axis(blank(x, observed), jnp.clip(index, 0, frames - 1)[..., None], axis=1)

    return jnp.where(observed.any(1)[:, None, :, None], (1 - way) * at(before) + way * at(after), 0)


def flat(x: Float[Array, "batch frame joint 3"]) -> Float[Array, "batch frame channel"]:
    """Poses as rows."""
    return x.reshape(*x.shape[:2], -1)


def uniform(rng: np.random.Generator, shape: tuple[int, ...], bound: float) -> Array:
    """Drawn evenly within `bound`, by NumPy: JAX would compile a program for every shape, seconds in all."""
    return jnp.asarray(np.float32(bound) * (2 * rng.random(shape, np.float32) - 1))
