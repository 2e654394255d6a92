"""Proximal operators: prox_f(x, t) = argmin_y f(y) + |y - x|^2 / (2 t), for the norms of the recovery problem.

Parikh & Boyd, "Proximal Algorithms", Foundations and Trends in Optimization 1(3), 2014.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def soft_threshold(x: Float[Array, "*shape"], threshold: Float[Array, "..."] | float) -> Float[Array, "*shape"]:
    """Prox of the l1 norm: sgn(x) max(|x| - threshold, 0), entry by entry.

    S_delta below Eq. 11 of Yang et al. 2020. `threshold` >= 0 broadcasts against `x`.
    """
    # x minus its projection onto [-threshold, threshold]: the same numbers, without a sign and a branch.
    return x - jnp.clip(x, -threshold, threshold)


def singular_value_threshold(
    x: Float[Array, "component joint frame"], threshold: Float[Array, ""] | float
) -> tuple[Float[Array, "component joint frame"], Float[Array, " joint"]]:
    """Prox of the nuclear norm of the motion matrix: U max(S - threshold, 0) V^T, and the singular values S.

    The 3T x S matrix X of a clip appears here as (component, joint, frame), its transpose with the rows regrouped.
    Singular vectors V and values come from the joint x joint Gram matrix X^T X = V S^2 V^T, so no 3T x S
    decomposition is made, and U max(S - threshold, 0) V^T = X - X V min(1, threshold / S) V^T. Cai, Candes & Shen,
    "A Singular Value Thresholding Algorithm", SIAM J. Optim. 20(4), 2010; Eq. 14 of Yang et al. 2020.

    Accuracy: squaring leaves singular values below sqrt(eps) |X|_2 uncertain. In float32 that is 3e-4 |X|_2, which on
    a CMU clip of 1918 frames is as large as the threshold and kept the dual residual above 5e-2; so where JAX allows
    float64, the Gram matrix alone is formed and decomposed in it (1e-8 |X|_2). Subtracting the clipped part bounds what
    remains: a direction whose value is misjudged moves by at most `threshold`. Values are in ascending order.
    """
    wide = x.astype(jax.dtypes.canonicalize_dtype(jnp.float64))
    gram = jnp.einsum("cit,cjt->ij", wide, wide, precision="highest")
    eigenvalues, vectors = jnp.linalg.eigh(gram)
    values, vectors = jnp.sqrt(jnp.maximum(eigenvalues, 0)).astype(x.dtype), vectors.astype(x.dtype)
    # A zero singular value has a zero direction in X: any finite factor will do.
    clipped = jnp.where(values > threshold, threshold / jnp.where(values > 0, values, 1), 1)
    removed = jnp.matmul(vectors * clipped, vectors.T, precision="highest")
    return x - jnp.einsum("ij,cjt->cit", removed, x, precision="highest"), values
