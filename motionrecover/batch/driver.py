"""The batch: what is still to do is given to the executor, what comes back is written down.

    done     the manifest has a record of the same input and parameters, and the answer is there with its size
    to do    everything else: new, changed, failed before, or at hand when the batch died

An answer is renamed into place before its record is appended. A batch that dies in between does the clip again, and
puts the same bytes in the same place.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from motionrecover.batch import remote
from motionrecover.batch.clip import FULL, DiskFull, Settings, begun, recover_clip, same
from motionrecover.batch.index import write_index
from motionrecover.batch.jobs import INDEX, LOCK, MANIFEST, STORE, Job
from motionrecover.batch.lock import Lock, Locked
from motionrecover.batch.manifest import DONE, FAILED, Manifest, Record
from motionrecover.batch.workers import Executor
from motionrecover.io import MotionFormatError

SHOWN = 20
"""Failures that are kept to be told at the end; the manifest has all."""


@dataclass
class Tally:
    """What a batch has done so far. Its size does not grow with the batch."""

    done: int = 0
    kept: int = 0
    """Clips that were done before."""
    failed: int = 0
    frames: int = 0
    samples: Counter[str] = field(default_factory=Counter)
    """By what happened to them, as in `robust.Change`."""
    failures: list[tuple[str, str]] = field(default_factory=list)
    """File and reason of the first `SHOWN`."""

    def add(self, record: Record) -> None:
        """Count a clip."""
        if record["status"] == DONE:
            self.done += 1
            self.frames += record["frames"]
            self.samples.update(record["samples"])
        else:
            self.failed += 1
            if len(self.failures) < SHOWN:
                self.failures.append((record["input"], record["reason"]))


def run(
    jobs: Sequence[Job],
    folder: str | Path,
    settings: Settings,
    executor: Executor,
    *,
    seen: Callable[[Tally], None] = lambda tally: None,
    overwrite: bool = False,
) -> Tally:
    """Recover what is still to do of the jobs into `folder`, and write manifest and index there.

    `seen` is called after each clip. `overwrite`: also into a folder with files that are no batch's.

    Raises `Locked` while another batch writes there, `FileExistsError` for a folder of other files, `ValueError` for
    pages on takes of stores, which have none, and `OSError` in one sentence when the disk is full. However it ends, the
    same call goes on.
    """
    if settings.report and (take := next((job for job in jobs if job.format == STORE), None)) is not None:
        raise ValueError(f"{take.source} is in a store, whose takes have no page: leave report out (--report)")
    folder = remote.local(folder)
    home = remote.home(folder)
    home.mkdir(parents=True, exist_ok=True)
    tally = Tally()
    with Lock(home / LOCK) as lock:
        remote.fetch_kept(folder, MANIFEST)
        _refuse_others(folder, home, overwrite)
        with Manifest(home / MANIFEST) as manifest:
            remote.remove_leftovers(folder)
            try:
                parameters = settings.parameters
                left = _left(jobs, folder, settings, parameters, manifest, tally, seen)
                work = partial(recover_clip, settings, folder, None if remote.is_url(folder) else lock.claim)
                with closing(executor(work, left)) as outcomes:
                    for job, found in outcomes:
                        lock.claim.check()
                        if isinstance(found, DiskFull | Locked):
                            raise found
                        if isinstance(found, Exception):
                            found = begun(job) | {"status": FAILED, "reason": str(found)}
                        record = found | {"parameters": parameters | {"to": job.format}}
                        manifest.append(record)
                        tally.add(record)
                        seen(tally)
            except OSError as error:
                if isinstance(error, DiskFull) or error.errno in FULL:
                    raise OSError(
                        f"the disk of {folder} is full, {tally.done + tally.kept} of {len(jobs)} clips are done: make "
                        "room and run the same batch again"
                    ) from error
                raise
            finally:
                if lock.claim.held:
                    remote.remove_leftovers(folder)
                    remote.send_kept(folder, MANIFEST)
            write_index(home / INDEX, manifest)
            remote.send_kept(folder, INDEX)
    return tally


def _left(jobs, folder, settings, parameters, manifest, tally, seen) -> Iterator[Job]:
    """The jobs that are to do; the others are counted."""
    for job in jobs:
        if _is_done(job, folder, settings, parameters, manifest.find(job.name)):
            tally.kept += 1
            seen(tally)
        else:
            yield job


def _is_done(job: Job, folder: str, settings: Settings, parameters: Record, record: Record | None) -> bool:
    if record is None or record["status"] != DONE or record["parameters"] != parameters | {"to": job.format}:
        return False
    try:
        if remote.size(folder, job.name) != record["bytes"] or not same(job, settings, record):
            return False
        return not settings.report or remote.size(folder, job.report) is not None
    except (OSError, MotionFormatError):
        return False


def _refuse_others(folder: str, home: Path, overwrite: bool) -> None:
    """Refuse a folder that holds files and no manifest."""
    if overwrite or (home / MANIFEST).is_file():
        return
    if (other := remote.first_file(folder, LOCK)) is not None:
        raise FileExistsError(
            f"{folder} holds {other} and no manifest of a batch: choose an empty folder, or replace files in it with "
            "overwrite=True (--overwrite)",
        )
