"""Networks that start as the identity: what was observed comes out as it is, what was missing at the mean pose.

BRA and BRA-DGN know nothing of the mask, and drawn at random they know no joint either: they spend most of their
training on handing through what they were told, and on people never seen stay centimetres off there. From the identity
they start with the errors of the mean pose, and spend it on what is missing.

A channel a coordinate is laid through the network, of numbers that the network has: in an LSTM the input and output
gates of a unit stand open and its forget gate shut, so that h = tanh(tanh(x)) nearly, x being small; where a rectifier
is in the way, x goes as max(x, 0) beside max(-x, 0). What flows into a channel from elsewhere, and from elsewhere into
the output, starts at 0; everything else stays as it was drawn. Running statistics are still those of the start, mean 0
and variance 1, and batch normalisation that uses them is an affine layer.
"""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from motionrecover.refine.bra import BRA
from motionrecover.refine.bra_dgn import BRADGN, Block
from motionrecover.refine.layers import BiLSTM, Linear

GATE = 3.0
"""Bias of a gate that stands open, and twice of one that is shut: 0.95 and 0.002, where they still learn."""
INWARD = 4.0
"""On the way in: normalised motion, of 0.15 to 0.2, comes to what the units that were drawn at random are made for."""
SMALL = 0.1
"""Before the first tanh: its third power then bends motion by a thousandth."""
_OPEN = 1 / (1 + np.exp(-GATE))
OUTWARD = 1 / (INWARD * SMALL * _OPEN**4)


def as_identity(network: eqx.Module) -> eqx.Module:
    """The network with the identity laid through it. Raises `ValueError` for one that has no such form."""
    if isinstance(network, BRA):
        return _bra(network)
    if isinstance(network, BRADGN):
        return _bra_dgn(network)
    raise ValueError(f"received a network of type {type(network).__name__}: only BRA and BRA-DGN start as the identity")


def _bra(network: BRA) -> BRA:
    channels = np.arange(network.encoder[0].weight.shape[0])
    eye = np.eye(len(channels), dtype=np.float32)
    encoder = [_fed(layer, channels, eye if k else INWARD * eye) for k, layer in enumerate(network.encoder)]
    decoder = [_fed(layer, channels, eye) for layer in network.decoder]
    norms = network.decoder_norms[-1]
    norms = replace(norms, weight=jnp.full_like(norms.weight, OUTWARD))
    return replace(
        network,
        encoder=encoder,
        lstm1=_handed_through(network.lstm1, channels, SMALL * eye),
        lstm2=_handed_through(network.lstm2, channels, eye),
        decoder=decoder,
        decoder_norms=[*network.decoder_norms[:-1], norms],
    )


def _fed(layer: Linear, channels: np.ndarray, weights: np.ndarray) -> Linear:
    """The layer with its outputs `channels` made of its first inputs by `weights` (input, channel) alone."""
    weight, bias = np.array(layer.weight), np.array(layer.bias)
    weight[:, channels], bias[channels] = 0, 0
    weight[: len(weights), channels] = weights
    return Linear(jnp.asarray(weight), jnp.asarray(bias))


def _handed_through(lstm: BiLSTM, outputs: np.ndarray, weights: np.ndarray) -> BiLSTM:
    """The first of the LSTMs with its `outputs` made of its first inputs by `weights` (input, output)."""
    hidden = lstm.hidden_weight.shape[2]
    arrays = [np.array(a) for a in (lstm.input_weight, lstm.hidden_weight, lstm.input_bias, lstm.hidden_bias)]
    direction, unit = np.divmod(outputs, hidden)
    for gate, bias in enumerate((GATE, -2 * GATE, 0, GATE)):  # i, f, g, o
        at = gate * hidden + unit
        for array in arrays:
            array[0, direction, ..., at] = 0
        arrays[2][0, direction, at] = bias
        if gate == 2:
            arrays[0][0, direction, : len(weights), at] = weights.T
    return BiLSTM(*map(jnp.asarray, arrays))


def _bra_dgn(network: BRADGN) -> BRADGN:
    joints, width = len(network.inward), network.encoder[-1].node_update.weight.shape[1]
    if network.encoder[0].node_update.weight.shape[1] < 6:
        raise ValueError("received two graph blocks: to start as the identity, BRA-DGN needs three or more")
    parted = np.concatenate([np.eye(3), -np.eye(3)], 1)
    eye = np.eye(6)
    encoder = [_nodes(block, eye if k else INWARD * parted) for k, block in enumerate(network.encoder)]
    outputs = (width * np.arange(joints)[:, None] + np.arange(3)).ravel()
    joined, single = np.zeros((joints * width, 3 * joints)), np.zeros((joints * width, 3 * joints))
    for c, output in enumerate(outputs):
        joined[[output, output + 3], c] = SMALL, -SMALL
        single[output, c] = 1
    first, *between, last = network.decoder
    # The answer is half the sum of both streams, and that of the edges starts at 0.
    last = _nodes(last, 2 * OUTWARD * parted.T)
    last = replace(
        last,
        node_norm=replace(last.node_norm, weight=jnp.ones_like(last.node_norm.weight)),
        edge_update=_fed(last.edge_update, np.arange(3), np.zeros((0, 3))),
    )
    return replace(
        network,
        encoder=encoder,
        lstm1=_handed_through(network.lstm1, outputs, joined),
        lstm2=_handed_through(network.lstm2, outputs, single),
        decoder=[_nodes(first, parted), *(_nodes(block, eye) for block in between), last],
    )


def _nodes(block: Block, weights: np.ndarray) -> Block:
    """The block with the first features of its nodes made of a node's own by `weights`."""
    return replace(block, node_update=_fed(block.node_update, np.arange(weights.shape[1]), weights))
