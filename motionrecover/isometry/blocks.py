"""Symmetric 3 x 3 systems, one for every joint and frame, factored in closed form.

A block is stored as its six entries (xx, xy, xz, yy, yz, zz) along the first axis, so that each arithmetic operation
runs over joints and frames at once.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

Blocks = Float[Array, "6 joint frame"]
Vectors = Float[Array, "3 joint frame"]


def scaled_identity(scale: Float[Array, ""], shape: tuple[int, ...], dtype) -> Blocks:
    """scale I in every block."""
    diagonal = jnp.array([1, 0, 0, 1, 0, 1], dtype).reshape(6, *[1] * len(shape))
    return jnp.broadcast_to(scale * diagonal, (6, *shape))


def outer(d: Vectors) -> Blocks:
    """d d^T."""
    x, y, z = d
    return jnp.stack([x * x, x * y, x * z, y * y, y * z, z * z])


def solve(blocks: Blocks, *right: Vectors) -> list[Vectors]:
    """Solutions of M u = b for positive definite blocks M and several b, by LDL^T (Golub & Van Loan, Sec. 4.1).

    LDL^T keeps the accuracy of the well-conditioned directions when a stiff bone makes M nearly rank one; a
    cofactor inverse does not.
    """
    xx, xy, xz, yy, yz, zz = blocks
    a = xy / xx
    b = xz / xx
    dy = yy - a * xy
    e = yz - a * xz
    c = e / dy
    dz = zz - b * xz - c * e
    solutions = []
    for x, y, z in right:
        y = y - a * x
        z = (z - b * x - c * y) / dz
        y = y / dy - c * z
        x = x / xx - a * y - b * z
        solutions.append(jnp.stack([x, y, z]))
    return solutions
