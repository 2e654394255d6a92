"""What the machine allows: the bytes that an iteration must move, and the bandwidth at which they can be."""

import time

import numpy as np

ARRAYS = 23 + 1 / 3
"""Arrays of the size of D that an iteration must read or write. The singular value threshold needs the Gram matrix of
all of H before any of A, so there are two passes. The first reads D, A, N, W A, Z1, Z2, Z3 and w (one number a sample,
a third of an array), and writes N, E and H; the second reads H, D, A, N, W A, Z1, Z2, Z3, and writes A, W A, Z1, Z2,
Z3. The filters of W are taken to be fused with them, and all that is made on the way to stay in the cache."""


def bytes_moved(frames: int, joints: int, itemsize: int = 4) -> float:
    """Of one iteration."""
    return ARRAYS * 3 * joints * frames * itemsize


def bandwidth(frames: int, joints: int, seconds: float = 0.5) -> float:
    """Bytes a second of `np.copyto`, read and written, best of many.

    Between two blocks that together have the size of the eight arrays that an iteration keeps.
    """
    source = np.ones(4 * 3 * joints * frames, np.float32)
    target = np.zeros_like(source)
    best, end = np.inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        np.copyto(target, source)
        best = min(best, time.perf_counter() - start)
    return 2 * source.nbytes / best
