"""Residuals of the isometry term and the products with their Jacobian.

E_iso(N) = |F(N)|^2 over all bones h = (i, j) and frames t, with the residual

    F_ht(N) = |n_i - n_j|^2 - l_h^2                        (Yang et al. 2020, Eq. 5 and 16)

and its Jacobian row dF_ht = 2 (n_i - n_j)^T (dn_i - dn_j). Positions are (joint, component, frame), so that taking the
ends of bones moves whole rows; bone vectors d = n_i - n_j are (bone, component, frame) and serve as the linearisation
point: J depends on N through d alone.
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


def dot(u: Float[Array, "row 3 frame"], v: Float[Array, "row 3 frame"]) -> Float[Array, "row frame"]:
    """u^T v of every row and frame."""
    return u[:, 0] * v[:, 0] + u[:, 1] * v[:, 1] + u[:, 2] * v[:, 2]


def bone_vectors(n: Float[Array, "joint 3 frame"], edges: Edges) -> Float[Array, "bone 3 frame"]:
    """d = n_i - n_j for every bone (i, j)."""
    i, j = ends(edges)
    return n[i] - n[j]


def residual(d: Float[Array, "bone 3 frame"], bone_lengths: Float[Array, " bone"]) -> Float[Array, "bone frame"]:
    """F = |d|^2 - l^2, Eq. 5."""
    return dot(d, d) - bone_lengths[:, None] ** 2


def jacobian_product(
    d: Float[Array, "bone 3 frame"], v: Float[Array, "joint 3 frame"], edges: Edges
) -> Float[Array, "bone frame"]:
    """J v: gather both ends of every bone."""
    return 2 * dot(d, bone_vectors(v, edges))


def transpose_product(
    d: Float[Array, "bone 3 frame"], r: Float[Array, "bone frame"], edges: Edges, joints: int
) -> Float[Array, "joint 3 frame"]:
    """J^T r: every joint gathers from its bones, of which some have fewer than others."""
    bones_of: list[list[tuple[int, int]]] = [[] for _ in range(joints)]
    for bone, (i, j) in enumerate(edges):
        bones_of[i].append((bone, 2))
        bones_of[j].append((bone, -2))
    most = max(map(len, bones_of), default=0)
    filled = [row + [(0, 0)] * (most - len(row)) for row in bones_of]
    bone, sign = np.array(filled, np.int32).reshape(joints, most, 2).transpose(2, 1, 0)
    push = d * r[:, None]
    total = jnp.zeros((joints, *d.shape[1:]), d.dtype)
    for k in range(most):
        total += sign[k, :, None, None].astype(d.dtype) * push[bone[k]]
    return total
