"""A folder of clips as training windows: read clip by clip, kept once, cut into windows as batches need them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from motionrecover.io import formats, load
from motionrecover.refine.normalise import Convention, place
from motionrecover.refine.sampling import resample
from motionrecover.skeleton import Skeleton

FASTEST = 30.0
"""Metres a second relative to the root. What is faster is a glitch: of 200 CMU clips, those with flipped arms or thrown
bodies in single frames reach 31 to 104, all others stay below 28."""
SHARE = 0.7
"""Of the subjects, or of the windows, that are trained on (Choi et al. 2024, Sec. 5.2)."""


@dataclass(frozen=True, eq=False)
class Clips:
    """Clips about the body, at the model's rate, in metres."""

    names: tuple[str, ...]
    positions: tuple[np.ndarray, ...]
    """Each (frame, joint, 3) in float32."""
    skipped: tuple[str, ...]
    """Why a file was left out, in a sentence each."""

    @property
    def subjects(self) -> tuple[str, ...]:
        """Of each clip: the name of its file up to the first underscore."""
        return tuple(Path(name).stem.partition("_")[0] for name in self.names)

    @property
    def digest(self) -> str:
        """Tells these clips from others."""
        digest = hashlib.sha256()
        for name, clip in zip(self.names, self.positions, strict=True):
            digest.update(name.encode())
            digest.update(clip.tobytes())
        return digest.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of clips, (clip, first frame) each."""

    clips: Clips
    where: np.ndarray
    length: int

    def __len__(self) -> int:
        return len(self.where)

    def take(self, which: np.ndarray) -> np.ndarray:
        """The windows of those numbers: (window, frame, joint, 3)."""
        return np.stack([self.clips.positions[c][start : start + self.length] for c, start in self.where[which]])

    def batch(self, step: int, size: int, seed: int) -> np.ndarray:
        """The batch of a step: every window once an epoch, in an order of its own; the rest of an epoch is left out."""
        epoch, place = divmod(step, self.batches(size))
        order = np.random.default_rng([seed, epoch]).permutation(len(self))
        return self.take(order[place * size : (place + 1) * size])

    def batches(self, size: int) -> int:
        """Batches an epoch."""
        return len(self) // size


def read_clips(folder: str | Path, skeleton: Skeleton, convention: Convention) -> Clips:
    """All clips of a folder and its subfolders that have the joints of `skeleton`, observed throughout.

    Files that cannot be read or used are left out, and listed. Raises `ValueError` where nothing is left.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder: give one with clips")
    endings = {suffix for known in formats() if known.reads for suffix in known.suffixes} - {".asf"}
    names, clips, skipped = [], [], []
    for path in sorted(path for path in folder.rglob("*") if path.suffix.lower() in endings):
        try:
            clips.append(_clip(path, skeleton, convention))
            names.append(path.relative_to(folder).as_posix())
        except (ValueError, OSError) as error:
            skipped.append(" ".join(str(error).split()))
    if not clips:
        why = f", the first of {len(skipped)} because {skipped[0]}" if skipped else ""
        raise ValueError(
            f"{folder} holds no clip to train on{why}: give a folder of clips with {len(skeleton.names)} joints"
        )
    return Clips(tuple(names), tuple(clips), tuple(skipped))


def split(
    clips: Clips, length: int, by: Literal["subject", "window"], held_out: tuple[str, ...], seed: int
) -> tuple[Windows, Windows]:
    """Windows to train on and windows held out, with overlaps of half a window.

    By subject: all windows of the subjects `held_out`, or else of 30 % of them, drawn by the seed. By window, as in the
    papers: 30 % of all windows, which share frames with those trained on. Raises `ValueError` where one side is empty.
    """
    hop = length // 2
    starts = [(c, s) for c, clip in enumerate(clips.positions) for s in range(0, len(clip) - length + 1, hop)]
    where = np.array(starts, int).reshape(-1, 2)
    rng = np.random.default_rng(seed)
    if by == "window":
        trained = np.zeros(len(where), bool)
        trained[rng.permutation(len(where))[: round(SHARE * len(where))]] = True
    else:
        subjects = sorted(set(clips.subjects))
        if unknown := set(held_out) - set(subjects):
            raise ValueError(f"received held-out subject {min(unknown)!r}: the clips are of {', '.join(subjects)}")
        kept = rng.permutation(subjects)[: max(1, round(SHARE * len(subjects)))].tolist()
        out = set(held_out) or set(subjects) - set(kept)
        trained = np.array([clips.subjects[c] not in out for c, _ in where], bool)
    if not trained.any() or trained.all():
        raise ValueError(
            f"received {len(clips.names)} clips of {len(set(clips.subjects))} subjects, {len(where)} windows of "
            f"{length} frames: give clips of at least two subjects on either side, or split by window"
        )
    return Windows(clips, where[trained], length), Windows(clips, where[~trained], length)


def evenly(windows: Windows, size: int, count: int) -> Iterator[np.ndarray]:
    """At most `count` batches of `size` windows, spread over all; fewer windows than a batch come more than once."""
    which = np.linspace(0, len(windows) - 1, size * max(1, min(count, len(windows) // size))).astype(int)
    for part in which.reshape(-1, size):
        yield windows.take(part)


def _clip(path: Path, skeleton: Skeleton, convention: Convention) -> np.ndarray:
    motion = load(path)
    if lost := [name for name in skeleton.names if name not in motion.names]:
        raise ValueError(f"{path} has no joint {', '.join(lost[:4])}{', ...' * (len(lost) > 4)}")
    motion = motion.select(skeleton.names)
    if not motion.observed.all():
        raise ValueError(f"{path} has missing samples: recover it first")
    positions = motion.positions.astype(np.float64)
    about = positions - positions[:, skeleton.parents.index(-1)][:, None]
    fastest = motion.fps * np.linalg.norm(np.diff(about, axis=0), axis=-1).max(initial=0)
    if fastest > FASTEST:
        raise ValueError(f"{path} has a joint that moves at {fastest:.0f} m/s: a glitch is no clean motion")
    positions = resample(positions, motion.fps, convention.fps)
    seen = np.ones(len(skeleton.names), bool)
    return place(positions, seen, skeleton, convention, convention.fps).inward(positions).astype(np.float32)
