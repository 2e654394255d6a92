"""Direct solution of the Gauss-Newton step of Eq. 20 on a tree or forest, by leaf-to-root elimination of bones.

In every frame the step minimises gamma/2 |F + J delta|^2 + rho/2 |delta - s|^2. With one force y a bone,

    (rho I + gamma J J^T) y = gamma (F + J s),    delta = s - J^T y                      (push-through identity)

which is Eq. 20 with unknowns on bones instead of joints: a scalar for each, not a vector. Two bones are coupled where
they share a joint, by 4 gamma d_k . d_l with the sign of their orientations. Of a tree, eliminating the bone farthest
from the root couples none that were not coupled before, so L D L^T of the matrix is as sparse as the matrix: a frame
costs O(bones) (times the square of the bones at a joint). The solution is exact: no iteration, no tolerance.

It is also the accurate form in float32: a stiff bone makes the matrix of Eq. 20 ill-conditioned, by 4 gamma |d|^2 / rho
or 1e4, but not this one, whose diagonal grows with it.

All frames go in one step, as rows. Compare Golub & Van Loan, Sec. 4.3 (tridiagonal systems: a chain of bones); Rose,
"Triangulated graphs and the elimination process", 1970 (no fill-in); Baraff, "Linear-time dynamics using Lagrange
multipliers", SIGGRAPH 1996 (forces along a tree).
"""

from functools import cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from motionrecover.isometry.objective import Edges, dot, jacobian_product, transpose_product
from motionrecover.skeleton import is_forest

MOST_BONES = 8
"""At one joint. All pairs of its bones are coupled, and the program grows with the cube of their number."""


def suits(edges: Edges, joints: int) -> bool:
    """Whether the graph is a forest without a joint of more than `MOST_BONES` bones."""
    return is_forest(edges, joints) and np.bincount(np.ravel(edges), minlength=1).max() <= MOST_BONES


@cache
def elimination(edges: Edges, joints: int) -> tuple[list[int], list[tuple[int, int, int]]]:
    """The bones from the leaves to the root, and the pairs that share a joint.

    A pair is (earlier bone, later bone, sign of their coupling). Any joint of a component may be its root. Raises
    `ValueError` for a graph with a cycle, which has no leaf to start from.
    """
    if not is_forest(edges, joints):
        raise ValueError(
            f"received a graph of {joints} joints and {len(edges)} bones that closes a cycle: "
            "leaf-to-root elimination needs a tree or forest, use isometry.pcg"
        )
    neighbours: list[list[tuple[int, int]]] = [[] for _ in range(joints)]
    for bone, (i, j) in enumerate(edges):
        neighbours[i].append((j, bone))
        neighbours[j].append((i, bone))
    outward: list[int] = []
    reached: set[int] = set()
    for root in range(joints):
        queue = [] if root in reached else [root]
        reached.add(root)
        for joint in queue:
            for other, bone in neighbours[joint]:
                if other not in reached:
                    reached.add(other)
                    queue.append(other)
                    outward.append(bone)
    order = outward[::-1]
    pairs = []
    for place, k in enumerate(order):
        for l in order[place + 1 :]:
            for joint in set(edges[k]) & set(edges[l]):
                pairs.append((k, l, 1 if (edges[k][0] == joint) == (edges[l][0] == joint) else -1))
    return order, pairs


def solve(
    d: Float[Array, "bone 3 frame"],
    f: Float[Array, "bone frame"],
    s: Float[Array, "joint 3 frame"],
    isometry_weight: Float[Array, ""],
    penalty: Float[Array, ""],
    edges: Edges,
) -> Float[Array, "joint 3 frame"]:
    """J^T y = s - delta, with delta = argmin gamma/2 |f + J delta|^2 + rho/2 |delta - s|^2 for bone vectors `d`.

    `isometry_weight` is gamma >= 0 and `penalty` is rho > 0.

    Raises `ValueError` for a graph with a cycle.
    """
    joints, _, frames = s.shape
    order, pairs = elimination(edges, joints)
    kappa = 4 * isometry_weight
    diagonal = 2 * kappa * dot(d, d) + penalty
    right = isometry_weight * (f + jacobian_product(d, s, edges))
    k, l, sign = np.array(pairs, np.int32).reshape(-1, 3).T
    coupling = kappa * jnp.asarray(sign, d.dtype)[:, None] * dot(d[k], d[l])

    m = {(bone, bone): diagonal[bone] for bone in order}
    m |= {(k, l): coupling[place] for place, (k, l, _) in enumerate(pairs)}
    later = {bone: [l for k, l, _ in pairs if k == bone] for bone in order}
    t = {bone: right[bone] for bone in order}
    z, y = {}, {}
    # Divisions where products with one inverse would do: XLA computes a quotient once and a product for each reader.
    for k in order:
        z[k], inverse = t[k] / m[k, k], 1 / m[k, k]
        for place, i in enumerate(later[k]):
            t[i] = t[i] - m[k, i] * z[k]
            for j in later[k][place:]:
                m[i, j] = m[i, j] - m[k, i] * inverse * m[k, j]
    for k in reversed(order):
        y[k] = (t[k] - sum(m[k, i] * y[i] for i in later[k])) / m[k, k]
    force = jnp.stack([y[bone] for bone in range(len(edges))]) if edges else jnp.zeros((0, frames), s.dtype)
    return transpose_product(d, force, edges, joints)
