"""Writing a file so that nobody ever finds half of it."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_TEMPORARY = re.compile(r"\.[0-9a-f]{16}(\..*)?")


@contextmanager
def write_beside(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """An empty temporary file in the folder of `path`, with its suffix, that takes its name when the block ends well.

        with write_beside("walk.npz") as temporary:
            np.savez(temporary, ...)

    When the block fails, `path` is as it was and the temporary file is gone. A link is followed, not replaced.

    Raises `FileExistsError` when `path` exists and `overwrite` is false, and `OSError` when its folder does not exist
    or cannot be written to or the disk is full: each with one sentence that names `path`.
    """
    path = Path(path)
    if os.path.isdir(path):
        raise IsADirectoryError(f"{path} is a folder: give the name of a file in it")
    if os.path.exists(path) and not overwrite:
        raise FileExistsError(
            f"{path} exists already: choose another name, or replace it with overwrite=True (--overwrite)"
        )
    target = Path(os.path.realpath(path))
    if not os.path.isdir(target.parent):
        raise FileNotFoundError(f"{path} cannot be written: there is no folder {target.parent}, create it first")
    temporary = target.with_name(f".{secrets.token_hex(8)}{target.suffix[:32]}")
    try:
        # Opened plainly, not with tempfile, whose files only their owner may read.
        temporary.open("xb").close()
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        raise OSError(f"{path} could not be written: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def write_folder_beside(path: str | Path) -> Iterator[Path]:
    """An empty temporary folder that takes the name `path`, and the place of a folder there, when the block ends well.

    Raises `OSError` in one sentence as `write_beside` does.
    """
    path = Path(path)
    temporary, old = (path.with_name(f".{secrets.token_hex(8)}") for _ in range(2))
    try:
        temporary.mkdir()
        yield temporary
        with suppress(FileNotFoundError):
            os.replace(path, old)
        os.replace(temporary, path)
    except OSError as error:
        raise OSError(f"{path} could not be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def is_leftover(name: str) -> bool:
    """Whether a file or folder has the name of a temporary one."""
    return _TEMPORARY.fullmatch(name) is not None


def remove_leftovers(folder: str | Path) -> None:
    """Remove, from a folder and those below, the temporary files and folders of processes that were killed while they
    wrote.

    For a folder that no other process writes to.
    """
    for place, folders, names in os.walk(folder):
        for name in filter(is_leftover, names):
            Path(place, name).unlink(missing_ok=True)
        for name in filter(is_leftover, folders):
            shutil.rmtree(Path(place, name), ignore_errors=True)
