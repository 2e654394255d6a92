"""What comes back: a verdict, the answer, and the trace of how it was reached."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

Verdict = Int[Array, ""]
"""A `Result` in compiled code: its number."""


class Result(IntEnum):
    """Verdict on one clip."""

    message: str
    """One sentence for people."""

    def __new__(cls, message: str) -> Self:
        """The members are numbered in order."""
        member = int.__new__(cls, len(cls.__members__))
        member._value_ = int(member)
        member.message = message
        return member

    running = "The iteration has not ended."
    converged = "Converged: what a step still changes is below the tolerance."
    max_steps = (
        "Stopped at the maximum number of steps before the residuals were below the tolerance: "
        "the answer is usable, raise max_steps to refine it."
    )
    non_finite_input = "The input holds NaN or infinite numbers where it is marked as observed: mark them as missing."
    non_finite = "The iteration left the finite numbers: lower the penalty or its growth, or use float64."
    partly_unknown = "Recovered in part: too few intact joints for long, or gaps longer than max_gap, stay NaN."
    nothing_observed = "No sample is observed: there is nothing to recover from."

    @staticmethod
    def where(condition: Array, true: Verdict | int, false: Verdict | int) -> Verdict:
        """One verdict or the other."""
        return jnp.where(condition, jnp.asarray(true, jnp.int32), jnp.asarray(false, jnp.int32))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Trace:
    """One row a step; rows from `Solution.steps` on are NaN."""

    primal_residual: Float[Array, " step"]
    """|(E - D + A, N - A, C - W A)| / |D|."""
    dual_residual: Float[Array, " step"]
    """Distance from stationarity / |lambda w|: see `Solver.step`."""
    nuclear: Float[Array, " step"]
    """|A|_*."""
    outlier: Float[Array, " step"]
    """lambda |weights * E|_1."""
    isometry: Float[Array, " step"]
    """gamma / 2 E_iso(N)."""
    smoothness: Float[Array, " step"]
    """mu |C|_1."""
    guide: Float[Array, " step"]
    """beta / 2 |B (A - F)|^2."""
    rank: Float[Array, " step"]
    """Singular values of A above zero."""
    penalty: Float[Array, " step"]
    """rho_1."""
    inner_steps: Float[Array, " step"]
    """Conjugate gradient steps of the N-subproblem; 0 where elimination solved it."""

    shown: ClassVar[tuple[str, ...]] = ("objective", "primal_residual", "dual_residual", "rank", "penalty")

    @property
    def objective(self) -> Float[Array, " step"]:
        """Value of Eq. 8 at the split variables: the energy of the papers' convergence figures."""
        return self.nuclear + self.outlier + self.isometry + self.smoothness + self.guide


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Solution:
    """Answer, verdict and trace of one clip."""

    positions: Float[Array, "3 joint frame"]
    """A."""
    outliers: Float[Array, "3 joint frame"]
    """E."""
    result: Verdict
    steps: Int[Array, ""]
    trace: Any
    """`Trace` of the published models, `SmootherInfo` of the robust one; one row a step."""
    state: Any
    """The solver's last state."""
