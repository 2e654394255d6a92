"""A file in, a file and a page about it out, as `motionrecover recover IN -o OUT --report PAGE` does it."""

from pathlib import Path

import motionrecover as mr
from motionrecover.report import write_report

folder = Path("example-files")
folder.mkdir(exist_ok=True)
truth = mr.synthesize(1.5)
thrown, _ = mr.corrupt.apply("iid-5", truth.positions, seed=0)
mr.save(truth.with_positions(thrown, "5 % thrown"), folder / "walk.csv", overwrite=True)

motion = mr.load(folder / "walk.csv")  # BVH, AMC, C3D, TRC, CSV, NPZ or NPY
print("\n".join(motion.history))  # what was read, and what was assumed
found = mr.recover(
    motion.positions, motion.skeleton, fps=motion.fps, observed=motion.observed, confidence=motion.confidence
)
clean = motion.with_positions(found.positions, "recovered")
for name in ("walk-clean.csv", "walk-clean.bvh"):
    print("wrote", mr.save(clean, folder / name, overwrite=True))
write_report(motion, found, folder / "walk.html", truth=truth, overwrite=True)
print("now open", folder / "walk.html")
