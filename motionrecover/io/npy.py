"""NPY: one array in bytes: magic and version, the length of a header, the header, the numbers.

The header is a Python dictionary, here matched as the text that every program writes: NumPy's reader has Python parse
it, which warns, recurses or runs out of memory on damaged ones, and allocates whatever it announces. Here nothing is
unpickled, and nothing is made of bytes that are not as many as the header says.

Source: numpy.lib.format, "NumPy format", versions 1.0 to 3.0.
"""

from __future__ import annotations

import math
import re

import numpy as np

MAGIC = b"\x93NUMPY"
_WIDTHS = {1: 2, 2: 4, 3: 4}
"""Bytes of the header's length, by version."""
_HEADER = re.compile(
    r"\s*\{\s*'descr':\s*'(?P<type>[<>=|]?[biufSUO]\d{0,9})',\s*'fortran_order':\s*(?P<fortran>True|False),"
    r"\s*'shape':\s*\((?P<shape>[\d, ]*)\),?\s*\}\s*"
)


def array_of(content: bytes) -> np.ndarray:
    """The array of an NPY file, in native byte order; not writable. Raises `ValueError` for anything else."""
    width = _WIDTHS.get(content[6], 0) if content[:6] == MAGIC and len(content) > 12 else 0
    start = 8 + width + int.from_bytes(content[8 : 8 + width], "little")
    match = _HEADER.fullmatch(content[8 + width : start].decode("latin-1")) if width else None
    if match is None:
        raise ValueError("this is no NPY file of plain numbers: check its name or give format=")
    if "O" in match["type"]:
        raise ValueError("it holds objects: get the whole file, saved as plain numbers")
    try:
        dtype = np.dtype(match["type"])
        shape = tuple(int(size) for size in match["shape"].split(",") if size.strip())
    except (TypeError, ValueError) as error:
        raise ValueError("this is no NPY file of plain numbers: check its name or give format=") from error
    size, needed = len(content) - start, math.prod(shape) * dtype.itemsize
    # NumPy refuses shapes without numbers, of size 0, that would be too large but for that.
    if size != needed or not dtype.itemsize or max(shape, default=0) > max(size, 2**16):
        raise ValueError(f"it holds {size} bytes of the {needed} that shape {shape} takes: get the whole file")
    values = np.ndarray(shape, dtype, content, start, order="F" if match["fortran"] == "True" else "C")
    if dtype.kind == "U":
        codes = np.ndarray(size // 4, f"{dtype.str[0]}u4", content, start)
        # NumPy would make strings of them that no codec takes.
        if (codes > 0x10FFFF).any():
            raise ValueError("it holds text that is none, the file is damaged: get the whole file")
    return values.astype(dtype.newbyteorder("="), copy=False)
