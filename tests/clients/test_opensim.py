"""Files that we wrote, in the real OpenSim."""

import numpy as np
import pytest
from helpers import TOLERANCE

import motionrecover as mr
from motionrecover.io import formats

pytestmark = pytest.mark.clients


@pytest.mark.skipif(not any(".trc" in known.suffixes for known in formats()), reason="TRC is not written yet")
def test_opensim_reads_the_same_positions(client, tmp_path):
    motion = mr.synthesize(1.0, seed=3)
    found = mr.recover(motion.positions, motion.skeleton, fps=motion.fps)
    positions = found.positions.copy()
    positions[30:40, 4] = np.nan
    path = mr.save(motion.with_positions(positions, "recovered"), tmp_path / "clean.trc")
    client("opensim", "read_trc_in_opensim.py", path, tmp_path / "seen.npz")
    seen = np.load(tmp_path / "seen.npz")
    assert seen["names"].tolist() == list(motion.names)
    assert seen["rate"] == pytest.approx(motion.fps)
    np.testing.assert_allclose(seen["times"], np.arange(len(motion)) / motion.fps, atol=TOLERANCE["written digits"])
    metres = {"m": 1.0, "mm": 0.001}[str(seen["units"])]
    np.testing.assert_allclose(metres * seen["positions"], positions, atol=TOLERANCE["written digits"])
