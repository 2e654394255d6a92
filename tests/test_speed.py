"""The speed benchmark: every contender computes the same thing, the page is what the results say."""

import json

import numpy as np
import pytest

from benchmarks.speed import __main__ as speed
from benchmarks.speed import limit, page, rows
from benchmarks.speed.contenders import CONTENDERS, Task
from motionrecover import metrics

TASK = Task(80, 8)  # the shortest length at which PyWavelets does not warn of boundary effects


@pytest.mark.filterwarnings("ignore:JAXopt is no longer maintained:DeprecationWarning")
@pytest.mark.parametrize("name", [name for name in CONTENDERS if name != "ours"])
def test_contenders_compute_the_same_iterations(name):
    ours = CONTENDERS["ours"](TASK)()
    theirs = CONTENDERS[name](TASK)()
    assert theirs.shape == ours.shape
    # Inexact inner solutions leave a tenth of a millimetre, of an error of some centimetres.
    assert metrics.aje(theirs, ours) < 2e-4
    assert abs(metrics.aje(theirs, TASK.truth) - metrics.aje(ours, TASK.truth)) < 1e-4


def test_fewer_steps_are_another_answer():
    """The comparison above can fail: two steps less are a millimetre off."""
    ours, fewer = (CONTENDERS["ours"](Task(80, steps))() for steps in (8, 6))
    assert metrics.aje(fewer, ours) > 1e-3


def test_limit_counts_arrays_of_the_size_of_d():
    d = np.zeros((3, 25, 100), np.float32)
    assert limit.bytes_moved(100, 25) == pytest.approx(limit.ARRAYS * d.nbytes)
    assert limit.bandwidth(100, 25, seconds=0.01) > 1e8


def test_batch_runs_small():
    found = rows.batch(quick=True)
    assert found["frames_a_second"] > 0
    assert np.isfinite(found["aje"])


def test_gpu_is_refused_without_one():
    with pytest.raises(RuntimeError, match="JAX runs on cpu"):
        rows.batch(quick=True, gpu=True)


def test_one_row_from_the_command(tmp_path, capsys):
    output = tmp_path / "results.json"
    assert speed.main(["import", "--quick", "--output", str(output)]) == 0
    assert json.loads(output.read_text())["rows"]["import"]["ratio"] > 0
    with pytest.raises(SystemExit):
        speed.main(["nonsense"])
    assert "nonsense" in capsys.readouterr().err


def test_page_is_what_the_results_say():
    results = json.loads(page.RESULTS.read_text())
    assert page.PAGE.read_text() == page.render(results)
    assert set(results["rows"]) - {"batch-gpu"} == set(rows.ROWS)
