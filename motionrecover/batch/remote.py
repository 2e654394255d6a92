"""Sources and output folders that are named by URLs (`s3://bucket/takes`), through fsspec.

A clip is fetched into a temporary folder, with the files that are read with it, and recovered there. Its answer is sent
under a temporary name and then moved, so that it is there whole or not at all. What tells whether a file at a URL is
still the same is its stamp, fsspec's checksum of what its store says of it: nothing is fetched for that.

The manifest grows by lines, which object stores cannot, so it is written in a folder of the user's, one for each output
URL, with the lock and the index. It is sent when a batch ends, however it ends, and fetched where the local one is
shorter: another machine goes on there. The lock holds for the batches of a user on a machine.
"""

from __future__ import annotations

import os
import posixpath
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from motionrecover.io import atomic, format_of, write_beside
from motionrecover.programs import user_folder

_LOCAL = ("file://", "local://")


def is_url(name: str | Path) -> bool:
    """Whether a source or an output folder is named by a URL."""
    return "://" in str(name)


def local(name: str | Path) -> str:
    """The path that a URL of this machine's own files means; everything else as it is."""
    text = str(name)
    return _open(text)[1] if text.startswith(_LOCAL) else text


def overlap(one: str, other: str) -> bool:
    """Whether one of two URLs lies in the other, however they are spelled. Of a pattern the part before it counts."""
    (files, path), (others, folder) = (_open(re.split(r"[*?[]", url)[0]) for url in (one, other))
    a, b = f"{files.unstrip_protocol(path).rstrip('/')}/", f"{others.unstrip_protocol(folder).rstrip('/')}/"
    return a.startswith(b) or b.startswith(a)


def found(url: str) -> Iterator[tuple[str, str]]:
    """URL of each file that a folder, a pattern or a file means, and its name below the folder, as `jobs` has it."""
    files, path = _open(url)
    if files.isfile(path):
        yield url, posixpath.basename(path)
        return
    fixed, matches = path, files.find
    if wildcard := re.search(r"[*?[]", path):
        fixed, matches = posixpath.dirname(path[: wildcard.start()]), files.glob
    for match in sorted(matches(path)):
        yield files.unstrip_protocol(match), match.removeprefix(fixed).removeprefix("/")


def stamp(url: str, format: str | None) -> str:
    """What changes when a file does, or one that is read with it."""
    files, path = _open(url)
    return " ".join(str(files.checksum(each)) for each in _together(files, path, format))


@contextmanager
def fetched(source: str, format: str | None) -> Iterator[Path]:
    """The file of a job, on this machine while the block runs."""
    if not is_url(source):
        yield Path(source)
        return
    files, path = _open(source)
    with TemporaryDirectory(prefix="motionrecover-") as place:
        for each in _together(files, path, format):
            files.get_file(each, os.path.join(place, posixpath.basename(each)))
        yield Path(place, posixpath.basename(path))


def _together(files: Any, path: str, format: str | None) -> list[str]:
    """A file and those that its format reads with it."""
    together = [path]
    beside = format_of(posixpath.basename(path), format).beside
    if beside is not None:
        # Which they are, their names tell: empty files of these names are asked.
        folder = posixpath.dirname(path)
        with TemporaryDirectory(prefix="motionrecover-") as place:
            for name in map(posixpath.basename, files.ls(folder, detail=False)):
                Path(place, name).touch()
            together += sorted(f"{folder}/{other.name}" for other in beside(Path(place, posixpath.basename(path))))
    return list(dict.fromkeys(together))


@contextmanager
def delivered(folder: str, names: list[str]) -> Iterator[Path]:
    """A folder to write these files into; at a URL, what is there when the block ends well is sent, in their order."""
    if not is_url(folder):
        yield Path(folder)
        return
    with TemporaryDirectory(prefix="motionrecover-") as place:
        yield Path(place)
        for name in names:
            if (path := Path(place, name)).exists():
                _send(path, f"{folder}/{name}")
            else:
                _remove(f"{folder}/{name}")


def size(folder: str | Path, name: str) -> int | None:
    """Bytes of an answer in an output folder, which may be a folder itself; None where there is none."""
    if is_url(folder):
        files, path = _open(f"{folder}/{name}")
        return files.size(path) if files.isfile(path) else None
    path = Path(folder, name)
    if path.is_dir():
        return sum(each.stat().st_size for each in path.rglob("*") if each.is_file())
    return path.stat().st_size if path.is_file() else None


def home(folder: str | Path) -> Path:
    """Where a batch keeps manifest, index and lock."""
    folder = local(folder)
    if not is_url(folder):
        return Path(folder)
    return user_folder() / "batches" / sha256(str(folder).rstrip("/").encode()).hexdigest()[:16]


def fetch_kept(folder: str, name: str) -> None:
    """Replace a file of `home` by the one at the URL, where that is longer."""
    here = home(folder) / name
    if is_url(folder) and (size(folder, name) or 0) > (here.stat().st_size if here.exists() else 0):
        files, path = _open(f"{folder}/{name}")
        with write_beside(here, overwrite=True) as temporary:
            files.get_file(path, os.fspath(temporary))


def send_kept(folder: str, name: str) -> None:
    """Put a file of `home` to the URL."""
    if is_url(folder):
        _send(home(folder) / name, f"{folder}/{name}")


def first_file(folder: str, but: str) -> str | None:
    """Name of something in an output folder that does not begin with `but`; None where there is nothing."""
    if is_url(folder):
        files, path = _open(folder)
        names = map(posixpath.basename, files.find(path))
    else:
        names = sorted(os.listdir(folder))
    return next((name for name in names if not name.startswith(but)), None)


def remove_leftovers(folder: str) -> None:
    """Remove what writers that were killed left under temporary names."""
    if not is_url(folder):
        atomic.remove_leftovers(folder)
        return
    files, path = _open(folder)
    for each in files.find(path):
        if atomic.is_leftover(posixpath.basename(each)):
            with suppress(FileNotFoundError):
                files.rm_file(each)


def _send(path: Path, url: str) -> None:
    files, there = _open(url)
    beside = f"{posixpath.dirname(there)}/.{secrets.token_hex(8)}{path.suffix}"
    files.makedirs(posixpath.dirname(there), exist_ok=True)
    try:
        files.put_file(os.fspath(path), beside)
        files.mv(beside, there)
    except BaseException:
        _remove(files.unstrip_protocol(beside))
        raise


def _remove(url: str) -> None:
    files, path = _open(url)
    with suppress(FileNotFoundError):
        files.rm_file(path)


def _open(url: str) -> tuple[Any, str]:
    """File system and path of a URL. Raises `ValueError` for an unknown one, `ImportError` without its library."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise ImportError(f"{url} needs fsspec: pip install motionrecover[remote]") from error
    return url_to_fs(url)
