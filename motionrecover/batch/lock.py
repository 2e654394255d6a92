"""One batch at a time in an output folder.

The lock is a file that names host, process and start of the batch that holds it, created where there is none. Its time
of change is its pulse. It is stale when its process is dead, told at once on the same host; on others when it had no
pulse for `STALE` seconds, by the clock of the folder's own disk. Of several batches that find a stale lock, one takes
it over. Should a file system betray that, a batch that finds another name in its lock writes no further record and
stops. Workers look there too before they write (`Claim`): those on other machines outlive the batch.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

PULSE, STALE = 10.0, 180.0
"""Seconds."""


class Locked(OSError):
    """Another batch writes to the folder: one sentence that names it."""


@dataclass(frozen=True)
class Claim:
    """What tells a worker, wherever it is, whether its batch still has the folder."""

    path: str
    content: str

    @property
    def held(self) -> bool:
        """Whether the lock is there and no other batch's."""
        return _read(self.path) == self.content

    def check(self) -> None:
        """Raise `Locked` unless it is held."""
        if not self.held:
            found = _read(self.path)
            if found is None:
                raise Locked(
                    f"{self.path} is not there on {socket.gethostname()}: its batch has ended, or the folder is not "
                    "shared with this machine"
                )
            raise Locked(f"{self.path} was taken over{_by(found)}: this batch stops, run it again later")


class Lock:
    """The lock `path` while the block runs. Raises `Locked` where another batch holds it."""

    def __init__(self, path: Path):
        self._path = path
        holder = {"host": socket.gethostname(), "pid": os.getpid(), "start": time.strftime("%Y-%m-%d %H:%M:%S %z")}
        # Another batch of this very process has another token.
        self.claim = Claim(os.fspath(path), json.dumps(holder | {"token": secrets.token_hex(8)}) + "\n")
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> Lock:
        self._take()
        self._thread.start()
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._ended.set()
        self._thread.join()
        if self.claim.held:
            self._path.unlink(missing_ok=True)

    def _take(self) -> None:
        if self._create() or self._take_over():
            return
        raise Locked(
            f"{self._path.parent} is in use{_by(_read(self._path))}: wait for it, or choose another output folder "
            f"(if that batch is gone for certain, delete {self._path})"
        )

    def _create(self) -> bool:
        """Create the lock where there is none."""
        try:
            self._path.touch(exist_ok=False)
        except FileExistsError:
            return False
        try:
            self._path.write_text(self.claim.content, encoding="utf-8")
        except OSError:
            self._path.unlink()
            raise
        return True

    def _take_over(self) -> bool:
        """Replace a stale lock. Only who creates the file beside it may remove the lock of another."""
        beside = self._path.with_name(f"{self._path.name}.next")
        if beside.exists() and self._age(beside) > STALE:
            beside.unlink(missing_ok=True)  # of one that died within these lines
        try:
            beside.touch(exist_ok=False)
        except FileExistsError:
            return False
        try:
            if self._stale():
                self._path.unlink(missing_ok=True)
            return self._create()
        finally:
            beside.unlink(missing_ok=True)

    def _stale(self) -> bool:
        holder = _parsed(_read(self._path))
        if os.name == "posix" and holder.get("host") == socket.gethostname() and isinstance(holder.get("pid"), int):
            return not _alive(holder["pid"])
        return self._age(self._path) > STALE

    def _age(self, path: Path) -> float:
        """Seconds since a file was changed, by the clock of its disk; 0 where it is gone."""
        now = self._path.with_name(f"{self._path.name}.{secrets.token_hex(8)}")
        now.touch()
        try:
            return now.stat().st_mtime - path.stat().st_mtime
        except FileNotFoundError:
            return 0.0
        finally:
            now.unlink()

    def _beat(self) -> None:
        while not self._ended.wait(PULSE) and self.claim.held:
            with suppress(OSError):
                os.utime(self._path)


def _read(path: str | Path) -> str | None:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _parsed(content: str | None) -> dict:
    try:
        holder = json.loads(content or "")
    except ValueError:
        return {}
    return holder if isinstance(holder, dict) else {}


def _by(content: str | None) -> str:
    """` by the batch of process 12 on this-host, started 2026-01-31 12:00:00 +0000`."""
    holder = _parsed(content)
    if not {"host", "pid", "start"} <= set(holder):
        return " by another batch"
    return f" by the batch of process {holder['pid']} on {holder['host']}, started {holder['start']}"
