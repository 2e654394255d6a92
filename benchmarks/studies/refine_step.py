"""What one training step of BRA-DGN takes: all LSTMs in one scan, against a scan for each with the projection inside.

    python -m benchmarks.studies.refine_step [--batch 16] [--frames 64] [--steps 7]

Both versions are compiled in one process and take turns, so that the load of the machine hits both alike; the least
time of each counts. Same weights, same numbers out.
"""

import argparse
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from motionrecover.refine import models, step
from motionrecover.refine.layers import BiLSTM
from motionrecover.skeleton import Skeleton


class ScanEach(BiLSTM):
    """Eight scans for the four BiLSTMs of BRA-DGN, which project a frame at a time."""

    def __call__(self, x):
        """As `BiLSTM`."""
        return jnp.stack([jnp.concatenate([self._one(x[k], k, d) for d in range(2)], -1) for k in range(len(x))])

    def _one(self, x, k, direction):
        w, u = self.input_weight[k, direction], self.hidden_weight[k, direction]
        b = self.input_bias[k, direction] + self.hidden_bias[k, direction]

        def step(state, now):
            h, c = state
            i, f, g, o = jnp.split(now @ w + h @ u + b, 4, -1)
            c = jax.nn.sigmoid(f) * c + jax.nn.sigmoid(i) * jnp.tanh(g)
            h = jax.nn.sigmoid(o) * jnp.tanh(c)
            return (h, c), h

        start = jnp.zeros((len(x), u.shape[0]), x.dtype)
        return jax.lax.scan(step, (start, start), x.swapaxes(0, 1), reverse=bool(direction))[1].swapaxes(0, 1)


def main() -> None:
    """Print both times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--frames", type=int, default=64)
    parser.add_argument("--steps", type=int, default=7)
    asked = parser.parse_args()
    skeleton = Skeleton.standard("cmu21")

    def network(layer):
        made = models.find("bra-dgn").make(skeleton, np.random.default_rng(0), False)
        replaced = [layer(**vars(lstm)) for lstm in (made.lstm1, made.lstm2)]
        return eqx.tree_at(lambda n: (n.lstm1, n.lstm2), made, replaced)

    terms = ("loss", "position", "distance", "bone", "smooth", "perceptual")
    zeros = dict.fromkeys(terms, jnp.float32(0))
    clean = np.random.default_rng(1).normal(scale=0.2, size=(asked.batch, asked.frames, 21, 3))
    given = step.Given(
        step.Task("bra-dgn", "choi-missing40", skeleton, "all"),
        jnp.zeros((21, 3), jnp.float32),
        jnp.ones(3, jnp.float32),
        clean=jnp.asarray(clean.astype(np.float32)),
        key=jax.random.key(0),
        rate=jnp.float32(1e-3),
        graph=jnp.float32(1),
        weights=zeros | {"position": jnp.float32(1)},
        so_far=zeros,
    )
    names = {BiLSTM: "one scan, projection outside", ScanEach: "a scan each, projection inside"}
    states, times, losses = {}, {layer: [] for layer in names}, {}
    for layer in names:
        made = network(layer)
        states[layer] = step.step(given, made, step.fresh_moments(made, "all"))
        losses[layer] = float(states[layer][2]["loss"])
    for _ in range(asked.steps):
        for layer in names:
            made, moments, _ = states[layer]
            began = time.perf_counter()
            states[layer] = jax.block_until_ready(step.step(given, made, moments))
            times[layer].append(time.perf_counter() - began)
    one, each = (min(times[layer]) for layer in names)
    for layer, name in names.items():
        print(f"{name:34} {1000 * min(times[layer]):7.0f} ms   first loss {losses[layer]:.6f}")
    print(f"ratio {one / each:.2f}")


if __name__ == "__main__":
    main()
