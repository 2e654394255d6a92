"""What is known after a recovery: bone lengths, what happened to each sample, and how far off it may be."""

import numpy as np

import motionrecover as mr
from motionrecover.robust import Change

truth = mr.synthesize(1.5)
rng = np.random.default_rng(0)
noisy = truth.positions + rng.normal(scale=0.003, size=truth.positions.shape)
positions, _ = mr.corrupt.apply("gap3x40", noisy, seed=1)
found = mr.recover(positions, truth.skeleton, fps=truth.fps)

true = truth.skeleton.rest_lengths
for bone in np.argsort(-true)[:4]:
    low, high = 1000 * found.bone_intervals[bone]
    name = truth.skeleton.bone_names[bone]
    print(
        f"{name}: {1000 * found.bone_lengths[bone]:.1f} mm, in {low:.1f} to {high:.1f}; true: {1000 * true[bone]:.1f}"
    )

error = np.linalg.norm(found.positions - truth.positions, axis=-1)
for change in Change:
    these = found.changed == change
    if these.any():
        off, said = (1000 * np.sqrt(np.nanmean(x[these] ** 2)) for x in (error, found.uncertainty))
        print(f"{change.name.lower()}: {these.mean():.1%} of the samples, off by {off:.1f} mm, expected {said:.1f} mm")
