"""Proximal operators: prox_f(x, t) = argmin_y f(y) + |y - x|^2 / (2 t), for the norms of the recovery problem.

Parikh & Boyd, "Proximal Algorithms", Foundations and Trends in Optimization 1(3), 2014.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

GRAM_COLUMNS = 2048
"""A part of the Gram matrix: 25 joints of it in float64 are 400 kB. Takes 0.6 of the time of all columns at once."""


def soft_threshold(x: Float[Array, "*shape"], threshold: Float[Array, "..."] | float) -> Float[Array, "*shape"]:
    """Prox of the l1 norm: sgn(x) max(|x| - threshold, 0), entry by entry.

    S_delta below Eq. 11 of Yang et al. 2020. `threshold` >= 0 broadcasts against `x`.
    """
    return x - clip(x, threshold)


def clip(x: Float[Array, "*shape"], threshold: Float[Array, "..."] | float) -> Float[Array, "*shape"]:
    """Projection onto [-threshold, threshold]: what the soft threshold takes away (Moreau's decomposition)."""
    # Two choices, not a minimum and a maximum, which XLA does not vectorise on a CPU: a third of the time.
    return jnp.where(x > threshold, threshold, jnp.where(x < -threshold, -threshold, x))


def singular_value_threshold(
    x: Float[Array, "joint component frame"], threshold: Float[Array, ""] | float
) -> tuple[Float[Array, "joint component frame"], Float[Array, " joint"]]:
    """Prox of the nuclear norm of the motion matrix: U max(S - threshold, 0) V^T, and the singular values S.

    The 3T x S matrix X of a clip appears here as (joint, component, frame), its transpose with the rows regrouped.
    Singular vectors V and values come from the joint x joint Gram matrix X^T X = V S^2 V^T, so no 3T x S
    decomposition is made, and U max(S - threshold, 0) V^T = X V max(0, 1 - threshold / S) V^T. Cai, Candes & Shen,
    "A Singular Value Thresholding Algorithm", SIAM J. Optim. 20(4), 2010; Eq. 14 of Yang et al. 2020.

    Accuracy: squaring leaves singular values below sqrt(eps) |X|_2 uncertain. In float32 that is 3e-4 |X|_2, which on
    a CMU clip of 1918 frames is as large as the threshold and kept the dual residual above 5e-2; so where JAX allows
    float64, the Gram matrix alone is formed and decomposed in it (1e-8 |X|_2). A direction whose value is misjudged
    moves by at most `threshold`, since no factor exceeds 1. Values are in ascending order.
    """
    rows = x.reshape(len(x), -1)
    eigenvalues, vectors = jnp.linalg.eigh(_gram(rows))
    values = jnp.sqrt(jnp.maximum(eigenvalues, 0))
    # A zero singular value has a zero direction in X: any finite factor will do.
    kept = jnp.maximum(1 - threshold / jnp.where(values > 0, values, 1), 0)
    keep = jnp.matmul(vectors * kept, vectors.T, precision="highest").astype(x.dtype)
    return jnp.matmul(keep, rows, precision="highest").reshape(x.shape), values.astype(x.dtype)


def _gram(rows: Float[Array, "row column"]) -> Float[Array, "row row"]:
    """X X^T in the widest type that JAX allows, a few columns at a time: what is widened then stays in the cache."""
    wide = jax.dtypes.canonicalize_dtype(jnp.float64)

    def product(part):
        part = part.astype(wide)
        return jnp.matmul(part, part.T, precision="highest")

    parts, rest = divmod(rows.shape[1], GRAM_COLUMNS)
    total = product(rows[:, rows.shape[1] - rest :])
    if parts:
        total = lax.fori_loop(
            0,
            parts,
            lambda k, total: total + product(lax.dynamic_slice_in_dim(rows, k * GRAM_COLUMNS, GRAM_COLUMNS, 1)),
            total,
        )
    return total
