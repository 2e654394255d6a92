"""Live recovery: delay, memory, determinism, accuracy, and everything a live source does wrong."""

import jax
import numpy as np
import pytest
from helpers import SMALL_BODY, clip, hit

from motionrecover import Stream, recover, sliding

FPS, DELAY = 36, 0.25
"""With and without a delay, windows are of one size and share their programs."""
TRUTH = clip(SMALL_BODY, 150)
DATA = hit(TRUTH, 0.1)
GONE = np.full(TRUTH.shape[1:], np.nan)


def answers(data, delay=DELAY, times=None, **settings):
    """All answers, as if nothing had to be waited for; NaN where there is none."""
    stream = Stream(SMALL_BODY, FPS, delay)
    times = [None] * len(data) if times is None else times
    found = [stream.push(frame, time=time, **settings) for frame, time in zip(data, times, strict=True)]
    return stream, found, stream.flush()


@pytest.fixture(scope="module")
def recovered():
    return answers(DATA)


def errors(found, truth):
    return np.linalg.norm(found - truth, axis=-1)


def same(a, b):
    return all(
        (x is None) == (y is None) and (x is None or np.array_equal(x, y, True)) for x, y in zip(a, b, strict=True)
    )


def test_every_frame_comes_out_once_and_the_delay_is_constant(recovered):
    stream, found, rest = recovered
    assert stream.delay == round(DELAY * FPS)
    assert [k for k, answer in enumerate(found) if answer is None] == list(range(stream.delay))
    assert all(answer.shape == (5, 3) for answer in found[stream.delay :])
    assert rest.shape == (stream.delay, 5, 3)


def test_the_same_frames_give_the_same_answers(recovered):
    _, found, rest = recovered
    _, again, rest_again = answers(DATA)
    assert same(found, again)
    assert np.array_equal(rest, rest_again)


def test_the_answer_is_about_that_of_the_whole_clip(recovered):
    stream, found, rest = recovered
    whole = recover(DATA, SMALL_BODY, dtype=np.float64).positions
    live = np.concatenate([found[stream.delay :], rest])
    late = slice(FPS, None)
    measured = errors(DATA, TRUTH)[late].mean()
    assert errors(live, TRUTH)[late].mean() < 1.5 * errors(whole, TRUTH)[late].mean() + 1e-3 * measured


def test_bones_keep_their_lengths(recovered):
    stream, found, rest = recovered
    lengths = SMALL_BODY.bone_lengths_of(np.concatenate([found[stream.delay :], rest])[FPS:])
    assert np.ptp(lengths, axis=0).max() < 1e-3 * lengths.mean()


