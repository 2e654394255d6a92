"""One clip of a batch, from its file to its answer and its record. This is what an executor calls, anywhere."""

from __future__ import annotations

import errno
import os
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from motionrecover import __version__, files, programs
from motionrecover.batch import remote, stores
from motionrecover.batch.facts import facts_of
from motionrecover.batch.jobs import STORE, Job
from motionrecover.batch.lock import Claim, Locked
from motionrecover.batch.manifest import DONE, FAILED, Record
from motionrecover.io import format_of, save
from motionrecover.io.atomic import write_folder_beside
from motionrecover.io.bvh_out import posed
from motionrecover.recovery import RecoveryError, recover_motion
from motionrecover.report import write_report

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


def recover_clip(settings: Settings, folder: str, claim: Claim | None, job: Job) -> Record:
    """Recover one clip, write its answer into `folder`, a URL perhaps, and return the record without its parameters.

    Whatever is wrong with the clip becomes a record with the reason. Raises `DiskFull`, and `Locked` without a word
    written where the folder is no longer the batch's by `claim`.
    """
    if claim is not None:
        claim.check()
    if settings.programs is not None:
        with suppress(OSError):  # on another machine, perhaps, where nobody has such a folder
            programs.keep_in(Path(settings.programs))
    start = time.perf_counter()
    record = begun(job)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        path = Path(job.source)
        try:
            record |= stamped(job, settings)
            with remote.fetched(job.source, settings.reading.get("format")) as path:
                record |= sources(path, settings)
                make = _recovered_take if job.format == STORE else _recovered
                record |= make(settings, path, folder, claim, job, record["sha256"])
            record["status"] = DONE
        except Locked:
            raise
        except Exception as error:  # one bad clip never stops the rest, not by a defect of ours either
            if getattr(error.__cause__ or error, "errno", None) in FULL:
                raise DiskFull(f"{error}") from error
            record |= {"status": FAILED, "reason": _reason(error).replace(os.fspath(path), job.source)}
    notes = list(dict.fromkeys(" ".join(str(warning.message).split()) for warning in caught))
    took = round(time.perf_counter() - start, 3)
    process = {"pid": os.getpid(), "programs": programs.made()}
    return record | {"notes": notes, "process": process, "seconds": record.get("seconds", {}) | {"all": took}}


def begun(job: Job) -> Record:
    """The part of a record that is known beforehand."""
    return {"output": job.name, "input": job.source, "version": __version__}


def sources(path: Path, settings: Settings) -> Record:
    """What tells whether a clip is still the same: SHA-256 of its file or group, and of files that are read with it."""
    found: Record = {"sha256": files.sha256(path)}
    if path.is_dir():
        return found
    known = format_of(path, settings.reading.get("format"))
    if known.beside is not None and (beside := known.beside(path)):
        found["beside"] = {os.path.relpath(other, path.parent): files.sha256(other) for other in beside}
    return found


def stamped(job: Job, settings: Settings) -> Record:
    """The stamp of a clip at a URL, which tells the same without fetching it."""
    return {"stamp": remote.stamp(job.source, settings.reading.get("format"))} if remote.is_url(job.source) else {}


def same(job: Job, settings: Settings, record: Record) -> bool:
    """Whether a clip is the one of this record. Raises as reading it does."""
    if remote.is_url(job.source):
        return stamped(job, settings) == {"stamp": record.get("stamp")}
    found = sources(Path(job.source), settings)
    return found == {name: record[name] for name in ("sha256", "beside") if name in record}


def _recovered(
    settings: Settings, source: Path, folder: str, claim: Claim | None, job: Job, digest: str
) -> dict[str, Any]:
    """Answer and page of a clip, written, and what the record says about them."""
    as_bvh = job.format == "bvh"
    clip, kind, lengths = files.take_in(source, settings.bone_lengths, as_bvh=as_bvh, **settings.reading)
    recovery = recover_motion(clip, preset=settings.preset, bone_lengths=lengths, **settings.recovery)
    answer = files.answer(clip, recovery, settings.preset, digest)
    written = posed(answer) if as_bvh else answer
    if claim is not None:
        claim.check()
    # The answer comes last: where it is, all is.
    with remote.delivered(folder, [job.report, job.name]) as place:
        path, page = place / job.name, place / job.report
        path.parent.mkdir(parents=True, exist_ok=True)
        if settings.report:
            shown = {"preset": settings.preset, "bone_lengths": kind, **settings.recovery}
            write_report(clip, recovery, page, title=source.name, settings=shown, overwrite=True)
        else:
            page.unlink(missing_ok=True)  # of an earlier answer
        save(written, path, format=job.format, overwrite=True)
        size = path.stat().st_size
    report = job.report if settings.report else None
    return {"report": report, "bytes": size} | facts_of(clip, recovery, answer.positions)


def _recovered_take(
    settings: Settings, source: Path, folder: str, claim: Claim | None, job: Job, digest: str
) -> dict[str, Any]:
    """The same for a take of a Zarr store, which has no page."""
    path = Path(folder, job.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with write_folder_beside(path) as place:
        given = settings.preset, settings.bone_lengths, settings.recovery, settings.reading
        facts = stores.recover_take(source, place, *given, digest)
        if claim is not None:
            claim.check()
    stores.make_groups(folder, job.name, source)
    return {"report": None, "bytes": remote.size(folder, job.name)} | facts


def _reason(error: Exception) -> str:
    """An error as one sentence; one that is no word on the clip says its kind."""
    expected = isinstance(error, ValueError | OSError | MemoryError | RecoveryError | ImportError)
    return " ".join(f"{'' if expected else type(error).__name__ + ': '}{error}".split())
