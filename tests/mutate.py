"""Damaged files: whole ones of every format that is read, seeded damage, and what must hold when such a file is read.

A file loads or is refused with one sentence; whatever loaded is written in every format, or refused likewise, and what
was written loads again.
"""

import io
import pickle
import re
import tracemalloc
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np

from motionrecover.io import MotionFormatError, MotionFormatWarning, formats, load, save
from motionrecover.motion import Motion
from tests.whole_files import Case

NUMBERS = (
    *(b"nan", b"-nan", b"inf", b"-inf", b"1e999", b"1e308", b"-1e308", b"1e39", b"1e-320", b"0", b"-0", b"-1", b"1e5"),
    *(b"65535", b"65536", b"2147483648", b"99999999999999999999", b"1" * 400, b"1_0", b"0x10", b"1,5", b"1.5.5"),
    *("٣".encode(), b"", b"3 4", b"1e", b"--1", b"9007199254740993", b"123456789"),
)
"""What takes the place of a number in text."""
PIECES = (
    *(b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\x80", "é".encode("latin-1"), b"\r", b"\n", b"\t", b";", b",", b'"', b"#"),
    *(b"{", b"}", b"[", b"]", b"\\", b"'", b":", b"  ", b"\x0c", "\u2028".encode(), b"\x1a", b"\x85"),
)
"""What is put anywhere."""
NESTS = (
    b"{",
    b"[",
    b"(",
    b'{"a":',
    b"-",
    b'"',
    b"JOINT a { OFFSET 0 0 0 ",
    b"End Site { OFFSET 1 1 1 } ",
    b"[[",
    b"a.",
)
WORDS = (*(2**k - 1 for k in (8, 15, 16, 31, 32)), 0, 1, 0x7F800000, 0x7FC00000, 0xFF7FFFFF)
"""What takes the place of binary numbers, infinite and missing floats among them."""

_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]+")


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """The file with one to four kinds of damage; a zip may be damaged in its members, and be a sound zip of them."""
    if content.startswith(b"PK") and rng.random() < 0.7:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            members = {name: file.read(name) for name in file.namelist()}
        name = str(rng.choice(list(members)))
        members[name] = damaged(members[name], rng)
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
            for each, raw in members.items():
                file.writestr(each, raw)
        return packed.getvalue()
    for _ in range(rng.choice([1, 1, 2, 4])):
        content = _DAMAGE[rng.integers(len(_DAMAGE))](content, rng)
    return content


def _flip(content, rng):
    at = _within(content, rng)
    return content[:at] + bytes([content[at] ^ 1 << rng.integers(8)]) + content[at + 1 :] if content else content


def _byte(content, rng):
    at = _within(content, rng)
    return content[:at] + bytes([rng.choice([0, 1, 127, 128, 255, rng.integers(256)])]) + content[at + 1 :]


def _put_piece(content, rng):
    at = _within(content, rng)
    return content[:at] + _one(PIECES, rng) * int(rng.choice([1, 1, 5])) + content[at + int(rng.integers(0, 3)) :]


def _cut_out(content, rng):
    at = _within(content, rng)
    return content[:at] + content[at + int(rng.integers(1, 600)) :]


def _double(content, rng):
    at = _within(content, rng)
    return content[:at] + content[at : at + int(rng.integers(1, 600))] + content[at:]


def _cut_off(content, rng):
    return content[: rng.integers(len(content) + 1)]


def _blank(content, rng):
    at, size = _within(content, rng), int(rng.integers(1, 600))
    return content[:at] + bytes(len(content[at : at + size])) + content[at + size :]


def _binary_number(content, rng):
    width = int(rng.choice([1, 2, 4, 8]))
    at = _within(content, rng) // width * width
    number = int(rng.choice(WORDS)) % 2 ** (8 * width)
    return content[:at] + number.to_bytes(width, str(rng.choice(["little", "big"]))) + content[at + width :]


def _number(content, rng):
    found = list(_NUMBER.finditer(content[: _first(content, rng)]))
    return _exchanged(content, found, _one(NUMBERS, rng), rng)


def _count(content, rng):
    found = list(re.finditer(rb"\d+", content[: _first(content, rng)]))
    if not found:
        return content
    hit = found[rng.integers(len(found))]
    more = int(hit[0][:18]) * int(rng.choice([2, 10, 1000, 10**9])) + int(rng.integers(-1, 2))
    return content[: hit.start()] + str(more).encode() + content[hit.end() :]


def _word(content, rng):
    found = list(_WORD.finditer(content[: _first(content, rng)]))
    if not found:
        return content
    other = [found[rng.integers(len(found))][0], b"x" * int(rng.choice([1, 300, 50_000])), b"", *PIECES[:5]]
    return _exchanged(content, found, _one(other, rng), rng)


def _drop_line(content, rng):
    return _lines(content, rng, lambda lines, i, j: [*lines[:i], *lines[i + 1 :]])


