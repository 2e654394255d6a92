"""What is to be recovered: data, trust, bones."""

from dataclasses import dataclass, field

import jax
from jaxtyping import Array, Float, Int

from motionrecover.isometry.objective import Edges


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Guide:
    """Where somebody else, a learned refiner say, believes the joints to be."""

    positions: Float[Array, "3 joint frame"]
    """F."""
    weights: Float[Array, "joint frame"]
    """B in [0, 1]: trust in each of its samples; 0 where it says nothing, and in the padding."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Problem:
    """One clip, as the solver sees it: arrays of fixed shape, no names, no units, no NaN.

    Positions are (component, joint, frame): the papers' 3T x S motion matrix with frames last, so that filters and
    products along time run through contiguous memory. Frames from `frames` on are padding; they must be zero and stay
    zero.
    """

    positions: Float[Array, "3 joint frame"]
    """D. Where `weights` is zero the value counts for nothing but as the start of the iteration."""
    weights: Float[Array, "joint frame"]
    """Trust in [0, 1] in each sample; it multiplies the outlier weight. 0 marks a missing sample."""
    bone_lengths: Float[Array, " bone"]
    """l, in the unit of the positions."""
    frames: Int[Array, ""]
    """Number of valid frames; the stored ones beyond are padding."""
    edges: Edges = field(metadata={"static": True})
    """Bones as pairs of joint indices."""
    guide: Guide | None = None
    """For a solver with a guide term."""
