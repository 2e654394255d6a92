"""Skeleton files: names and bones as TOML, to be edited by hand.

    names = ["LASI", "RASI", "SACR"]
    edges = [
        ["LASI", "RASI"],  # 250.1 mm, varies by 0.9 mm (0.4 %), seen in 960 of 960 frames
        ["LASI", "SACR"],
    ]

`Skeleton.from_file` reads them, and also `parents` in the place of `edges`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from motionrecover.io.atomic import write_beside
from motionrecover.skeleton import Skeleton

_HEAD = """# A line of `edges` is a bone: take it out or add one. In a tree, the first joint of each is the parent.
"""


def save_skeleton(
    skeleton: Skeleton, path: str | Path, *, reasons: Sequence[str] | None = None, overwrite: bool = False
) -> Path:
    """Write names and bones as a TOML file and return its path; the file appears whole or not at all.

    `reasons` (bone,) become comments. Rest offsets are left out. Raises `FileExistsError` when the file exists and
    `overwrite` is false, other `OSError` when it cannot be written.
    """
    bones = [f"    [{quoted(skeleton.names[i])}, {quoted(skeleton.names[j])}]," for i, j in skeleton.edges]
    if reasons is not None:
        bones = [f"{bone}  # {reason}" for bone, reason in zip(bones, reasons, strict=True)]
    names = [f"    {quoted(name)}," for name in skeleton.names]
    with write_beside(Path(path), overwrite=overwrite) as temporary:
        lines = [_HEAD + "names = [", *names, "]", "edges = [", *bones, "]", ""]
        temporary.write_text("\n".join(lines), encoding="utf-8")
    return Path(path)


def quoted(name: str) -> str:
    """A TOML string: JSON's escapes are TOML's, which also wants one for DEL."""
    return json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")
