import json

import jax
import numpy as np
import pytest

from benchmarks.suite import __main__ as suite
from benchmarks.suite import baseline, clips, measure, page, peers_time, rows, table
from benchmarks.suite.methods import METHODS, PEERS, Method
from motionrecover import Motion, Skeleton, corrupt
from motionrecover.io import load
from motionrecover.synthetic import synthesize

# How far a clean clip may move, in metres: fillers keep every sample, filters smooth it, low rank leaves a rest out.
MOVED = {"hampel-butterworth": 0.01, "kalman": 0.005, "median-5": 0.003, "median-15": 0.01, "median-31": 0.03}
MOVED |= {"rpca-poses": 0.01, "rpca-motion": 0.005}


BODY = Skeleton("abcdefgh", [(0, 1)])


def body(joints=8, frames=200):
    """Points of one rigid body that turns and walks, at 100 Hz."""
    t = np.linspace(0, 2, frames)[:, None]
    x, y, z = np.random.default_rng(0).normal(scale=0.3, size=(joints, 3)).T
    turned = [np.cos(t) * x + np.sin(t) * z, y + 0 * t, np.cos(t) * z - np.sin(t) * x]
    return np.stack(turned, -1) + np.concatenate([1.2 * t, 0.9 + 0.03 * np.sin(9 * t), 0.1 * t], 1)[:, None]


def test_every_peer_returns_a_clean_clip():
    clip = synthesize(2, 120)
    for peer in PEERS:
        answer = peer.run(clip.positions.copy(), clips.Clip("walk", clip.positions, clip.skeleton, 120), None)
        moved = np.linalg.norm(answer - clip.positions, axis=-1)
        assert moved.mean() <= MOVED.get(peer.name, 1e-4), peer.name


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_every_peer_fills_every_gap(peer):
    clip = synthesize(2.5, 120)
    data, _ = corrupt.apply("mixed", clip.positions, 1)
    answer = peer.run(data, clips.Clip("walk", clip.positions, clip.skeleton, 120), None)
    assert np.isfinite(answer).all()


@pytest.mark.parametrize(
    ("name", "allowed"), [("rigid-donors", 1e-4), ("pca", 0.003), ("soft-impute", 0.005), ("spline", 0.03)]
)
def test_gap_of_a_rigid_body(name, allowed):
    truth = body()
    data = truth.copy()
    data[60:110, 2] = np.nan
    answer = METHODS[name].run(data, clips.Clip("body", truth, BODY, 100), None)
    assert np.linalg.norm(answer - truth, axis=-1).max() <= allowed
    kept = ~np.isnan(data)
    np.testing.assert_allclose(answer[kept], data[kept], atol=1e-12)


def test_despike_finds_thrown_samples_and_no_others():
    truth = body()
    data = truth.copy()
    hit = np.zeros(truth.shape[:2], bool)
    hit[10::37, 1] = hit[25::50, 4] = True
    data[hit] += 0.15
    np.testing.assert_array_equal(np.isnan(peers_time.despike(data)).any(-1), hit)


def test_spline_is_exact_for_a_cubic():
    t = np.linspace(0, 1, 50)[:, None]
    truth = (t**3 - t * np.array([1.0, 2.0, 3.0]))[:, None]
    data = truth.copy()
    data[[7, 20, 21, 22, 23, 40]] = np.nan
    np.testing.assert_allclose(peers_time.cubic(data), truth, atol=1e-12)
    filled = np.isfinite(peers_time.cubic(data, longest=2)).all((1, 2))
    np.testing.assert_array_equal(np.flatnonzero(~filled), [20, 21, 22, 23])


def test_kalman_follows_a_constant_acceleration():
    t = np.arange(240)[:, None, None] / 120
    truth = 0.5 * t + np.array([1.0, -2.0, 0.5]) * t**2
    data = truth.copy()
    data[100:130] = np.nan
    assert np.abs(peers_time.kalman(data, 120.0) - truth).max() <= 0.001


