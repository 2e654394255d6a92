"""One clip of a batch, from its file to its answer and its record. This is what an executor calls, anywhere."""

from __future__ import annotations

import errno
import os
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from motionrecover import __version__, files, programs
from motionrecover.batch.jobs import Job
from motionrecover.batch.manifest import DONE, FAILED, Record
from motionrecover.intake import fill
from motionrecover.io import format_of, save
from motionrecover.io.bvh_out import posed
from motionrecover.recovery import RecoveryError, recover
from motionrecover.report import account, write_report

FULL = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True)
class Settings:
    """How every clip of a batch is read, recovered and reported on."""

    preset: str = "robust"
    bone_lengths: files.BoneLengths = "auto"
    """See `files.take_in`."""
    recovery: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of `recover`: max_gap, dtype, ..."""
    reading: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of `io.load`; a skeleton as its name or the path of its file."""
    report: bool = False
    """Whether to write a page on each."""
    programs: str | None = None
    """Folder where compiled programs are kept for all processes."""

    @property
    def parameters(self) -> dict[str, Any]:
        """What an answer depends on besides its clip, as JSON has it."""
        skeleton = self.reading.get("skeleton")
        file = {"skeleton_sha256": files.sha256(skeleton)} if skeleton and os.path.isfile(skeleton) else {}
        given = {"preset": self.preset, "bone_lengths": self.bone_lengths, **self.recovery, **self.reading, **file}
        return {name: value for name, value in given.items() if value is not None}


class DiskFull(OSError):
    """There is no room for an answer."""


def recover_clip(settings: Settings, folder: str, job: Job) -> Record:
    """Recover one clip, write its answer into `folder`, and return the record without its parameters.

    Whatever is wrong with the clip becomes a record with the reason; raises `DiskFull` alone.
    """
    if settings.programs is not None:
        programs.keep_in(Path(settings.programs))
    start = time.perf_counter()
    record = begun(job)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            record |= sources(job, settings)
            record |= _recovered(settings, Path(folder), job, record["sha256"])
            record["status"] = DONE
        except Exception as error:  # one bad clip never stops the rest, not by a defect of ours either
            if getattr(error.__cause__ or error, "errno", None) in FULL:
                raise DiskFull(f"{error}") from error
            record |= {"status": FAILED, "reason": _reason(error)}
    notes = list(dict.fromkeys(" ".join(str(warning.message).split()) for warning in caught))
    took = round(time.perf_counter() - start, 3)
    process = {"pid": os.getpid(), "programs": programs.made()}
    return record | {"notes": notes, "process": process, "seconds": record.get("seconds", {}) | {"all": took}}


def begun(job: Job) -> Record:
    """The part of a record that is known beforehand."""
    return {"output": job.name, "input": job.source, "version": __version__}


def sources(job: Job, settings: Settings) -> Record:
    """What tells whether a clip is still the same: SHA-256 of its file, and of those that are read with it."""
    path = Path(job.source)
    found: Record = {"sha256": files.sha256(path)}
    known = format_of(path, settings.reading.get("format"))
    if known.beside is not None and (beside := known.beside(path)):
        found["beside"] = {os.path.relpath(other, path.parent): files.sha256(other) for other in beside}
    return found


def _recovered(settings: Settings, folder: Path, job: Job, digest: str) -> Record:
    """Answer and page of a clip, written, and what the record says about them."""
    as_bvh = job.format == "bvh"
    clip, kind, lengths = files.take_in(job.source, settings.bone_lengths, as_bvh=as_bvh, **settings.reading)
    masks = {"observed": clip.observed, "confidence": clip.confidence, "fps": clip.fps}
    given = {"preset": settings.preset, "bone_lengths": lengths, **settings.recovery}
    recovery = recover(clip.positions, clip.skeleton, **masks, **given)
    answer = files.answer(clip, recovery, settings.preset, digest)
    written = posed(answer) if as_bvh else answer
    path, page = folder / job.name, folder / job.report
    path.parent.mkdir(parents=True, exist_ok=True)
    # The answer comes last: where it is, all is.
    if settings.report:
        shown = {"preset": settings.preset, "bone_lengths": kind, **settings.recovery}
        write_report(clip, recovery, page, title=Path(job.source).name, settings=shown, overwrite=True)
    else:
        page.unlink(missing_ok=True)  # of an earlier answer
    save(written, path, format=job.format, overwrite=True)
    off = account.measures(
        {"before": fill(account.measured(clip)), "after": answer.positions}, clip.skeleton, recovery.bone_lengths
    )
    moved = account.moved(clip, recovery)
    moved = moved[np.isfinite(moved)]
    found = account.verdict(recovery)
    return {
        "report": job.report if settings.report else None,
        "bytes": path.stat().st_size,
        "frames": len(clip),
        "joints": len(clip.names),
        "converged": found["converged"],
        "message": found["message"],
        "steps": found["steps"],
        "samples": account.changes(recovery)["samples"],
        "moved_mm": _number(1000 * moved.mean() if moved.size else np.nan),
        "bone_length_deviation_mm": {name: _number(value) for name, value in off["bone_length_deviation_mm"].items()},
        "seconds": {name: round(value, 3) for name, value in found["seconds"].items()},
    }


def _number(value: float) -> float | None:
    """Four significant digits; None where there is no number."""
    return float(f"{value:.4g}") if np.isfinite(value) else None


def _reason(error: Exception) -> str:
    """An error as one sentence; one that is no word on the clip says its kind."""
    expected = isinstance(error, ValueError | OSError | MemoryError | RecoveryError | ImportError)
    return " ".join(f"{'' if expected else type(error).__name__ + ': '}{error}".split())
