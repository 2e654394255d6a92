"""BLAS has one thread while somebody asks for that, and as many as before afterwards; work side by side keeps order."""

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  the second BLAS
from helpers import clip, hit
from threadpoolctl import threadpool_info, threadpool_limits

from motionrecover import PRESETS, Motion, Skeleton, recover, recover_many
from motionrecover.threads import BLAS_THREADS, in_order, one_blas_thread

CHAIN = Skeleton("abc", [(0, 1), (1, 2)])


def counts():
    return [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]


def inside():
    with one_blas_thread():
        return counts()


def test_who_holds_it_keeps_it_for_all_threads():
    with threadpool_limits(2, user_api="blas"):
        before = counts()
        assert 2 in before
        with one_blas_thread():
            with ThreadPoolExecutor(1) as pool:
                assert set(pool.submit(inside).result()) == {1}
            assert set(counts()) == {1}
        assert counts() == before


def test_many_clips_have_it_from_the_first_to_the_last():
    clips = [Motion(hit(clip(CHAIN, 20, seed), 0.1, seed), CHAIN, fps=60.0) for seed in range(3)]
    with threadpool_limits(2, user_api="blas"):
        before = counts()
        during = [set(counts()) for _ in recover_many(clips, workers=2, max_steps=2)]
        assert during == 3 * [{1}]
        assert counts() == before


def test_answers_come_in_order_from_as_many_threads_as_are_asked_for():
    meet = threading.Barrier(3, timeout=10)

    def late(k):
        meet.wait()  # three at a time, or nobody gets on
        time.sleep(0.01 * (3 - k % 3))
        return k, threading.get_ident()

    answers = list(in_order(late, range(9), 3))
    assert [k for k, _ in answers] == list(range(9))
    assert len({thread for _, thread in answers}) == 3


def test_an_error_arrives_and_nothing_more_begins():
    begun = []

    def broken(k):
        begun.append(k)
        if k == 1:
            raise MemoryError("no room")
        return k

    answers = in_order(broken, range(1000), 2)
    assert next(answers) == 0
    with pytest.raises(MemoryError, match="no room"):
        list(answers)
    assert len(begun) < 20


@pytest.mark.parametrize("name", ["robust", "str_yang2020"])
def test_windows_side_by_side_give_the_answer_of_one_after_another(name):
    preset = replace(PRESETS[name], window=30, overlap=8, max_steps=20)
    data = hit(clip(CHAIN, 100, 0), 0.1, 0)
    one, four = (recover(data, CHAIN, preset=preset, fps=60.0, workers=workers) for workers in (1, 4))
    np.testing.assert_array_equal(one.positions, four.positions)
    assert one.steps == four.steps


def test_no_workers_are_refused(refused):
    refused(lambda: recover(clip(CHAIN, 30, 0), CHAIN, workers=0), "0 workers", error=ValueError)


@pytest.mark.parametrize("asked", ["1", "2"])
def test_scipy_comes_with_one_thread_or_is_told(asked):
    """What the environment says when it is loaded counts; where that is 1, it is not loaded to be told."""
    code = """
import sys
from threadpoolctl import threadpool_info
from motionrecover.threads import one_blas_thread
with one_blas_thread():
    print("scipy" in sys.modules)
    import scipy.linalg
    print({each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"})
"""
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, BLAS_THREADS: asked},
        check=True,
        capture_output=True,
        text=True,
    )
    assert found.stdout.splitlines() == [str(asked != "1"), "{1}"]