def test_butterworth_halves_the_power_of_6_hz_in_each_pass():
    t = np.arange(1200)[:, None, None] / 120
    for hertz, gain in ((0.5, 1.0), (6, 0.5), (40, 0.0)):
        wave = np.sin(2 * np.pi * hertz * t) * np.ones((1, 1, 3))
        middle = peers_time.hampel_butterworth(wave, 120.0)[300:900]
        # The Hampel filter before it takes a little off every crest.
        assert np.std(middle) / np.std(wave) == pytest.approx(gain, abs=0.03)


def test_running_median_ignores_a_minority():
    data = np.zeros((30, 1, 3))
    data[10:12] = 1
    assert not peers_time.running_median(data, 5).any()
    assert peers_time.running_median(data, 3).any()


def test_rows_are_distinct_and_their_protocols_exist():
    truth = clips.Clip("05_01", synthesize(3, 120).positions, Skeleton.standard("cmu25"), 120)
    assert len({row.name for row in rows.ROWS}) == len(rows.ROWS)
    assert {row.name for row in rows.ROWS} >= set(rows.QUICK)
    for row in rows.ROWS:
        if row.frames > len(truth.positions):
            continue
        data = row.corrupted(truth, 3)
        np.testing.assert_array_equal(data, row.corrupted(truth, 3))
        assert row.seeded == (not np.array_equal(data, row.corrupted(truth, 4), equal_nan=True))
        assert np.isnan(data).any() == (row.headline == "missing")
        assert np.isfinite(data[[0, -1]]).all()
    with pytest.raises(ValueError, match="nonsense"):
        rows.find(["nonsense"])


def test_clips_are_spread_over_subjects(shared_data):
    names, short = clips.pick(shared_data, "cmu25", 120, 4, ("05", "09"), 24)
    assert short == 0
    assert sorted(name[:2] for name in names) == ["05", "05", "09", "09"]
    everything, _ = clips.pick(shared_data, "cmu25", 120, 1000)
    assert not clips.GLITCHED & set(everything)
    assert set(names) <= set(everything)
    _, short = clips.pick(shared_data, "cmu21", 30, 4, ("09",), 100)
    assert short == 10


def test_middle_of_a_clip_at_a_lower_rate(shared_data):
    slow = clips.read(shared_data, "09_12", "cmu21", 30)
    whole = load(shared_data / "cmu" / "npz" / "09_12.npz").positions[::4, 0]
    start = (len(whole) - 300) // 2
    np.testing.assert_array_equal(slow.positions[:, 0], whole[start : start + 300])
    skipping = {("ltibia", "ltoes"), ("rtibia", "rtoes"), ("thorax", "upperneck")}
    rigid = {tuple(slow.skeleton.names[joint] for joint in bone) for bone in slow.rigid}
    assert not rigid & skipping


def test_smpl24_has_constant_bones():
    positions = np.random.default_rng(0).normal(size=(5, 31, 3))
    retargeted = clips.smpl24(Motion(positions, Skeleton.standard("cmu31"), 120))
    lengths = retargeted.skeleton.bone_lengths_of(retargeted.positions)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), atol=1e-12)
    assert 0.05 < lengths.min() < lengths.max() < 0.5


def test_a_failure_is_counted_with_its_reason():
    truth = clips.Clip("05_01", body(), BODY, 100)
    data = truth.positions.copy()
    data[50:60, 3] = np.nan

    def breaks(*_):
        raise ValueError("no")

    runs = []
    for name, run in {"raises": breaks, "leaves gaps": lambda data, *_: data, "works": METHODS["nothing"].run}.items():
        runs.append(
            measure.Run("iid-20 cmu25 60 Hz", name, "05_01", *measure.attempt(Method(name, run), data, truth, None))
        )
    row = rows.Row("iid-20", "cmu25", 60)
    summary = measure.summarise(runs, [row], {row.name: 0})[row.name]["methods"]
    assert [summary[run.method]["failures"] for run in runs] == [1, 1, 0]
    assert summary["raises"]["reasons"] == {"ValueError: no": 1}
    assert "not finite" in next(iter(summary["leaves gaps"]["reasons"]))
    assert summary["works"]["scores"]["observed"]["mean"] == 0
    assert "ValueError: no" in table.render({"rows": {row.name: {**_entry(), "methods": summary}}, "ours": []})


