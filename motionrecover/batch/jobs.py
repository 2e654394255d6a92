"""Which files a batch reads, and where each answer goes; whatever must not be read or written is refused here."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path, PurePath

from motionrecover.io import MotionFormatError, format_of, formats

MANIFEST, INDEX, LOCK = "manifest.jsonl", "index.html", "batch.lock"
"""What a batch keeps in its output folder beside the answers."""
READ_ONLY_TO = "npz"
"""Format of answers to files whose own format is not written."""
_LISTS = (".txt", ".list")


@dataclass(frozen=True, slots=True)
class Job:
    """One clip to recover."""

    source: str
    """The file to read."""
    name: str
    """Of the answer, below the output folder, with slashes."""
    format: str
    """Of the answer."""

    @property
    def report(self) -> str:
        """Name of the page on it."""
        return f"{self.name}.html"


def plan(
    sources: Iterable[str | Path], folder: str | Path, *, format: str | None = None, to: str | None = None
) -> list[Job]:
    """The jobs of a batch into `folder`, in order.

    A source is a folder (all files below it whose ending is that of a format that is read), a pattern (`*`, `?`, `[]`,
    and `**` for folders of any depth), a list (`.txt` or `.list`: a file a line, from the folder of the list; `#` for
    comments), or a file. Answers have the path of their clip below the folder, the part of the pattern before its first
    wildcard, or the folder of the list. They have the format of their clip, or `READ_ONLY_TO`, or the one named `to`.
    `format` is that of all clips, if their ending does not tell it.

    Raises `ValueError` for sources that give nothing, for a source folder and an output folder of which one lies in
    the other, for names that lead out of the output folder, and for two clips with one answer.
    """
    writable = {known.name: known for known in formats() if known.writes}
    if to is not None and to not in writable:
        raise ValueError(f"received {to!r} as the format of the answers: give one of {', '.join(writable)}")
    root = os.path.realpath(folder)
    for kept in (MANIFEST, INDEX, LOCK):
        _refuse_link(root, kept, folder)
    jobs: dict[str, Job] = {}
    for source in map(str, sources):
        before = len(jobs)
        for path, name in _clips(source, root, folder):
            job = _job(path, name, format, to)
            if _inside(os.path.realpath(path), root):
                raise ValueError(f"{path} lies in the output folder {folder}: a batch would read its own answers there")
            _refuse_link(root, job.name, folder)
            _refuse_link(root, job.report, folder)
            other = jobs.setdefault(os.path.normcase(job.name), job)
            if other.source != job.source:
                raise ValueError(
                    f"{other.source} and {job.source} would both be written to {job.name}: batch them into two folders"
                )
        if len(jobs) == before and not os.path.isfile(source):
            raise ValueError(f"{source} gives no motion file that is not already in the batch: check its name")
    return list(jobs.values())


def _clips(source: str, root: str, folder: str | Path) -> Iterator[tuple[str, str]]:
    """Each file of a source, and its path below the source."""
    if os.path.isdir(source):
        _refuse_overlap(source, (*_parts(source), "**"), root, folder)
        endings = {ending for known in formats() if known.reads for ending in known.suffixes} - {".asf"}
        for place, folders, names in os.walk(source):
            folders.sort()
            for name in sorted(names):
                if os.path.splitext(name)[1].lower() in endings and not name.startswith("."):
                    path = os.path.join(place, name)
                    yield path, os.path.relpath(path, source)
    elif not os.path.exists(source) and glob.has_magic(source):
        fixed = PurePath(*_before_wildcard(PurePath(source).parts))
        _refuse_overlap(source, _parts(source), root, folder)
        for path in sorted(glob.iglob(source, recursive=True)):
            if os.path.isfile(path):
                yield path, os.path.relpath(path, fixed)
    elif not os.path.isfile(source):
        raise ValueError(f"{source} is no file, folder or pattern: check its name")
    elif os.path.splitext(source)[1].lower() in _LISTS:
        yield from _listed(source)
    else:
        yield source, os.path.basename(source)


def _listed(source: str) -> Iterator[tuple[str, str]]:
    """The files of a list."""
    beside = os.path.dirname(source)
    text = Path(source).read_text(encoding="utf-8-sig", errors="surrogateescape")
    for number, line in enumerate(text.splitlines(), 1):
        name = line.strip()
        if not name or name.startswith("#"):
            continue
        if os.path.isabs(name) or ".." in PurePath(name).parts:
            raise ValueError(
                f"{source}, line {number}: received {name!r}, whose answer would lie outside the output folder: "
                "give paths below the folder of the list"
            )
        yield os.path.join(beside, name), os.path.normpath(name)


def _job(path: str, name: str, format: str | None, to: str | None) -> Job:
    """The job of a file; one of no known format becomes one too, and fails with the reason."""
    if ".." in PurePath(name).parts:
        raise ValueError(f"{path} would be written outside the output folder: name it without '..'")
    try:
        read = format_of(path, format)
        own = read.name if read.writes else READ_ONLY_TO
    except MotionFormatError:
        own = READ_ONLY_TO
    written = next(known for known in formats() if known.name == (to or own))
    ending = os.path.splitext(name)[1]
    # csv-long is told by name only.
    endings = written.suffixes or (".csv",)
    target = name if ending.lower() in endings else name.removesuffix(ending) + endings[0]
    return Job(path, PurePath(target).as_posix(), written.name)


def _refuse_overlap(source: str, pattern: tuple[str, ...], root: str, folder: str | Path) -> None:
    """Refuse a source that finds files in the output folder, or that lies in it."""
    where = PurePath(*_before_wildcard(pattern))
    if _finds(pattern, PurePath(root).parts) or _inside(os.path.realpath(where), root):
        raise ValueError(
            f"{source} and the output folder {folder} lie in each other, so a batch would read its own answers: "
            "choose an output folder beside it"
        )


def _refuse_link(root: str, name: str, folder: str | Path) -> None:
    """Refuse a name that links lead elsewhere."""
    path = os.path.join(root, name)
    if os.path.realpath(path) != os.path.normpath(path):
        raise ValueError(
            f"{os.path.join(folder, name)} is or lies behind a link to {os.path.realpath(path)}: "
            "take the link away or choose another output folder"
        )


def _finds(pattern: Sequence[str], folder: Sequence[str]) -> bool:
    """Whether files in this folder, or below it, can match the pattern."""
    if not folder or not pattern:
        return bool(pattern)
    if pattern[0] == "**":
        return True
    return fnmatchcase(folder[0], pattern[0]) and _finds(pattern[1:], folder[1:])


def _parts(path: str) -> tuple[str, ...]:
    """Of the path from the root of the disk, links before the first wildcard followed."""
    parts = PurePath(path).parts
    fixed = _before_wildcard(parts)
    start = os.path.realpath(PurePath(*fixed))
    return (*PurePath(start).parts, *parts[len(fixed) :])


def _before_wildcard(parts: Sequence[str]) -> tuple[str, ...]:
    first = next((k for k, part in enumerate(parts) if glob.has_magic(part)), len(parts))
    return tuple(parts[:first])


def _inside(path: str, root: str) -> bool:
    return path == root or path.startswith(os.path.join(root, ""))
