"""Windows: they cover a clip, and their answers become one without a step."""

from importlib import import_module
from itertools import pairwise

import numpy as np
import pytest
from helpers import SKELETONS, clip, hit, lengths_of
from hypothesis import given
from hypothesis import strategies as st

from motionrecover import PRESETS, recover
from motionrecover.windows import blend, solved, split


@given(frames=st.integers(1, 5000), window=st.integers(2, 400), share=st.floats(0, 0.9))
def test_windows_cover_the_clip(frames, window, share):
    overlap = int(share * window)
    spans = split(frames, window, overlap)
    sizes = {span.stop - span.start for span in spans}
    assert spans[0].start == 0
    assert spans[-1].stop == frames
    assert len(sizes) == 1
    assert sizes.pop() <= window
    for one, following in pairwise(spans):
        assert one.stop - following.start >= overlap
        assert following.start > one.start


def test_windows_that_never_advance_are_refused(refused):
    refused(lambda: split(10, 4, 4), "4 frames", error=ValueError)


@given(frames=st.integers(1, 300), window=st.integers(2, 60))
def test_blending_equal_answers_gives_them_back(frames, window):
    x = np.random.default_rng(frames).normal(size=(frames, 2, 3))
    spans = split(frames, window, window // 3)
    np.testing.assert_allclose(blend([x[span] for span in spans], spans), x, atol=1e-12)


def test_blending_turns_one_answer_into_the_other_without_a_step():
    spans = split(100, 60, 20)
    assert len(spans) == 2
    mixed = blend([np.zeros(60), np.ones(60)], spans)
    assert mixed[0] == 0
    assert mixed[-1] == 1
    assert np.diff(mixed).min() >= 0
    assert np.diff(mixed).max() < 0.06


def test_progress_is_told_before_the_first_window_and_after_each():
    events, spans = [], split(100, 30, 10)
    for span in solved(lambda span: span, spans, 1, lambda done, total: events.append((done, total))):
        events.append(span)
    after = [event for k, span in enumerate(spans, 1) for event in ((k, len(spans)), span)]
    assert events == [(0, len(spans)), *after]
    assert list(solved(lambda span: span, spans, 3, None)) == spans


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_what_progress_raises_ends_a_recovery_before_its_first_window(preset, monkeypatch):
    def solve(*_):
        raise AssertionError("solved")

    def stop(done, total):
        raise KeyboardInterrupt(done, total)

    for module in ("recovery", "robust"):
        monkeypatch.setattr(import_module(f"motionrecover.{module}"), "run", solve)
    skeleton = SKELETONS["cmu25"]
    with pytest.raises(KeyboardInterrupt) as stopped:
        recover(clip(skeleton, 500), skeleton, preset=preset, progress=stop)
    assert stopped.value.args == (0, len(split(500, preset.window, preset.overlap)))


def test_a_long_clip_shows_no_seams():
    """Errors of acceleration, where a step would show, inside the overlaps against elsewhere; and on clean data, where
    the windows' ends are the largest error there is, below what anyone could see."""
    skeleton, shared = SKELETONS["cmu25"], np.zeros(400, int)
    truth = clip(skeleton, 400)
    for span in split(400, 100, 16):
        shared[span] += 1
    inside = (shared > 1)[1:-1]
    for rate in (0.0, 0.1):
        found = recover(hit(truth, rate), skeleton, bone_lengths=lengths_of(skeleton, truth))
        error = np.linalg.norm(np.diff(found.positions - truth, 2, axis=0), axis=-1).mean(1)
        assert error[inside].mean() < max(1e-4, 1.5 * error[~inside].mean())
