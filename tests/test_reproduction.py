import json

import numpy as np
import pytest

from benchmarks.studies import yang2020, yang2020_report
from motionrecover import corrupt, metrics
from motionrecover.recover import bucket, recover

SIZES = (8, 32, 144, 640, 1152, 1920)
"""Stored lengths of the sample, so that it compiles six programs."""


def test_page_is_what_the_results_say():
    page, results = yang2020_report.PAGE.read_text(), json.loads(yang2020.RESULTS.read_text())
    assert yang2020_report.render(results, page) == page


def test_unknown_marker_is_refused():
    with pytest.raises(ValueError, match="nonsense"):
        yang2020_report.render(json.loads(yang2020.RESULTS.read_text()), "<!-- nonsense -->\n<!-- end -->")


@pytest.mark.usefixtures("shared_data")
def test_quick_run(tmp_path):
    output = tmp_path / "results.json"
    results = yang2020.main(["table2", "--quick", "--output", str(output)])
    assert json.loads(output.read_text())["table2"]["clips"] == results["table2"]["clips"]
    for row in results["table2"]["clips"]:
        assert row["aje"]["str_yang2020"][1] < row["aje"]["nothing"][1]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("rate", "limit"), [(0.05, 0.002), (0.2, 0.010)])
def test_str_on_a_walk(shared_data, rate, limit, seed):
    clip = yang2020.cmu25("05_02", shared_data).head(300)
    data, _ = corrupt.joints(clip.positions, rate, seed=seed)
    recovery = recover(data, clip.skeleton, bone_lengths=clip.lengths)
    assert metrics.aje(recovery.positions, clip.positions) <= limit


def sample(rng, full):
    """A start and a stop: a size that the clip has is drawn first, so that short windows are as likely as long ones."""
    lengths = {size: [n for n in range(3, full + 1) if bucket(n) == size] for size in SIZES}
    length = rng.choice(lengths[rng.choice([size for size in SIZES if lengths[size]])])
    start = rng.integers(full - length + 1)
    return start, start + length


@pytest.mark.parametrize("name", [name for names in yang2020.FULL.subjects.values() for name in names])
def test_no_clip_comes_back_worse(shared_data, name):
    clip = yang2020.cmu25(name, shared_data)
    rng = np.random.default_rng(int(name.replace("_", "")))
    for rate, known in ((0.05, True), (0.05, False), (0.2, True), (0.2, False), (0.8, True)):
        start, stop = sample(rng, len(clip.positions))
        truth = clip.positions[start:stop]
        data, hit = corrupt.joints(truth, rate, seed=rng)
        # Lengths are estimated from frames of which more than half must be intact.
        lengths = clip.lengths if known or len(truth) < 30 else None
        before = metrics.aje(data, truth)
        after = metrics.aje(recover(data, clip.skeleton, bone_lengths=lengths).positions, truth)
        assert after < before or not hit.any(), (name, start, stop, rate, known, before, after)
