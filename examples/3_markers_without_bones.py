"""Markers that bring no bones: which of them keep their distance is found in the clip, and holds them together."""

import numpy as np

import motionrecover as mr

body = mr.synthesize(1.5)
rng = np.random.default_rng(0)
truth = np.concatenate([body.positions[:, 1:], body.positions[:, :1]], axis=1)  # an order that says nothing
names = [f"M{k:02d}" for k in range(truth.shape[1])]
markers, _ = mr.corrupt.apply("gap4x40", truth + rng.normal(scale=0.0005, size=truth.shape), seed=1)

graph = mr.infer_graph(markers)
skeleton = mr.Skeleton(names, graph.edges)
print(f"{len(skeleton.edges)} pairs of markers keep their distance, in {len(skeleton.components)} parts")
mr.save_skeleton(skeleton, "example-markers.toml", overwrite=True)  # to look at and edit, for Skeleton.from_file

found = mr.recover(markers, skeleton, fps=body.fps)
lost = np.isnan(markers[..., 0])
error = 1000 * np.linalg.norm(found.positions - truth, axis=-1)
print(f"{lost.sum()} samples were missing: filled ones are off by {np.nanmean(error[lost]):.1f} mm in the mean")
