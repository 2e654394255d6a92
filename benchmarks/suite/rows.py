"""The rows of the suite: what is done to which skeleton at which rate, and what a method may know."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from benchmarks.suite.clips import Clip
from motionrecover import corrupt

SHORTEST = {"mixed": 122}
"""Frames that a clip must have at the row's rate: the longest run of missing samples between two that are kept."""
ANY = 24
"""Frames for the other protocols: 0.8 s at 30 Hz, which leaves in the shortest clips of the papers' subjects."""


@dataclass(frozen=True)
class Row:
    """One line of the table; `name` is what files and options call it."""

    protocol: str
    """As for `corrupt.apply`, or `noise-3` (Gaussian noise of 3 mm alone) or `clean`."""
    skeleton: str
    fps: int = 120
    bones: str = "estimated"
    """Whether our methods are given the true bone lengths (`known`) or find them. No peer uses any."""
    subjects: tuple[str, ...] = ()
    """Of the recordings; empty for all."""

    @property
    def name(self) -> str:
        """`iid-20 cmu25 120 Hz`, with `, bones known` where they are."""
        return f"{self.protocol} {self.skeleton} {self.fps} Hz" + (", bones known" if self.bones == "known" else "")

    @property
    def headline(self) -> str:
        """The error that the row is about: over missing samples where it makes gaps, else over all."""
        return "missing" if re.match("gap|rand|real-gaps|mixed", self.protocol) else "all"

    @property
    def seeded(self) -> bool:
        """Whether another seed gives other data."""
        return self.protocol != "clean"

    @property
    def frames(self) -> int:
        """Frames that a clip must have at the row's rate."""
        gap = re.fullmatch(r"gap\d+x(\d+)", self.protocol)
        return int(gap[1]) + 2 * corrupt.GAP_MARGIN if gap else SHORTEST.get(self.protocol, ANY)

    def corrupted(self, clip: Clip, seed: int) -> np.ndarray:
        """The clip as a method gets it: the same for every method."""
        if self.protocol == "clean":
            return clip.positions
        # The first words make clips independent; the name stands in by its digits.
        rng = np.random.default_rng([seed, int(clip.name.replace("_", ""))])
        if self.protocol == "noise-3":
            return corrupt.noise(clip.positions, 0.003, rng)[0]
        return corrupt.apply(self.protocol, clip.positions, rng, clip.skeleton)[0]


# The subjects of Yang et al. 2020, whose protocol `iid` is.
_YANG = ("05", "09")
_IID = ("iid-5", "iid-20", "iid-50", "iid-80")

ROWS = (
    *(Row(protocol, "cmu25", 120, bones, _YANG) for bones in ("known", "estimated") for protocol in _IID),
    Row("iid-20", "cmu25", 60, "known", _YANG),
    *(Row(protocol, "cmu25", 30, "known", _YANG) for protocol in _IID),
    *(Row(protocol, skeleton) for skeleton in ("cmu25", "cmu21") for protocol in ("gap3x60", "gap3x240")),
    *(Row(protocol, "cmu21", 30) for protocol in ("gap3x15", "gap3x60")),
    Row("gap3x60", "bvh19"),
    Row("gap3x60", "smpl24"),
    *(Row("mixed", "cmu21", fps) for fps in (120, 60, 30)),
    Row("mixed", "smpl24"),
    Row("rand30", "cmu25"),
    Row("real-gaps", "cmu21"),
    *(Row("noise-3", "cmu21", fps) for fps in (120, 30)),
    Row("clean", "cmu21"),
    Row("clean", "cmu25"),
    Row("clean", "cmu21", 30),
)

QUICK = ("iid-20 cmu25 120 Hz, bones known", "gap3x60 cmu21 120 Hz", "mixed cmu21 30 Hz", "clean cmu21 120 Hz")
"""The rows of a smoke test."""


def find(words: list[str]) -> list[Row]:
    """The rows whose protocol or name is one of the words, all without words.

    Raises `ValueError` for a word that names none.
    """
    unknown = [word for word in words if not any(word in (row.protocol, row.name) for row in ROWS)]
    if unknown:
        raise ValueError(f"received the protocol {unknown[0]!r}: the rows are {'; '.join(row.name for row in ROWS)}")
    return [row for row in ROWS if not words or row.protocol in words or row.name in words]
