"""What is written for the viewer of rerun, read back."""

import sys

import numpy as np
import pytest
from report_clips import GAP, planted

from motionrecover.view import view


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Rows of the logged columns, by entity and component, and the clips."""
    reader = pytest.importorskip("rerun.chunk", reason="no recent rerun: pip install motionrecover[view]")
    clip, recovery, truth = planted()
    path = tmp_path_factory.mktemp("view") / "out.rrd"
    recovered = truth.with_positions(recovery.positions, "recovered")
    view({"input": clip, "recovered": recovered, "truth": truth}, {"weights": recovery.weights}, save=path)
    assert [each.name for each in path.parent.iterdir()] == ["out.rrd"]
    columns = {}
    for chunk in reader.RrdReader(str(path)).stream().to_chunks():
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            columns |= {(chunk.entity_path, name): batch.column(name).to_pylist() for name in batch.schema.names}
    return clip, recovery, columns


def test_joints_are_where_they_were_and_missing_ones_are_left_out(shown):
    clip, recovery, columns = shown
    joints = columns["/input/joints", "Points3D:positions"]
    assert [len(row) for row in joints] == clip.observed.sum(1).tolist()
    assert len(joints[GAP[0].start]) == len(clip.names) - 1
    np.testing.assert_allclose(joints[0], clip.positions[0], atol=1e-6)
    np.testing.assert_allclose(columns["/recovered/joints", "Points3D:positions"], recovery.positions, atol=1e-6)
    assert columns["/input/joints", "frame"] == list(range(len(clip)))


def test_bones_have_both_ends(shown):
    clip, recovery, columns = shown
    bones = columns["/input/bones", "LineStrips3D:strips"]
    whole = clip.observed[:, np.array(clip.skeleton.edges)].all(-1).sum(1)
    assert [len(row) for row in bones] == whole.tolist()
    ends = recovery.positions[:, np.array(clip.skeleton.edges)]
    np.testing.assert_allclose(columns["/recovered/bones", "LineStrips3D:strips"], ends, atol=1e-6)


def test_numbers_of_joints_are_plotted(shown):
    _, recovery, columns = shown
    np.testing.assert_array_equal(columns["/weights", "Scalars:scalars"], recovery.weights)


def test_missing_rerun_names_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ImportError, match=r"pip install motionrecover\[view\]"):
        view({"truth": planted()[2]}, save=tmp_path / "never.rrd")
    assert not list(tmp_path.iterdir())
