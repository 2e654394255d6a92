"""Many clips at once against each alone."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from helpers import clip, hit

from motionrecover import Motion, Skeleton, programs, recover, recover_many

CHAIN = Skeleton("abcde", [(0, 1), (1, 2), (2, 3), (3, 4)])


def motion(frames, seed):
    return Motion(hit(clip(CHAIN, frames, seed), 0.1, seed), CHAIN, fps=60.0)


@pytest.mark.parametrize("preset", ["robust", "str_yang2020"])
def test_each_answer_is_that_of_the_clip_alone(preset):
    clips = [motion(frames, seed) for seed, frames in enumerate((33, 41, 36, 30))]
    programs._place.cache_clear()
    outcomes = list(recover_many(clips, workers=2, preset=preset, dtype="float64"))
    # Of the smoother and of the projection that it prepares: another shape there would be a program for nothing.
    assert programs.made() <= 2
    assert [outcome.index for outcome in outcomes] == [0, 1, 2, 3]
    for one, outcome in zip(clips, outcomes, strict=True):
        alone = recover(one.positions, one.skeleton, fps=one.fps, preset=preset, dtype="float64")
        np.testing.assert_array_equal(outcome.recovery.positions, alone.positions)
        assert outcome.recovery.result == alone.result
        assert outcome.reason is None


def test_a_bad_clip_has_a_reason_and_the_others_an_answer():
    hidden = motion(30, 1).with_positions(np.full((30, 5, 3), np.nan), "all lost")
    outcomes = list(recover_many([motion(30, 0), hidden, motion(30, 2)], workers=2))
    assert [outcome.recovery is None for outcome in outcomes] == [False, True, False]
    assert "observed" in outcomes[1].reason


def test_clips_are_read_as_they_are_needed():
    read = []

    def endless():
        while True:
            read.append(len(read))
            yield motion(30, 0)

    outcomes = recover_many(endless(), workers=1, max_steps=2)
    assert next(outcomes).index == 0
    assert len(read) <= 4
    outcomes.close()


def test_no_workers_are_refused(refused):
    refused(lambda: recover_many([], workers=0), "0 workers", error=ValueError)


def test_ctrl_c_ends_it_soon_and_keeps_what_was_yielded():
    program = (
        "import numpy as np, motionrecover as m\n"
        "chain = m.Skeleton('abc', [(0, 1), (1, 2)])\n"
        "clip = m.Motion(np.random.default_rng(0).normal(size=(40, 3, 3)), chain, 30.0)\n"
        "for outcome in m.recover_many(clip for _ in range(10**6)):\n"
        "    print(outcome.index, flush=True)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    lines = [process.stdout.readline() for _ in range(3)]
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=20)
    assert lines == ["0\n", "1\n", "2\n"]
    assert "KeyboardInterrupt" in error
