"""Arrays in, arrays out: noise, a gap and a spike taken out of joint positions."""

import numpy as np

import motionrecover as mr

truth = mr.synthesize(1.5)  # a motion made from nothing; yours are an array (frame, joint, 3) and a Skeleton
rng = np.random.default_rng(0)
positions = truth.positions + rng.normal(scale=0.003, size=truth.positions.shape)  # metres, y up
positions[60:90, 7] = np.nan  # missing
positions[120, 12] += [0.2, 0.1, 0.0]  # a spike

found = mr.recover(positions, truth.skeleton, fps=truth.fps)
print(found.message)

before, after = (1000 * np.linalg.norm(x - truth.positions, axis=-1) for x in (positions, found.positions))
print(f"noise: {np.nanmedian(before):.1f} mm before, {np.median(after):.1f} mm after")
print(f"spike: {before[120, 12]:.0f} mm before, {after[120, 12]:.1f} mm after")
print(f"gap of 30 frames: off by {after[60:90, 7].mean():.1f} mm in the mean")
