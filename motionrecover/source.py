"""Source: the file that a clip came from, for formats that write a clip back into it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace


@dataclass(frozen=True, eq=False)
class Source:
    """A whole file of which the clip is a part; what else it holds is written back as it came."""

    format: str
    """What the registry of `io` calls it."""
    content: bytes = field(repr=False)
    kept: range
    """Which of the file's frames the clip has."""

    def frames(self, part: slice) -> Source:
        """The same file, for a clip of some of the frames."""
        return replace(self, kept=self.kept[part])