def _double_line(content, rng):
    times = int(rng.choice([1, 1, 3, 1000]))
    return _lines(content, rng, lambda lines, i, j: [*lines[:i], *[lines[i]] * min(times, _most(lines[i])), *lines[i:]])


def _move_line(content, rng):
    return _lines(content, rng, lambda lines, i, j: [*lines[:j], lines[i], *lines[j:]])


def _swap_lines(content, rng):
    def swap(lines, i, j):
        lines[i], lines[j] = lines[j], lines[i]
        return lines

    return _lines(content, rng, swap)


def _long_line(content, rng):
    return _lines(content, rng, lambda lines, i, j: [*lines[:i], lines[i] * _most(lines[i]), *lines[i + 1 :]])


def _nest(content, rng):
    at = _within(content, rng)
    return content[:at] + _one(NESTS, rng) * int(rng.choice([3, 300, 5000])) + content[at:]


def _line_ends(content, rng):
    return content.replace(b"\n", _one((b"\r\n", b"\r", b"\n\n", b" \n", b"\x85"), rng))


def _decimal_commas(content, rng):
    return re.sub(rb"(\d)\.(\d)", rb"\1,\2", content)


def _coding(content, rng):
    return content.decode("latin-1").encode(str(rng.choice(["utf-16", "utf-8-sig", "utf-32", "utf-8"])))


_DAMAGE = (
    *(_flip, _byte, _put_piece, _cut_out, _double, _cut_off, _blank, _binary_number, _binary_number, _number, _number),
    *(_number, _count, _count, _word, _drop_line, _double_line, _move_line, _swap_lines, _long_line, _nest),
    *(_line_ends, _decimal_commas, _coding),
)


def _one(choices, rng):
    return choices[rng.integers(len(choices))]


def _first(content, rng):
    """An end: what describes the samples stands at the beginning, and is hit more often than its size says."""
    return max(1, min(len(content), int(rng.choice([200, 1100, len(content)]))))


def _within(content, rng):
    return int(rng.integers(0, _first(content, rng)))


def _most(line):
    """How often a line is repeated at most."""
    return min(3000, 500_000 // (len(line) + 1) + 2)


def _exchanged(content, found, new, rng):
    if not found:
        return content
    hit = found[rng.integers(len(found))]
    return content[: hit.start()] + new + content[hit.end() :]


def _lines(content, rng, change):
    lines = content.split(b"\n")
    i, j = (int(rng.integers(0, rng.choice([min(len(lines), 12), len(lines)]))) for _ in range(2))
    return b"\n".join(change(lines, i, j))


def tried(case: Case, content: bytes, folder: Path, saves: bool = True) -> str:
    """`loaded` or `refused`: what came of the file with this content. Raises whatever is not as it must be."""
    for name, raw in {**case.beside, case.name: content}.items():
        (folder / name).write_bytes(raw)
    with _strict():
        motion = _loaded(case, folder)
        if motion is None:
            return "refused"
        out = folder / "out"
        out.mkdir(exist_ok=True)
        for known in formats() if saves else ():
            if not known.writes:
                continue
            path = out / f"clip.{known.name}"
            try:
                save(motion, path, format=known.name)
            except MotionFormatError as error:
                _one_sentence(error)
            else:
                again = load(path, format=known.name)
                assert len(again) == len(motion), f"{known.name} has {len(again)} frames of {len(motion)}"
                assert set(motion.names) <= set(again.names), f"{known.name} has {again.names} of {motion.names}"
                path.unlink()
            assert not list(out.iterdir()), f"saving as {known.name} leaves files behind"
        return "loaded"


def memory_of(case: Case, content: bytes, folder: Path) -> int:
    """Bytes of memory that loading takes at most."""
    for name, raw in {**case.beside, case.name: content}.items():
        (folder / name).write_bytes(raw)
    with _strict():
        tracemalloc.start()
        try:
            _loaded(case, folder)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()


def _loaded(case: Case, folder: Path) -> Motion | None:
    asked = case.asked | ({"skeleton": folder / case.asked["skeleton"]} if "skeleton" in case.asked else {})
    try:
        return load(folder / (case.path or case.name), **asked)
    except MotionFormatError as error:
        sentence = _one_sentence(error)
    assert any(name and name in sentence for name in (case.name, case.path, *case.beside)), f"no file in: {sentence}"
    return None


def _one_sentence(error: MotionFormatError) -> str:
    sentence = str(error)
    assert type(error) is MotionFormatError
    assert sentence.isprintable(), f"has line ends or worse: {sentence[:300]!r}"
    assert len(sentence) < 600, f"is {len(sentence)} characters long: {sentence[:300]!r}"
    return sentence


@contextmanager
def _strict() -> Iterator[None]:
    """Unpickling fails, and so does every warning but `MotionFormatWarning`."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", MotionFormatWarning)
        refuse = mock.Mock(side_effect=AssertionError("it was unpickled"))
        with mock.patch.multiple(pickle, load=refuse, loads=refuse, Unpickler=refuse):
            yield
