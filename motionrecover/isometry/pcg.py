"""Iterative solution of the Gauss-Newton step of Eq. 20 on any graph, by preconditioned conjugate gradients.

(rho I + gamma J^T J) delta = rho s - gamma J^T F is block diagonal over frames, because bones tie joints of one frame
only. Each frame runs its own recurrence, with its own step lengths; all frames run at once until the last one is done.
The preconditioner inverts each joint's 3 x 3 diagonal block rho I + 4 gamma sum_h d_h d_h^T over its bones h, factored
once. The start, delta = 0, is a warm one: the N of the last step of the outer iteration, from which each goes less far.
Shewchuk, "An Introduction to the Conjugate Gradient Method Without the Agonizing Pain", 1994, Sec. B3; Yang et al.
2020 name PCG below Eq. 19.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from motionrecover.isometry import blocks
from motionrecover.isometry.objective import Edges, dot, ends, jacobian_product, transpose_product


def solve(
    d: Float[Array, "bone 3 frame"],
    f: Float[Array, "bone frame"],
    s: Float[Array, "joint 3 frame"],
    isometry_weight: Float[Array, ""],
    penalty: Float[Array, ""],
    edges: Edges,
    tolerance: float,
    max_steps: int,
) -> tuple[Float[Array, "joint 3 frame"], Int[Array, ""]]:
    """delta = argmin gamma/2 |f + J delta|^2 + rho/2 |delta - s|^2 for bone vectors `d`, and the steps taken.

    `isometry_weight` is gamma >= 0 and `penalty` is rho > 0.

    Stops when every frame's residual norm is below `tolerance` times the norm of the right-hand side, or after
    `max_steps`; 3 x joints steps are exact but for rounding.
    """
    joints, _, frames = s.shape
    i, j = ends(edges)
    stiff = 4 * isometry_weight * blocks.outer(d)
    diagonal = blocks.scaled_identity(penalty, (joints, frames), s.dtype).at[:, i].add(stiff).at[:, j].add(stiff)
    factors = blocks.factor(diagonal)
    b = penalty * s - isometry_weight * transpose_product(d, f, edges, joints)

    def apply(x):
        return penalty * x + isometry_weight * transpose_product(d, jacobian_product(d, x, edges), edges, joints)

    def product(x, y):
        return dot(x, y).sum(0)

    target = tolerance**2 * product(b, b)

    def more(state):
        *_, rr, step = state
        return (rr > target).any() & (step < max_steps)

    def advance(state):
        x, r, p, rz, rr, step = state
        active = rr > target  # a frame that is done keeps its answer: its step length would be 0 / 0
        ap = apply(p)
        alpha = jnp.where(active, rz / jnp.where(active, product(p, ap), 1), 0)
        x, r = x + alpha * p, r - alpha * ap
        z = blocks.solve(factors, r)
        rz_next = product(r, z)
        beta = jnp.where(active, rz_next / jnp.where(active, rz, 1), 0)
        return x, r, z + beta * p, rz_next, product(r, r), step + 1

    z = blocks.solve(factors, b)
    start = jnp.zeros_like(b), b, z, product(b, z), product(b, b), jnp.array(0)
    x, *_, steps = lax.while_loop(more, advance, start)
    return x, steps
