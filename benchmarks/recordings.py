"""Where the recordings are that benchmarks read, and which of them are broken. Nothing recorded is part of the project.

`cmu/npz` of the folder holds clips of the CMU Graphics Lab Motion Capture Database, and a manifest of them.
"""

import os
from pathlib import Path

MANIFEST = "cmu/npz/manifest.csv"

GLITCHED = {f"05_{k:02}" for k in (5, 6, 8, 10, *range(15, 21))} | {
    *("01_06", "01_07", "03_02", "07_12", "09_10", "14_10", "16_15", "16_23", "16_28")
}
"""Clips with a step of 0.25 to 2.6 m in one frame in the files themselves (flipped arms, and one thrown body in 09_10),
by the README beside the data."""


def data_folder() -> Path:
    """The folder `MOTIONRECOVER_DATA` or `../shared/data`. Raises `FileNotFoundError` where it has no recordings."""
    folder = Path(os.environ.get("MOTIONRECOVER_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    if not (folder / MANIFEST).is_file():
        raise FileNotFoundError(f"no recordings at {folder}: set MOTIONRECOVER_DATA to a folder with {MANIFEST}")
    return folder
