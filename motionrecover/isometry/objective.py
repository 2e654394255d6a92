"""Residuals of the isometry term and the products with their Jacobian.

E_iso(N) = |F(N)|^2 over all bones h = (i, j) and frames t, with the residual

    F_ht(N) = |n_i - n_j|^2 - l_h^2                        (Yang et al. 2020, Eq. 5 and 16)

and its Jacobian row dF_ht = 2 (n_i - n_j)^T (dn_i - dn_j). Positions are (component, joint, frame); bone vectors
d = n_i - n_j are (component, bone, frame) and serve as the linearisation point: J depends on N through d alone.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Edges = tuple[tuple[int, int], ...]
"""Bones as pairs of joint indices; static, so that one compiled program knows its graph."""


def ends(edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """First and second joint of every bone."""
    i, j = np.asarray(edges, np.int32).reshape(-1, 2).T
    return i, j


def bone_vectors(n: Float[Array, "3 joint frame"], edges: Edges) -> Float[Array, "3 bone frame"]:
    """d = n_i - n_j for every bone (i, j)."""
    i, j = ends(edges)
    return n[:, i] - n[:, j]


def residual(d: Float[Array, "3 bone frame"], bone_lengths: Float[Array, " bone"]) -> Float[Array, "bone frame"]:
    """F = |d|^2 - l^2, Eq. 5."""
    return (d**2).sum(0) - bone_lengths[:, None] ** 2


def jacobian_product(
    d: Float[Array, "3 bone frame"], v: Float[Array, "3 joint frame"], edges: Edges
) -> Float[Array, "bone frame"]:
    """J v: gather both ends of every bone."""
    return 2 * (d * bone_vectors(v, edges)).sum(0)


def transpose_product(
    d: Float[Array, "3 bone frame"], r: Float[Array, "bone frame"], edges: Edges, joints: int
) -> Float[Array, "3 joint frame"]:
    """J^T r: scatter to both ends of every bone."""
    i, j = ends(edges)
    push = 2 * d * r
    return jnp.zeros((3, joints, d.shape[-1]), d.dtype).at[:, i].add(push).at[:, j].add(-push)
