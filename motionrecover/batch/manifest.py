"""The manifest: one JSON line a clip, only ever appended to; of several lines on one answer the last one holds.

A line is on the disk before the next clip is counted. The half of a line that a crash leaves at the end is cut off when
the file is opened, and anything else that is no record is passed over.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

Record = dict[str, Any]
DONE, FAILED = "done", "failed"
"""What `status` of a record says."""


class Manifest:
    """An open manifest. In memory it keeps the name and the place of each line that holds, no records."""

    def __init__(self, path: Path):
        self._file = path.open("ab", buffering=0)
        self._reader = path.open("rb")
        self._place: dict[str, int] = {}
        self._end = 0
        for line in self._reader:
            if not line.endswith(b"\n"):
                self._file.truncate(self._end)
                break
            record = _record(line)
            if record is not None:
                self._place[record["output"]] = self._end
            self._end += len(line)

    def __enter__(self) -> Manifest:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._reader.close()

    def find(self, name: str) -> Record | None:
        """The record that holds for the answer of this name."""
        return self._at(self._place[name]) if name in self._place else None

    def records(self) -> Iterator[Record]:
        """All that hold, in the order of their lines."""
        yield from map(self._at, sorted(self._place.values()))

    def append(self, record: Record) -> None:
        """Add a line, wholly or, where that fails (`OSError`), not at all."""
        line = json.dumps(record, allow_nan=False).encode("ascii") + b"\n"
        try:
            if self._file.write(line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(self._end)
            raise
        self._place[record["output"]] = self._end
        self._end += len(line)

    def _at(self, place: int) -> Record:
        self._reader.seek(place)
        return json.loads(self._reader.readline())


def _record(line: bytes) -> Record | None:
    try:
        record = json.loads(line)
    except ValueError:
        return None
    if not isinstance(record, dict) or record.get("status") not in (DONE, FAILED):
        return None
    return record if isinstance(record.get("output"), str) else None
