"""Which files a batch reads, and where each answer goes; whatever must not be read or written is refused here."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path, PurePath

from motionrecover.batch import remote, stores
from motionrecover.io import MotionFormatError, format_of, formats

MANIFEST, INDEX, LOCK = "manifest.jsonl", "index.html", "batch.lock"
"""What a batch keeps in its output folder beside the answers."""
READ_ONLY_TO = "npz"
"""Format of answers to files whose own format is not written."""
STORE = "zarr"
"""Format of takes in Zarr stores and of their answers."""
_LISTS = (".txt", ".list")


@dataclass(frozen=True, slots=True)
class Job:
    """One clip to recover."""

    source: str
    """The file to read, or the group of a store: its path or its URL."""
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
    `format` is that of all clips, if their ending does not tell it. A folder that ends in .zarr is a store: each take
    in it is a clip, and its answer one in a store of the same name (`stores`). Folders, patterns, files and the output
    folder can be named by URLs (`remote`), stores and lists cannot.

    Raises `ValueError` for sources that give nothing, for a source folder and an output folder of which one lies in
    the other, for names that lead out of the output folder, and for two clips with one answer.
    """
    writable = {known.name: known for known in formats() if known.writes}
    if to is not None and to not in writable:
        raise ValueError(f"received {to!r} as the format of the answers: give one of {', '.join(writable)}")
    folder = remote.local(folder)
    root = None if remote.is_url(folder) else os.path.realpath(folder)
    for kept in (MANIFEST, INDEX, LOCK):
        _refuse_link(root, kept, folder)
    jobs: dict[str, Job] = {}
    for source in map(remote.local, sources):
        before = len(jobs)
        for path, name in _takes(_clips(source, root, folder)):
            job = _job(path, name, format, to)
            if root is None and job.format == STORE:
                raise ValueError(f"{path} is in a store and {folder} a URL: answers in stores are written to folders")
            if root is not None and not remote.is_url(path) and _inside(os.path.realpath(path), root):
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


def _clips(source: str, root: str | None, folder: str) -> Iterator[tuple[str, str]]:
    """Each file or store of a source, and its path below the source."""
    if remote.is_url(source):
        yield from _remote_clips(source, folder)
    elif os.path.isdir(source):
        _refuse_overlap(source, (*_parts(source), "**"), root, folder)
        if _is_store(source):
            yield source, os.path.basename(os.path.normpath(source))
            return
        for place, folders, names in os.walk(source):
            inside = sorted(filter(_is_store, folders))
            folders[:] = sorted(set(folders) - set(inside))
            for name in sorted([*inside, *filter(_is_motion, names)]):
                path = os.path.join(place, name)
                yield path, os.path.relpath(path, source)
    elif not os.path.exists(source) and glob.has_magic(source):
        fixed = PurePath(*_before_wildcard(PurePath(source).parts))
        _refuse_overlap(source, _parts(source), root, folder)
        for path in sorted(glob.iglob(source, recursive=True)):
            if os.path.isfile(path) or _is_store(path):
                yield path, os.path.relpath(path, fixed)
    elif not os.path.isfile(source):
        raise ValueError(f"{source} is no file, folder or pattern: check its name")
    elif os.path.splitext(source)[1].lower() in _LISTS:
        yield from _listed(source)
    else:
        yield source, os.path.basename(source)


def _remote_clips(source: str, folder: str) -> Iterator[tuple[str, str]]:
    """Each file at a URL, and its path below it."""
    if remote.is_url(folder) and remote.overlap(source, folder):
        raise _overlap(source, folder)
    for url, name in remote.found(source):
        *above, last = name.split("/")
        if any(map(_is_store, (source, *above))):
            raise ValueError(f"{url} is in a store: copy stores to a folder, they are not read at URLs")
        if _is_motion(last):
            # Object stores take any text for a name.
            if not all(above):
                raise ValueError(f"{url} would be written outside the output folder: name it without '//'")
            yield url, name


def _takes(clips: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Clips with their names, and for each store its takes."""
    for path, name in clips:
        if _is_store(path) and os.path.isdir(path):
            for take, below in stores.takes(path):
                yield take, os.path.normpath(os.path.join(name, below))
        else:
            yield path, name


def _is_store(name: str) -> bool:
    return os.path.normpath(name).endswith(stores.SUFFIX)


def _is_motion(name: str) -> bool:
    """Whether a file has the ending of a format that is read, and is not hidden."""
    endings = {ending for known in formats() if known.reads for ending in known.suffixes} - {".asf"}
    return os.path.splitext(name)[1].lower() in endings and not name.startswith(".")


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
    if os.path.isdir(path):
        return Job(path, PurePath(name).as_posix(), STORE)
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


def _refuse_overlap(source: str, pattern: tuple[str, ...], root: str | None, folder: str) -> None:
    """Refuse a source that finds files in the output folder, or that lies in it."""
    if root is None:
        return
    where = PurePath(*_before_wildcard(pattern))
    if _finds(pattern, PurePath(root).parts) or _inside(os.path.realpath(where), root):
        raise _overlap(source, folder)


def _overlap(source: str, folder: str) -> ValueError:
    return ValueError(
        f"{source} and the output folder {folder} lie in each other, so a batch would read its own answers: "
        "choose an output folder beside it"
    )


def _refuse_link(root: str | None, name: str, folder: str) -> None:
    """Refuse a name that links lead elsewhere."""
    if root is None:
        return
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
