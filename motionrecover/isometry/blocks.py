"""Symmetric 3 x 3 systems, one for every joint and frame, factored in closed form.

A block is stored as its six entries (xx, xy, xz, yy, yz, zz) along the first axis, so that each arithmetic operation
runs over joints and frames at once.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

Blocks = Float[Array, "6 joint frame"]
Vectors = Float[Array, "joint 3 frame"]


def scaled_identity(scale: Float[Array, ""], shape: tuple[int, ...], dtype) -> Blocks:
    """scale I in every block."""
    diagonal = jnp.array([1, 0, 0, 1, 0, 1], dtype).reshape(6, *[1] * len(shape))
    return jnp.broadcast_to(scale * diagonal, (6, *shape))


def outer(d: Vectors) -> Blocks:
    """d d^T."""
    x, y, z = d[:, 0], d[:, 1], d[:, 2]
    return jnp.stack([x * x, x * y, x * z, y * y, y * z, z * z])


def factor(blocks: Blocks) -> Blocks:
    """The factors of positive definite blocks M = L D L^T (Golub & Van Loan, Sec. 4.1), D inverted.

    L D L^T keeps the accuracy of the well-conditioned directions when a stiff bone makes M nearly rank one; a
    cofactor inverse does not.
    """
    xx, xy, xz, yy, yz, zz = blocks
    a, b = xy / xx, xz / xx
    dy = yy - a * xy
    e = yz - a * xz
    c = e / dy
    return jnp.stack([1 / xx, a, b, 1 / dy, c, 1 / (zz - b * xz - c * e)])


def solve(factors: Blocks, right: Vectors) -> Vectors:
    """The solution of M u = b for `factors` of M: no division is left."""
    xx, a, b, yy, c, zz = factors
    x, y, z = right[:, 0], right[:, 1], right[:, 2]
    y = y - a * x
    z = zz * (z - b * x - c * y)
    y = yy * y - c * z
    return jnp.stack([xx * x - a * y - b * z, y, z], 1)
