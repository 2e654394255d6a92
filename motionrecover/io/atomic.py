"""Writing a file so that nobody ever finds half of it."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
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


def remove_leftovers(folder: str | Path) -> None:
    """Remove, from a folder and those below, the temporary files of processes that were killed while they wrote.

    For a folder that no other process writes to.
    """
    for place, _, names in os.walk(folder):
        for name in filter(_TEMPORARY.fullmatch, names):
            Path(place, name).unlink(missing_ok=True)
