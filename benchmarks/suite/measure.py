"""Runs and their scores: one clip under one seed for every method, and the means over many."""

from __future__ import annotations

import statistics
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from benchmarks.suite import clips, methods
from benchmarks.suite.clips import Clip
from benchmarks.suite.methods import Method
from benchmarks.suite.rows import Row
from motionrecover import metrics

UNITS = {"missing": "mm", "all": "mm", "observed": "mm", "bone": "mm", "acceleration": "1"}
"""The scores: mean joint error over missing, all and observed samples, mean error of the length of the bones that are
rigid, and mean acceleration over that of the truth. NaN where there is nothing to count."""


@dataclass(frozen=True)
class Run:
    """One method on one clip under one seed. `failure` says why there are no scores."""

    row: str
    method: str
    clip: str
    scores: dict[str, float]
    seconds: float
    failure: str = ""


@dataclass(frozen=True)
class Task:
    """One clip under one seed, for rows that differ in what our methods may know and in nothing else."""

    rows: tuple[Row, ...]
    clip: str
    seed: int


def tasks(folder: Path, rows: Sequence[Row], count: int, seeds: int) -> tuple[list[Task], dict[str, int]]:
    """The tasks of all rows, and for each row how many recordings are too short for it."""
    shared: dict[tuple, list[Row]] = {}
    for row in rows:
        shared.setdefault((row.protocol, row.skeleton, row.fps, row.subjects), []).append(row)
    found, short = [], {}
    for (_, skeleton, fps, subjects), group in shared.items():
        row = group[0]
        names, too_short = clips.pick(folder, skeleton, fps, count, subjects, row.frames)
        short |= {member.name: too_short for member in group}
        for name in names:
            found += [Task(tuple(group), name, seed) for seed in range(seeds if row.seeded else 1)]
    return found, short


def perform(folder: Path, task: Task, names: Sequence[str]) -> list[Run]:
    """The runs of the named methods. A peer, which uses no bone lengths, runs once for all rows of the task."""
    first = task.rows[0]
    clip = clips.read(folder, task.clip, first.skeleton, first.fps)
    data = first.corrupted(clip, task.seed)
    runs = []
    for name in names:
        method = methods.METHODS[name]
        for row in task.rows if method.ours else task.rows[:1]:
            lengths = clip.bone_lengths if row.bones == "known" else None
            scores, seconds, failure = attempt(method, data, clip, lengths)
            members = [row] if method.ours else task.rows
            runs += [Run(member.name, name, task.clip, scores, seconds, failure) for member in members]
    return runs


def attempt(
    method: Method, data: np.ndarray, clip: Clip, lengths: np.ndarray | None
) -> tuple[dict[str, float], float, str]:
    """Scores, seconds and the reason of a failure: an exception, or an answer that is not finite everywhere.

    A call in which JAX compiled anything is made a second time, and that one is timed: which programs a clip needs
    depends on its length, on joints that coincide or are never seen, and on which bones it shows to be rigid.
    """
    try:
        for _ in range(2):
            compiled, start = len(_compiled), time.perf_counter()
            answer = method.run(data.copy(), clip, lengths)
            seconds = time.perf_counter() - start
            if len(_compiled) == compiled:
                break
    # Whatever a method raises is a result of the suite.
    except Exception as error:
        return {}, float("nan"), f"{type(error).__name__}: {error}"
    lost = int((~np.isfinite(answer).all(-1)).sum()) if np.shape(answer) == data.shape else answer.size
    if lost:
        return {}, seconds, f"some samples of the answer are not finite numbers of shape {data.shape[1:]}"
    return score(answer, data, clip), seconds, ""


_compiled: list[float] = []
"""Seconds of every compilation in this process."""


def _note(event: str, seconds: float, **_: str | int) -> None:
    if event == "/jax/core/compile/backend_compile_duration":
        _compiled.append(seconds)


jax.monitoring.register_event_duration_secs_listener(_note)


def score(answer: np.ndarray, data: np.ndarray, clip: Clip) -> dict[str, float]:
    """Every score of `UNITS` for an answer to the corrupted data."""
    missing = np.any(np.isnan(data), axis=-1)
    return {
        "missing": 1000 * metrics.aje(answer, clip.positions, missing),
        "all": 1000 * metrics.aje(answer, clip.positions),
        "observed": 1000 * metrics.aje(answer, clip.positions, ~missing),
        "bone": 1000 * metrics.abe(answer, clip.positions, clip.rigid),
        "acceleration": metrics.acceleration_ratio(answer, clip.positions),
    }


def summarise(runs: Sequence[Run], rows: Sequence[Row], short: dict[str, int]) -> dict:
    """The results by row and method.

    A score is its mean over the runs that have one, and the standard error of that over clips, each of which counts
    once with its mean over seeds: seeds of one clip are no independent witnesses.
    """
    table = {}
    for row in rows:
        of_row = [run for run in runs if run.row == row.name]
        table[row.name] = {
            "headline": row.headline,
            "clips": sorted({run.clip for run in of_row}),
            "too_short": short[row.name],
            "methods": {
                name: _summary([run for run in of_row if run.method == name])
                for name in dict.fromkeys(run.method for run in of_row)
            },
        }
    return table


def _summary(runs: Sequence[Run]) -> dict:
    fine = [run for run in runs if not run.failure]
    seconds = [run.seconds for run in fine]
    return {
        "runs": len(runs),
        "failures": len(runs) - len(fine),
        "reasons": dict(Counter(run.failure for run in runs if run.failure)),
        "seconds": round(statistics.median(seconds), 4) if seconds else None,
        "scores": {name: _mean([(run.clip, run.scores[name]) for run in fine]) for name in UNITS},
    }


def _mean(values: Sequence[tuple[str, float]]) -> dict[str, float | None]:
    """Mean, and standard error over the clips, of the values that are numbers; None for what there is not."""
    by_clip: dict[str, list[float]] = {}
    for clip, value in values:
        if np.isfinite(value):
            by_clip.setdefault(clip, []).append(value)
    means = [statistics.fmean(group) for group in by_clip.values()]
    error = statistics.stdev(means) / len(means) ** 0.5 if len(means) > 1 else None
    every = [value for group in by_clip.values() for value in group]
    return {
        "mean": round(statistics.fmean(every), 4) if every else None,
        "error": None if error is None else round(error, 4),
    }
