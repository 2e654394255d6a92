"""Iterative solution of the Gauss-Newton system of Eq. 20 on any graph, by preconditioned conjugate gradients.

(rho I + gamma J^T J) delta = b is block diagonal over frames, because bones tie joints of one frame only. Each frame
runs its own recurrence, with its own step lengths; all frames run at once until the last one is done. The
preconditioner inverts each joint's 3 x 3 diagonal block rho I + 4 gamma sum_h d_h d_h^T over its bones h.
Shewchuk, "An Introduction to the Conjugate Gradient Method Without the Agonizing Pain", 1994, Sec. B3; Yang et al.
2020 name PCG below Eq. 19.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from motionrecover.isometry import blocks
from motionrecover.isometry.objective import Edges, ends, jacobian_product, transpose_product


def solve(
    d: Float[Array, "3 bone frame"],
    b: Float[Array, "3 joint frame"],
    isometry_weight: Float[Array, ""],
    penalty: Float[Array, ""],
    edges: Edges,
    tolerance: float,
    max_steps: int,
) -> tuple[Float[Array, "3 joint frame"], Int[Array, ""]]:
    """delta = (rho I + gamma J^T J)^-1 b, and the steps taken.

    `isometry_weight` is gamma >= 0 and `penalty` is rho > 0.

    Stops when every frame's residual norm is below `tolerance` times the norm of its b, or after `max_steps`;
    3 x joints steps are exact but for rounding.
    """
    _, joints, frames = b.shape
    i, j = ends(edges)
    stiff = 4 * isometry_weight * blocks.outer(d)
    diagonal = blocks.scaled_identity(penalty, (joints, frames), b.dtype).at[:, i].add(stiff).at[:, j].add(stiff)

    def apply(x):
        return penalty * x + isometry_weight * transpose_product(d, jacobian_product(d, x, edges), edges, joints)

    def dot(x, y):
        return (x * y).sum((0, 1))

    target = tolerance**2 * dot(b, b)

    def more(state):
        _, r, _, _, step = state
        return (dot(r, r) > target).any() & (step < max_steps)

    def advance(state):
        x, r, p, rz, step = state
        active = dot(r, r) > target  # a frame that is done keeps its answer: its step length would be 0 / 0
        ap = apply(p)
        alpha = jnp.where(active, rz / jnp.where(active, dot(p, ap), 1), 0)
        x, r = x + alpha * p, r - alpha * ap
        (z,) = blocks.solve(diagonal, r)
        rz_next = dot(r, z)
        beta = jnp.where(active, rz_next / jnp.where(active, rz, 1), 0)
        return x, r, z + beta * p, rz_next, step + 1

    (z,) = blocks.solve(diagonal, b)
    x, _, _, _, steps = lax.while_loop(more, advance, (jnp.zeros_like(b), b, z, dot(b, z), jnp.array(0)))
    return x, steps
