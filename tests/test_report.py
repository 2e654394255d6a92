"""The account of a recovery in numbers and words, and the size and safety of the page. `test_report_page` opens it."""

import base64
import gzip
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from report_clips import EVIL, GAP, SPIKE, large, recovery_of
from report_clips import planted as make_planted

from motionrecover.report import write_report
from motionrecover.report.account import binned, extent, feet, moments
from motionrecover.report.payload import SAMPLES, STEP, pack, payload
from motionrecover.report.words import describe, percent, summarise
from motionrecover.robust import Change
from motionrecover.solver import Result
from motionrecover.synthetic import synthesize


@pytest.fixture(scope="module")
def planted():
    return make_planted()


def unpacked(text, shape, step=STEP):
    """What `pack` took, decoded as its docstring says."""
    planes = np.frombuffer(gzip.decompress(base64.b64decode(text)), np.uint8).reshape(4, -1)
    counts = np.cumsum(np.ascontiguousarray(planes.T).view(np.int32).reshape(len(planes.T) // shape[1], -1), axis=0)
    wrapped = counts.astype(np.int32)  # sums wrap as the differences did
    return np.where(wrapped == -(2**31), np.nan, wrapped * step).reshape(shape)


def test_packing_keeps_every_number_to_half_a_step():
    values = np.random.default_rng(0).normal(0, 3, (50, 4))
    values[3:9, 1] = np.nan
    values[20, 2], values[21, 2] = np.inf, -1e9
    back = unpacked(pack(values), values.shape)
    finite = np.isfinite(values) & (np.abs(values) < 1e5)
    np.testing.assert_allclose(back[finite], values[finite], atol=0.5001 * STEP)
    assert np.isnan(back[3:9, 1]).all()
    assert np.isnan(back[20, 2])
    assert back[21, 2] == pytest.approx(-2e9 * STEP)


def test_binning_keeps_the_largest_of_every_bin():
    values = np.random.default_rng(1).normal(size=(103, 3))
    found = binned(values, 10)
    assert len(found) == 11
    for k, row in enumerate(found):
        np.testing.assert_array_equal(row, values[10 * k : 10 * k + 10].max(0))


def test_the_extent_is_the_distance_moved_or_the_uncertainty_of_what_was_filled(planted):
    clip, recovery, _ = planted
    far = extent(clip, recovery)
    assert far[SPIKE] == pytest.approx(0.3, abs=1e-6)
    np.testing.assert_allclose(far[GAP], 0.06)
    assert far[recovery.changed == Change.UNTOUCHED].max() < 1e-6


def test_moments_are_the_swap_the_gap_and_the_spike(planted):
    clip, recovery, _ = planted
    swap, gap, spike = moments(clip, recovery)
    assert (swap.kind, swap.joints, swap.start, swap.stop) == ("swap", (5, 9), 90, 100)
    assert (gap.kind, gap.joints, gap.start, gap.stop) == ("uncertain", (10,), 20, 40)
    assert (spike.kind, spike.joints, spike.frame) == ("repaired", (4,), 70)
    said = [describe(moment, recovery, clip.names) for moment in (swap, gap, spike)]
    assert said[0].endswith("swapped for 10 frames, put right")
    assert "filled in over 20 frames, ±\N{NO-BREAK SPACE}60\N{NO-BREAK SPACE}mm" in said[1]
    assert said[2] == f"{EVIL}: moved by 300\N{NO-BREAK SPACE}mm"


def test_moments_are_few_and_apart():
    clip, recovery = large(7200, 5)
    changed, positions = recovery.changed.copy(), clip.positions.copy()
    rng = np.random.default_rng(0)
    for frame in range(0, 7200, 7):
        positions[frame, 2, 0] += rng.uniform(0.1, 0.2)
        changed[frame, 2] = Change.REPAIRED
    found = moments(replace(clip, positions=positions), replace(recovery, changed=changed))
    frames = sorted(moment.frame for moment in found)
    assert len(frames) == 4
    assert min(np.diff(frames)) > 60
    distance = np.linalg.norm(positions - recovery.positions, axis=-1) * (changed == Change.REPAIRED)
    assert found[0].frame == distance.max(1).argmax()


def test_what_stays_unknown_comes_first_and_a_joint_never_seen_is_no_moment(planted):
    clip, recovery, truth = planted
    positions = truth.positions.copy()
    positions[:, 0] = np.nan
    positions[50:60, 3] = np.nan
    found = recovery_of(clip, positions, recovery.changed)
    first = moments(clip, found)[0]
    assert (first.kind, first.start, first.stop, first.joints) == ("unknown", 50, 60, (3,))
    summary = summarise(clip, found, moments(clip, found))
    assert (summary.tone, summary.verdict) == ("check", "Recovered in part")
    assert summary.check.startswith(f"{clip.names[0]} stayed missing throughout.")
    positions[:, 0] = 0.0
    partly = recovery_of(clip, positions, recovery.changed)
    assert summarise(clip, partly, []).check.startswith("0.3\N{NO-BREAK SPACE}% of the samples stayed missing.")


def test_the_verdict_follows_the_evidence(planted):
    clip, recovery, truth = planted
    assert summarise(clip, recovery, moments(clip, recovery)).tone == "check"  # the gap is uncertain by 6 cm
    sure = replace(recovery, uncertainty=np.full(clip.observed.shape, 0.001))
    summary = summarise(clip, sure, moments(clip, sure))
    assert (summary.tone, summary.verdict) == ("good", "Good to use")
    assert "21 samples off by up to" in summary.broken
    assert "20 samples missing and 1 swap of joints" in summary.broken
    assert summary.done.startswith("21 samples repaired, 20 samples filled and all others left exactly as they came.")
    stopped = summarise(clip, replace(sure, result=Result.max_steps), [])
    assert stopped.tone == "check"
    assert "more steps may refine it" in stopped.check
    silent = replace(recovery, uncertainty=np.full(clip.observed.shape, np.nan))
    said = summarise(clip, silent, [])
    assert (said.tone, said.verdict) == ("check", "Recovered, to be compared by eye")
    assert "does not say how far to trust it" in said.check
    clean = recovery_of(truth, truth.positions, np.zeros(clip.observed.shape))
    nothing = summarise(truth, clean, [])
    assert nothing.broken == "Nothing: every sample was measured and plausible."
    assert nothing.done == "Every sample left exactly as it came."
    lost = recovery_of(clip, np.full_like(truth.positions, np.nan), recovery.changed)
    assert summarise(clip, lost, []).tone == "bad"


def test_a_share_is_zero_or_whole_only_when_it_is():
    shares = [0.0, 1e-6, 0.012, 0.2, 0.9999, 1.0]
    said = [percent(share).replace("\N{NO-BREAK SPACE}", " ") for share in shares]
    assert said == ["0.0 %", "< 0.1 %", "1.2 %", "20 %", "> 99 %", "100 %"]


def test_feet_that_stand_do_not_slide():
    truth = synthesize(2, 60, 0)
    steps = feet(truth, recovery_of(truth, truth.positions, np.zeros(truth.observed.shape)))
    assert [truth.names[joint] for joint in steps.joints] == ["lfoot", "ltoes", "rfoot", "rtoes"]
    assert 0.3 < steps.contacts.mean() < 1
    np.testing.assert_allclose(steps.before, steps.after, atol=1e-4)
    assert max(steps.after) < 0.1
    np.testing.assert_array_equal(np.isfinite(steps.speeds), steps.contacts)


def test_a_page_of_ten_thousand_frames_and_fifty_joints_is_small(tmp_path):
    clip, recovery = large(10_000)
    write_report(clip, recovery, tmp_path / "large.html")
    assert (tmp_path / "large.html").stat().st_size < 15e6
    assert payload(clip, recovery, None, [])["size"] == 1


def test_a_longer_clip_is_thinned_to_its_worst_frames():
    clip, recovery = large(30_000)
    packed = payload(clip, recovery, None, moments(clip, recovery))
    size, shown = packed["size"], packed["shown"]
    assert size == 3
    assert 2 * len(shown) * 50 <= SAMPLES
    assert 7001 in shown
    np.testing.assert_array_equal(np.array(shown) // size, np.arange(len(shown)))
    changed = unpacked(packed["series"]["changed"], (len(shown), 50), 1)
    assert np.argwhere(changed == Change.REPAIRED).tolist() == [[7001 // size, 49]]
    far = unpacked(packed["series"]["extent"], (len(shown), 50))
    assert far[7001 // size, 49] == pytest.approx(
        np.linalg.norm(clip.positions - recovery.positions, axis=-1).max(), abs=STEP
    )


def test_names_are_escaped(planted, tmp_path):
    clip, recovery, _ = planted
    path = tmp_path / "evil.html"
    write_report(clip, recovery, path, title=f"{EVIL}.bvh", settings={EVIL: EVIL})
    page = path.read_text(encoding="utf-8")
    assert EVIL not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;.bvh" in page
    assert len(re.findall(r"</script>", page)) == 3


def test_what_cannot_be_written_is_refused(planted, tmp_path, monkeypatch):
    clip, recovery, _ = planted
    path = tmp_path / "out.html"
    with pytest.raises(ValueError, match="received truth of shape"):
        write_report(clip, recovery, path, truth=synthesize(1, 60))
    with pytest.raises(ValueError, match="received a recovery of shape"):
        write_report(synthesize(1, 60), recovery, path)
    path.write_text("old")
    with pytest.raises(FileExistsError, match="exists already"):
        write_report(clip, recovery, path)
    assert path.read_text() == "old"
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(ImportError, match=r"pip install motionrecover\[report\]"):
        write_report(clip, recovery, path, overwrite=True)
