import json

import numpy as np
import pytest

from benchmarks.studies import yang2020, yang2020_protocol, yang2020_report
from motionrecover import corrupt, metrics
from motionrecover.recovery import recover


@pytest.mark.parametrize("page", yang2020_report.PAGES, ids=lambda page: page.name)
def test_page_is_what_the_results_say(page):
    text, results = page.read_text(), json.loads(yang2020.RESULTS.read_text())
    assert yang2020_report.render(results, text) == text


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
    clip = yang2020_protocol.cmu25("05_02", shared_data).head(300)
    data, _ = corrupt.joints(clip.positions, rate, seed=seed)
    recovery = recover(data, clip.skeleton, bone_lengths=clip.lengths, preset="str_yang2020")
    assert metrics.aje(recovery.positions, clip.positions) <= limit


@pytest.mark.parametrize("name", [name for names in yang2020_protocol.FULL.subjects.values() for name in names])
def test_no_clip_comes_back_worse(shared_data, name):
    clip = yang2020_protocol.cmu25(name, shared_data)
    rng = np.random.default_rng(int(name.replace("_", "")))
    full = len(clip.positions)
    # Lengths of four compiled programs: at most 8 frames, 24, 64, and windows of 100.
    cases = (
        (0.05, full, True),
        (0.05, 64, False),
        (0.05, rng.integers(3, 9), True),
        (0.2, full, False),
        (0.2, 24, False),
        (0.2, rng.integers(3, 9), True),
        (0.2, rng.integers(6, 9), False),
        (0.8, rng.integers(3, 9), True),
        (0.8, rng.integers(100, min(full, 400) + 1), True),
    )
    for rate, length, known in cases:
        start = rng.integers(full - length + 1)
        truth = clip.positions[start : start + length]
        data, hit = corrupt.joints(truth, rate, seed=rng)
        recovery = recover(data, clip.skeleton, preset="str_yang2020", bone_lengths=clip.lengths if known else None)
        before, after = metrics.aje(data, truth), metrics.aje(recovery.positions, truth)
        assert after < before or not hit.any(), (name, int(start), int(length), rate, known, before, after)