def test_what_is_kept_stays_as_large(monkeypatch):
    monkeypatch.setattr(sliding, "MEMORY", 16)
    stream, sizes = Stream(SMALL_BODY, FPS, DELAY), []
    for frame in DATA:
        stream.push(frame)
        stream._wait()
        kept = [getattr(stream._state, name) for name in ("beliefs", "next")]
        memory = [*vars(stream._state.memory).values(), stream._data, stream._trust, stream._answers]
        leaves = jax.tree.leaves([vars(kept[0]) if kept[0] else None, kept[1], memory])
        sizes.append(sum(np.asarray(leaf).nbytes for leaf in leaves))
    assert sizes[-1] == sizes[len(sizes) // 2] > 0


def test_missing_samples_are_filled():
    data = DATA.copy()
    data[60:72, 2] = np.nan
    stream, found, rest = answers(data)
    live = np.concatenate([found[stream.delay :], rest])
    assert np.isfinite(live[FPS:]).all()
    # Farther off than samples that are seen, but not by the size of the body.
    assert errors(live, TRUTH)[60:72, 2].mean() < 0.1


def test_somebody_leaves_and_comes_back():
    data = np.concatenate([DATA[:60], np.tile(GONE, (90, 1, 1)), DATA[60:]])
    truth = np.concatenate([TRUTH[:60], np.tile(GONE, (90, 1, 1)), TRUTH[60:]])
    stream, found, rest = answers(data)
    live = np.concatenate([found[stream.delay :], rest])
    assert np.isnan(live[75:150]).all()
    assert np.isfinite(live[30:60]).all()
    assert np.isfinite(live[150 + FPS :]).all()
    assert errors(live, truth)[150 + FPS :].mean() < 0.1 * errors(data, truth)[150 + FPS :].mean()


def test_dropped_frames_are_missing_ones():
    kept = np.delete(np.arange(len(DATA)), [50, 51, 80])
    stream, found, _ = answers(DATA[kept], times=7 + kept / FPS)
    data = DATA.copy()
    data[[50, 51, 80]] = np.nan
    _, expected, _ = answers(data)
    assert stream.dropped == 3
    assert same(found, [expected[k] for k in kept])


def test_a_late_frame_takes_its_place_and_a_repeated_one_changes_nothing(recovered):
    _, expected, _ = recovered
    order = np.arange(len(DATA))
    order[[63, 64]] = 64, 63  # windows end behind 62 and 65
    order = np.insert(order, 100, order[99])
    stream, found, _ = answers(DATA[order], times=order / FPS)
    assert (stream.dropped, stream.late, stream.repeated) == (0, 1, 1)
    there = [k for k in range(len(order)) if k not in (64, 100)]
    assert same([found[k] for k in there], [expected[order[k]] for k in there])


def test_a_clock_that_drifts_and_jitters_drops_nothing():
    rng = np.random.default_rng(0)
    times = 1e9 + np.arange(len(DATA)) * 1.004 / FPS + rng.uniform(-0.2, 0.2, len(DATA)) / FPS
    stream, _, _ = answers(DATA, times=times)
    assert (stream.dropped, stream.late, stream.repeated) == (0, 0, 0)


def test_a_break_of_a_day_takes_no_longer_than_one_of_seconds():
    stream = Stream(SMALL_BODY, FPS, DELAY)
    for k, frame in enumerate(DATA[:40]):
        stream.push(frame, time=k / FPS)
    assert np.isnan(stream.push(DATA[40], time=86400.0)).all()
    assert stream.frames == 86400 * FPS + 1
    found = [stream.push(frame, time=86400 + k / FPS) for k, frame in enumerate(DATA[41:], 1)]
    assert errors(np.array(found[-30:]), TRUTH[-30 - stream.delay : -stream.delay]).mean() < 0.01


def test_no_confidence_is_no_sample():
    data, trust = DATA.copy(), np.ones(5)
    data[:, 3] = np.nan
    trust[3] = 0
    _, expected, _ = answers(data[:60])
    _, found, _ = answers(DATA[:60], confidence=trust)
    assert same(found, expected)


@pytest.mark.parametrize("delay", [DELAY, 0])
def test_strange_sources_end_nothing(delay):
    still, unseen, rare = np.repeat(TRUTH[:1], 60, 0), TRUTH[:60].copy(), np.full((60, 5, 3), np.nan)
    unseen[:, 4], rare[::7] = np.nan, TRUTH[:60:7]
    noise = np.random.default_rng(0).normal(size=(60, 5, 3))
    for data in (still, unseen, rare, noise, np.zeros((60, 5, 3)), TRUTH[:60] + 1e6):
        stream, found, _ = answers(data, delay)
        live = np.array(found[stream.delay :])
        assert live.shape == (60 - stream.delay, 5, 3)
        if data is still:
            assert errors(live, still[: len(live)])[20:].max() < 1e-9
        if data is unseen:
            assert np.isnan(live[:, 4]).all()
            assert np.isfinite(live[20:, :4]).all()


def test_after_a_flush_comes_another_clip():
    stream = Stream(SMALL_BODY, FPS, DELAY)
    for _ in range(2):
        found = [stream.push(frame) for frame in DATA[:50]]
        assert sum(answer is None for answer in found) == stream.delay
        assert np.isfinite(found[-1]).all()
        assert len(stream.flush()) == stream.delay
    assert len(stream.flush()) == 0


def test_without_a_delay_each_frame_has_its_answer_at_once():
    stream, found, rest = answers(DATA, delay=0)
    assert stream.delay == 0
    assert len(rest) == 0
    assert all(answer is not None for answer in found)
    live = np.array(found)[FPS:]
    assert np.isfinite(live).all()
    assert errors(live, TRUTH[FPS:]).mean() < 0.2 * errors(DATA, TRUTH)[FPS:].mean()


def test_without_a_delay_somebody_leaves_and_comes_back():
    data = np.concatenate([DATA[:60], np.tile(GONE, (90, 1, 1)), DATA[60:]])
    live = np.array(answers(data, delay=0)[1])
    assert np.isnan(live[75:150]).all()
    assert errors(live, np.concatenate([TRUTH[:60], TRUTH[:90], TRUTH[60:]]))[150 + FPS :].mean() < 0.01


def test_what_cannot_be_used_is_refused_in_a_sentence(refused):
    stream = Stream(SMALL_BODY, FPS, DELAY)
    refused(lambda: stream.push(np.zeros((4, 3))), "(4, 3)", "5 joints", error=ValueError)
    refused(lambda: stream.push(np.zeros((5, 2))), "(5, 2)", error=ValueError)
    refused(lambda: stream.push(DATA[0], confidence=[2.0] * 5), "confidence", error=ValueError)
    refused(lambda: stream.push(DATA[0], time=float("nan")), "time", error=ValueError)
    refused(lambda: Stream(SMALL_BODY, 0), "frame rate", error=ValueError)
    refused(lambda: Stream(SMALL_BODY, FPS, 1 / FPS), "delay", error=ValueError)
    refused(lambda: Stream(SMALL_BODY, FPS, -1), "delay", error=ValueError)
    stream.push(DATA[0], time=100.0)
    refused(lambda: stream.push(DATA[1], time=0.0), "run forward", error=ValueError)
    refused(lambda: stream.push(DATA[1], time=1e300), "give seconds", error=ValueError)
    assert stream.frames == 1
