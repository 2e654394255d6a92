"""Direct solution of the Gauss-Newton system of Eq. 20 on a tree or forest, by leaf-to-root elimination.

In every frame, (rho I + gamma J^T J) delta = b is a tree of 3 x 3 blocks: the bone h between a joint c and its parent
p adds kappa d d^T to the blocks of both and takes it from the block between them, with kappa = 4 gamma and d the bone
vector. Let M_c be c's block without its parent bone and with its children eliminated. By Sherman-Morrison, eliminating
c leaves

    w = kappa / (1 + kappa d^T M_c^-1 d),    M_p += w d d^T,    b_p += w d (d^T M_c^-1 b_c)

to its parent: again a rank-one block, so nothing fills in and a frame costs O(joints). From the root to the leaves,

    delta_c = M_c^-1 b_c - M_c^-1 d w (d^T M_c^-1 b_c - d^T delta_p).

All joints of one depth, in all frames, go in one step. Any joint of a component may be its root; its centre gives the
fewest depths. The solution is exact: no iteration, no tolerance. Compare Golub & Van Loan, Sec. 4.5 (block
tridiagonal systems); Featherstone, "Rigid Body Dynamics Algorithms", Ch. 6 (the same sparsity in joint space).
"""

from functools import cache

import numpy as np
from jaxtyping import Array, Float

from motionrecover.isometry import blocks
from motionrecover.isometry.objective import Edges
from motionrecover.skeleton import is_forest


@cache
def schedule(edges: Edges, joints: int) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]:
    """(joints, their parents, their bones) at each depth, deepest first.

    Raises `ValueError` for a graph with a cycle, which has no leaf to start from.
    """
    neighbours: list[list[tuple[int, int]]] = [[] for _ in range(joints)]
    for bone, (i, j) in enumerate(edges):
        neighbours[i].append((j, bone))
        neighbours[j].append((i, bone))

    def breadth_first(root):
        order = {root: (-1, -1, 0)}
        queue = [root]
        for joint in queue:
            for other, bone in neighbours[joint]:
                if other not in order:
                    order[other] = (joint, bone, order[joint][2] + 1)
                    queue.append(other)
        return order, queue

    depths: dict[int, list[tuple[int, int, int]]] = {}
    reached: set[int] = set()
    for joint in range(joints):
        if joint in reached:
            continue
        # The centre of a tree is the middle of a longest path; its ends are farthest from any joint and each other.
        end = breadth_first(joint)[1][-1]
        path, queue = breadth_first(end)
        centre = queue[-1]
        for _ in range(path[centre][2] // 2):
            centre = path[centre][0]
        order, queue = breadth_first(centre)
        reached.update(queue)
        for other in queue[1:]:
            parent, bone, depth = order[other]
            depths.setdefault(depth, []).append((other, parent, bone))
    if not is_forest(edges, joints):
        raise ValueError(
            f"received a graph of {joints} joints and {len(edges)} bones that closes a cycle: "
            "leaf-to-root elimination needs a tree or forest, use isometry.pcg"
        )
    return tuple(tuple(np.array(depths[depth], np.int32).T) for depth in sorted(depths, reverse=True))


def solve(
    d: Float[Array, "3 bone frame"],
    b: Float[Array, "3 joint frame"],
    isometry_weight: Float[Array, ""],
    penalty: Float[Array, ""],
    edges: Edges,
) -> Float[Array, "3 joint frame"]:
    """delta = (rho I + gamma J^T J)^-1 b for bone vectors `d`.

    `isometry_weight` is gamma >= 0 and `penalty` is rho > 0.

    Raises `ValueError` for a graph with a cycle.
    """
    kappa = 4 * isometry_weight
    _, joints, frames = b.shape
    steps = schedule(edges, joints)
    m = blocks.scaled_identity(penalty, (joints, frames), b.dtype)
    eliminated = []
    for child, parent, bone in steps:
        direction = d[:, bone]
        u, v = blocks.solve(m[:, child], direction, b[:, child])
        w = kappa / (1 + kappa * (direction * u).sum(0))
        s = (direction * v).sum(0)
        m = m.at[:, parent].add(w * blocks.outer(direction))
        b = b.at[:, parent].add(w * s * direction)
        eliminated.append((u, v, w, s, direction))
    # Only the roots are left: M delta = b is right for them, and overwritten for every other joint.
    (delta,) = blocks.solve(m, b)
    for (child, parent, _), (u, v, w, s, direction) in zip(reversed(steps), reversed(eliminated), strict=True):
        delta = delta.at[:, child].set(v - u * w * (s - (direction * delta[:, parent]).sum(0)))
    return delta
