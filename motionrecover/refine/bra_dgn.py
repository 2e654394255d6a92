"""BRA-DGN: BRA with directed graph blocks in place of its linear layers (Choi et al., IJPEM-ST 2, 2024).

The skeleton is a directed graph. Nodes are the joints, and each joint has one edge, the bone that ends in it, out of
the joint nearer to the centre; the centre's edge is a loop of length 0. An edge's input is the joint minus that
neighbour, in the blanked input: bones at a missing joint are wrong, and there to be put right.

A block maps nodes v and edges e (joint, feature), through learnable incidence A_s and A_t (node, edge) of sources and
targets (Eqs. 4-5):

    v' = relu(norm(H_v [v, A_s e, A_t e])),     e' = relu(norm(H_e [e, A_s' v, A_t' v]))

Encoder blocks, an LSTM for nodes and one for edges each side of the hidden units, decoder blocks; the answer is half
the sum of both streams. The incidence starts as that of the skeleton plus 1e-6, divided by each node's degree.

In the code that the authors published, e' is made of A_s' e and A_t' e, so that edges never see nodes. The paper's
Eq. 5 is the default here; `edge_update="released"` is theirs.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from motionrecover.refine.layers import BatchNorm, BiLSTM, Linear, blank
from motionrecover.skeleton import Skeleton

WIDTHS = {2: (3, 18), 3: (6, 12, 18), 4: (6, 12, 21, 18), 5: (6, 12, 18, 18, 18)}
"""Features after each block of the encoder, by the number of blocks. Three are the published code's. The others are the
most even ones that give the published counts."""
CENTRE = "thorax"
"""Centre of the graph, if there is such a joint; else the first root."""


class Block(eqx.Module):
    """Directed graph block (Shi et al., CVPR 2019)."""

    sources: Float[Array, "node edge"]
    targets: Float[Array, "node edge"]
    node_update: Linear
    edge_update: Linear
    node_norm: BatchNorm
    edge_norm: BatchNorm
    activated: bool = eqx.field(static=True)
    released: bool = eqx.field(static=True)

    @staticmethod
    def make(
        incidence: tuple[np.ndarray, np.ndarray],
        inputs: int,
        outputs: int,
        rng: np.random.Generator,
        activated: bool = True,
        released: bool = False,
        scale: float = 1.0,
    ) -> Block:
        """`incidence`: A_s and A_t at the start. `released`: edges from edges."""
        sources, targets = (jnp.asarray(each.astype(np.float32)) for each in incidence)
        node, edge = (Linear.make(3 * inputs, outputs, rng) for _ in range(2))
        node_norm, edge_norm = (BatchNorm.make(outputs, scale=scale) for _ in range(2))
        return Block(sources, targets, node, edge, node_norm, edge_norm, activated, released)

    def __call__(
        self, v: Float[Array, "*batch joint input"], e: Float[Array, "*batch joint input"], training: bool
    ) -> tuple[Float[Array, "*batch joint output"], Float[Array, "*batch joint output"], Block]:
        """New nodes and edges, both from the old ones."""
        seen = e if self.released else v
        nodes = [v, *(jnp.einsum("ve,...ec->...vc", a, e) for a in (self.sources, self.targets))]
        edges = [e, *(jnp.einsum("ve,...vc->...ec", a, seen) for a in (self.sources, self.targets))]
        v, node_norm = self.node_norm(self.node_update(jnp.concatenate(nodes, -1)), training)
        e, edge_norm = self.edge_norm(self.edge_update(jnp.concatenate(edges, -1)), training)
        if self.activated:
            v, e = jax.nn.relu(v), jax.nn.relu(e)
        return v, e, replace(self, node_norm=node_norm, edge_norm=edge_norm)


class BRADGN(eqx.Module):
    """Motion (batch, frame, joint, 3), normalised, to clean motion of the same shape."""

    node_norm: BatchNorm
    edge_norm: BatchNorm
    encoder: list[Block]
    lstm1: BiLSTM
    lstm2: BiLSTM
    decoder: list[Block]
    inward: tuple[int, ...] = eqx.field(static=True)
    """Each joint's neighbour nearer to the centre; the centre's is itself."""

    @staticmethod
    def make(
        skeleton: Skeleton,
        rng: np.random.Generator,
        widths: tuple[int, ...] = WIDTHS[3],
        edge_update: str = "paper",
        spread: float = 0.2,
    ) -> BRADGN:
        """`edge_update`: "paper" or "released"; `spread` of the targets.

        Raises `ValueError` for a skeleton that is not one tree.
        """
        if edge_update not in ("paper", "released"):
            raise ValueError(f"received edge_update {edge_update!r}: give paper or released")
        inward = towards_centre(skeleton)
        graph, released = incidence(inward), edge_update == "released"
        sizes = (3, *widths)
        ends = list(pairwise(sizes))
        hidden = widths[-1] * len(inward)
        encoder = [Block.make(graph, *size, rng, released=released) for size in ends]
        decoder = [Block.make(graph, out, inner, rng, released=released) for inner, out in reversed(ends[1:])]
        last = Block.make(graph, sizes[1], 3, rng, activated=False, released=released, scale=spread)
        return BRADGN(
            BatchNorm.make(len(inward), 3),
            BatchNorm.make(len(inward), 3),
            encoder,
            BiLSTM.make(hidden, hidden // 2, rng, count=2),
            BiLSTM.make(hidden, hidden // 2, rng, count=2),
            [*decoder, last],
            inward,
        )

    def __call__(
        self,
        x: Float[Array, "batch frame joint 3"],
        observed: Bool[Array, "batch frame joint"],
        key: PRNGKeyArray | None = None,
    ) -> tuple[Float[Array, "batch frame joint 3"], BRADGN]:
        """The clean motion; the mask only says which samples are blanked."""
        training = key is not None
        v = blank(x, observed)
        e = v - v[:, :, jnp.array(self.inward)]
        v, node_norm = self.node_norm(v, training)
        e, edge_norm = self.edge_norm(e, training)
        v, e, encoder = _through(self.encoder, v, e, training)
        h = jnp.stack([v, e]).reshape(2, *v.shape[:2], -1)
        h = self.lstm2(self.lstm1(h))
        v, e = h.reshape(2, *v.shape)
        v, e, decoder = _through(self.decoder, v, e, training)
        new = replace(self, node_norm=node_norm, edge_norm=edge_norm, encoder=encoder, decoder=decoder)
        return (v + e) / 2, new


def towards_centre(skeleton: Skeleton) -> tuple[int, ...]:
    """Each joint's neighbour nearer to the centre; the centre's is itself. Raises `ValueError` where it is no tree."""
    if not skeleton.is_forest or len(skeleton.components) > 1:
        raise ValueError(
            f"received a skeleton of {len(skeleton.names)} joints and {len(skeleton.edges)} bones that is no tree: "
            "a directed graph block needs each joint tied to the centre in one way"
        )
    names = skeleton.names
    centre = names.index(CENTRE) if CENTRE in names else skeleton.parents.index(-1)
    ties: dict[int, set[int]] = {joint: set() for joint in range(len(names))}
    for i, j in skeleton.edges:
        ties[i].add(j)
        ties[j].add(i)
    inward, queue = {centre: centre}, [centre]
    for joint in queue:
        for other in sorted(ties[joint] - inward.keys()):
            inward[other] = joint
            queue.append(other)
    return tuple(inward[joint] for joint in range(len(names)))


def incidence(inward: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """A_s and A_t (node, edge) of the graph, by each node's degree; edge j ends in joint j."""
    joints = len(inward)
    sources, targets = np.zeros((joints, joints)), np.eye(joints)
    sources[list(inward), range(joints)] = 1
    degree = (sources + targets).sum(1, keepdims=True)
    return sources / degree + 1e-6, targets / degree + 1e-6


def _through(blocks: list[Block], v: Array, e: Array, training: bool) -> tuple[Array, Array, list[Block]]:
    new = []
    for block in blocks:
        v, e, block = block(v, e, training)
        new.append(block)
    return v, e, new
