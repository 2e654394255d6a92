"""Many clips on all processors: answers in order, and a reason instead of an answer where there is none."""

from collections.abc import Iterator

import numpy as np

import motionrecover as mr

LOST = 2  # of this clip, nothing was seen


def clips() -> Iterator[mr.Motion]:
    """Read one by one as they are needed: as many as you like."""
    for seed in range(4):
        truth = mr.synthesize(1.5, seed=seed)
        positions, _ = mr.corrupt.apply("iid-10", truth.positions, seed)
        yield truth.with_positions(np.full_like(positions, np.nan) if seed == LOST else positions, "corrupted")


for outcome in mr.recover_many(clips()):
    if outcome.recovery is None:
        print(f"clip {outcome.index}: {outcome.reason}")
    else:
        repaired = (outcome.recovery.outliers != 0).any(-1).mean()
        print(f"clip {outcome.index}: {repaired:.0%} of the samples repaired in {outcome.recovery.steps} steps")
