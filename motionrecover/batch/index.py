"""The index page: failures first, then the clips by how much of them was changed. One file that needs no network."""

from __future__ import annotations

import heapq
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from html import escape
from pathlib import Path
from urllib.parse import quote

from motionrecover.batch.manifest import DONE, FAILED, Manifest, Record
from motionrecover.io.atomic import write_beside
from motionrecover.io.border import counted

LISTED = 2000
"""Rows of a table: a browser takes no page of a million."""

_HEAD = """<!doctype html>
<html lang="en"><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width">
<title>motionrecover batch</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem; color: #222 }
table { border-collapse: collapse; width: 100% }
th, td { padding: .25rem .6rem; border-bottom: 1px solid #ddd; text-align: right; vertical-align: top }
th:first-child, td:first-child, td.words { text-align: left; overflow-wrap: anywhere }
th { position: sticky; top: 0; background: #fff }
@media (prefers-color-scheme: dark) { body, th { background: #181818; color: #ddd } a { color: #8bf } }
</style>
"""
_COLUMNS = ("clip", "changed", "repaired", "filled", "unknown", "moved mm", "bones vary by mm", "frames", "verdict")


def changed(record: Record) -> float:
    """Share of the samples of a clip that were repaired, filled or stay unknown."""
    samples = record["samples"]
    return (samples["repaired"] + samples["filled"] + samples["unknown"]) / max(sum(samples.values()), 1)


def write_index(path: Path, manifest: Manifest) -> None:
    """Write the page on all records of a manifest."""
    counts = Counter(record["status"] for record in manifest.records())
    done = heapq.nlargest(LISTED, _of(DONE, manifest), key=lambda record: (changed(record), record["moved_mm"] or 0))
    failed = heapq.nsmallest(LISTED, _of(FAILED, manifest), key=lambda record: record["input"])
    with write_beside(path, overwrite=True) as page, page.open("w", encoding="utf-8", errors="replace") as file:
        file.write(f"{_HEAD}<h1>{counted(counts.total(), 'clip')}</h1>\n")
        if failed:
            file.write(f"<h2>{counts[FAILED]} failed{_part(failed, counts[FAILED])}</h2>\n")
            rows = ((_text(record["input"]), _words(record["reason"])) for record in failed)
            _table(file, ("clip", "reason"), rows)
        file.write(f"<h2>{counts[DONE]} recovered{_part(done, counts[DONE])}</h2>\n")
        file.write("<p>Those first of which most samples were repaired, filled or stay unknown.</p>\n")
        _table(file, _COLUMNS, map(_row, done))


def _row(record: Record) -> tuple[str, ...]:
    samples, bones = record["samples"], record["bone_length_deviation_mm"]
    total = max(sum(samples.values()), 1)
    shares = (changed(record), *(samples[kind] / total for kind in ("repaired", "filled", "unknown")))
    return (
        _link(record["report"] or record["output"], record["output"]),
        *(_text(f"{100 * share:.2f} %") for share in shares),
        _text(_number(record["moved_mm"])),
        _text(f"{_number(bones['before'])} → {_number(bones['after'])}"),
        _text(str(record["frames"])),
        _words(record["message"]),
    )


def _of(status: str, manifest: Manifest) -> Iterator[Record]:
    return (record for record in manifest.records() if record["status"] == status)


def _table(file, head: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    file.write("<table><tr>" + "".join(f"<th>{title}</th>" for title in head) + "</tr>\n")
    for row in rows:
        file.write(f"<tr>{''.join(row)}</tr>\n")
    file.write("</table>\n")


def _text(text: str) -> str:
    return f"<td>{escape(text)}</td>"


def _words(text: str) -> str:
    return f'<td class="words">{escape(text)}</td>'


def _link(target: str, text: str) -> str:
    # ./ keeps a name with a colon from being taken for a scheme.
    return f'<td><a href="./{quote(os.fsencode(target))}">{escape(text)}</a></td>'


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _part(listed: list[Record], total: int) -> str:
    return "" if len(listed) == total else f", {len(listed)} of them listed (the manifest has all)"
