"""Many clips at once: as many at a time as there are processors, with few compiled programs, answers in order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from motionrecover.motion import Motion
from motionrecover.recovery import Recovery, RecoveryError, recover_motion
from motionrecover.threads import in_order, one_blas_thread, processors


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one of many clips."""

    index: int
    """Its place among the clips, from 0."""
    recovery: Recovery | None
    """With the verdict on this clip; None where there is no usable answer."""
    reason: str | None
    """Why there is no answer, in a sentence."""


def recover_many(clips: Iterable[Motion], *, workers: int | None = None, **settings: Any) -> Iterator[Outcome]:
    """The outcomes of `recover` for each clip, in order, each as soon as it and those before it are done.

    `clips` are read as they are needed and may be endless. `workers`: clips at a time; left out, one for each
    processor. `settings` are those of `recover` (preset, bone_lengths, max_gap, ...), the same for all; masks and rate
    come from the clip. A clip that cannot be recovered becomes an outcome with a reason, and the others go on. Ctrl-C
    ends it when the clips at hand are done, and what was yielded stays.

    The workers are threads: compiled programs let each other run, and a clip that takes more steps than others keeps
    only its own worker, which in one batched program would keep all. BLAS has one thread until the last outcome is out.
    An answer is that of `recover`.
    """
    workers = processors() if workers is None else workers
    if workers < 1:
        raise ValueError(f"received {workers} workers: give at least 1")
    return _outcomes(clips, workers, settings)


def _outcomes(clips, workers, settings):
    with one_blas_thread():
        yield from in_order(lambda item: _outcome(*item, settings), enumerate(clips), workers)


def _outcome(index, clip, settings):
    """One clip's; only what a clip can be guilty of is caught."""
    try:
        recovery = recover_motion(clip, **settings)
    except (ValueError, RecoveryError) as error:
        return Outcome(index, None, str(error))
    return Outcome(index, recovery, None)
