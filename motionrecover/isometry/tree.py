"""Direct solution of the Gauss-Newton step of Eq. 20 on a tree or forest, by leaf-to-root elimination of bones.

In every frame the step minimises gamma/2 |F + J delta|^2 + rho/2 |delta - s|^2. With one force y a bone,

    (rho I + gamma J J^T) y = gamma (F + J s),    delta = s - J^T y                      (push-through identity)

which is Eq. 20 with unknowns on bones instead of joints: a scalar for each, not a vector. Two bones are coupled where
they share a joint, by 4 gamma d_k . d_l with the sign of their orientations. Of a tree, eliminating the bone farthest
from the root couples none that were not coupled before, so L D L^T of the matrix is as sparse as the matrix: a frame
costs O(bones) (times the square of the bones at a joint). The solution is exact: no iteration, no tolerance.

It is also the accurate form in float32: a stiff bone makes the matrix of Eq. 20 ill-conditioned, by 4 gamma |d|^2 / rho
or 1e4, but not this one, whose diagonal grows with it.

All frames go in one step, as rows. The matrix and the right-hand side are rows as well, and elimination and back
substitution the same update of one row by three others: a loop over a table, so the program is small whatever the tree.
Compare Golub & Van Loan, Sec. 4.3 (tridiagonal systems: a chain of bones); Rose, "Triangulated graphs and the
elimination process", 1970 (no fill-in); Baraff, "Linear-time dynamics using Lagrange multipliers", SIGGRAPH 1996
(forces along a tree).
"""

from functools import cache

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from motionrecover import kernel
from motionrecover.isometry.objective import Edges, dot, jacobian_product, transpose_product
from motionrecover.skeleton import is_forest

MOST_BONES = 8
"""At one joint. All pairs of its bones are coupled, and the updates grow with the cube of their number."""


def suits(edges: Edges, joints: int) -> bool:
    """Whether the graph is a forest without a joint of more than `MOST_BONES` bones."""
    return is_forest(edges, joints) and np.bincount(np.ravel(edges), minlength=1).max() <= MOST_BONES


@cache
def elimination(edges: Edges, joints: int) -> tuple[list[tuple[int, int, int]], np.ndarray]:
    """The pairs of bones that share a joint, (bone, bone, sign of their coupling), and the updates that solve.

    Rows are numbered: the diagonal of the matrix, the right-hand side, the pairs. An update is four of them, and means

        target <- target - factor * factor / divisor

    Any joint of a component may be its root. Raises `ValueError` for a graph with a cycle, which has no leaf to start
    from.
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
    order, bones = outward[::-1], len(edges)
    later: dict[int, list[int]] = {k: [] for k in order}
    row = {(k, k): k for k in order} | {(k, bones): bones + k for k in order}
    pairs = []
    for place, k in enumerate(order):
        for l in order[place + 1 :]:
            for joint in set(edges[k]) & set(edges[l]):
                row[k, l] = row[l, k] = 2 * bones + len(pairs)
                pairs.append((k, l, 1 if (edges[k][0] == joint) == (edges[l][0] == joint) else -1))
                later[k].append(l)
    updates = []
    for k in order:
        for place, i in enumerate(later[k]):
            updates += [(row[i, j], row[k, i], row[k, j], row[k, k]) for j in [*later[k][place:], bones]]
    for k in reversed(order):
        updates += [(row[k, bones], row[k, i], row[i, bones], row[i, i]) for i in later[k]]
    return pairs, np.array(updates, np.int32).reshape(-1, 4)


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
    joints, bones = len(s), len(edges)
    pairs, updates = elimination(edges, joints)
    k, l, sign = np.array(pairs, np.int32).reshape(-1, 3).T
    kappa = 4 * isometry_weight
    diagonal = 2 * kappa * dot(d, d) + penalty
    right = isometry_weight * (f + jacobian_product(d, s, edges))
    coupling = kappa * jnp.asarray(sign, d.dtype)[:, None] * dot(d[k], d[l])

    def update(rows, places):
        target, x, y, divisor = (lax.dynamic_index_in_dim(rows, place, keepdims=False) for place in places)
        return lax.dynamic_update_index_in_dim(rows, target - x * y / divisor, places[0], 0), None

    rows = jnp.concatenate([diagonal, right, coupling])
    # Outside a kernel, a turn of a loop costs more than what is done in it.
    turns = 1 if kernel.available() else max(1, len(updates))
    rows, _ = lax.scan(update, rows, jnp.asarray(updates), unroll=turns)
    return transpose_product(d, rows[bones : 2 * bones] / rows[:bones], edges, joints)
