"""BLAS has one thread while somebody asks for that, and as many as before afterwards."""

from concurrent.futures import ThreadPoolExecutor

import scipy.linalg  # noqa: F401  the second BLAS
from helpers import clip, hit
from threadpoolctl import threadpool_info, threadpool_limits

from motionrecover import Motion, Skeleton, recover_many
from motionrecover.threads import one_blas_thread

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