def test_only_calls_that_compile_are_made_twice():
    truth = clips.Clip("walk", body(), BODY, 100)
    calls = []

    @jax.jit
    def program(positions):
        return positions + 0

    def run(data, *_):
        calls.append(len(data))
        return np.asarray(program(data))

    for _ in range(2):
        measure.attempt(Method("ours", run, ours=True), truth.positions, truth, None)
    assert calls == [200, 200, 200]


def test_standard_error_counts_each_clip_once():
    row, scores = rows.ROWS[0], dict.fromkeys(measure.UNITS, float("nan"))
    values = (("a", 1.0), ("a", 3.0), ("b", 6.0))
    runs = [measure.Run(row.name, "m", clip, scores | {"all": value}, 0.1) for clip, value in values]
    found = measure.summarise(runs, [row], {row.name: 0})[row.name]["methods"]["m"]["scores"]
    assert found["all"] == {"mean": pytest.approx(10 / 3, abs=1e-4), "error": 2.0}
    assert found["missing"] == {"mean": None, "error": None}


def _entry():
    return {"headline": "all", "clips": ["05_01"], "too_short": 0}


def _results(**changes):
    scores = {name: {"mean": 1.2, "error": 0.1} for name in measure.UNITS} | {"missing": {"mean": None, "error": None}}
    summary = {"runs": 2, "failures": 0, "reasons": {}, "seconds": 0.5, "scores": scores} | changes.pop("summary", {})
    scores |= {name: {"mean": value, "error": 0.1} for name, value in changes.items()}
    methods = {"ours": summary, "peer": summary}
    return {"settings": {"clips": 6, "seeds": 5}, "ours": ["ours"], "rows": {"a row": {**_entry(), "methods": methods}}}


@pytest.mark.parametrize(
    ("changed", "worse"),
    [
        ({}, 0),
        ({"all": 0.5}, 0),
        ({"all": 1.25}, 0),
        ({"all": 1.4}, 1),
        ({"all": 1.4, "observed": 2.0}, 2),
        ({"acceleration": 0.9}, 0),
        ({"acceleration": 0.6}, 1),
        ({"all": None}, 1),
        ({"summary": {"failures": 1}}, 1),
        ({"summary": {"seconds": 0.9}}, 0),
        ({"summary": {"seconds": 2.0}}, 1),
    ],
)
def test_baseline_fails_on_worse_metrics(changed, worse):
    known = baseline.of(_results())
    assert not any("peer" in name for name in known["metrics"])
    assert all({"value", "unit", "direction", "tolerance"} == set(metric) for metric in known["metrics"].values())
    assert len(baseline.regressions(_results(**changed), known)) == worse


def test_baseline_of_other_settings_is_refused():
    with pytest.raises(ValueError, match="seeds"):
        baseline.regressions(_results() | {"settings": {"clips": 6, "seeds": 1}}, baseline.of(_results()))


@pytest.mark.usefixtures("shared_data")
def test_command(tmp_path, monkeypatch, capsys):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "XLA_FLAGS"):
        monkeypatch.setenv(name, "")
    files = ["--output", str(tmp_path / "results.json"), "--baseline", str(tmp_path / "baseline.json")]
    asked = [
        "--protocols",
        "clean cmu21 30 Hz",
        "--methods",
        "nothing",
        "pca",
        "--clips",
        "2",
        "--workers",
        "1",
        *files,
    ]
    assert suite.main([*asked, "--update-baseline"]) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["rows"]["clean cmu21 30 Hz"]["methods"]["nothing"]["scores"]["all"]["mean"] == 0
    assert "nothing" in capsys.readouterr().out


def test_the_page_is_what_the_committed_results_say():
    assert page.render() == page.PAGE.read_text(encoding="utf-8")
    text = page.README.read_text(encoding="utf-8")
    assert page.readme(text) == text
    assert all(words in text for words in page.SHORT.values())
