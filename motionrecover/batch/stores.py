"""Takes in Zarr stores, of any length: read, recovered and written part by part.

A store is a folder that ends in `.zarr`. Each group of it with an array `position` is a take: a poses dataset of
movement, as `io.movement` and `Dataset.to_zarr` have it, with any number of individuals. Its answer is a dataset of the
same kind, in metres with y up, of the same version of Zarr. Two parts of `PART` frames are in memory at most.

    1. Parts are of equal length and share `OVERLAP` frames or more (`windows.split`). Each is recovered by itself.
    2. Over the frames that two parts share, one answer fades into the other (`windows.shares`), by how certain each is.

A take of one part is recovered as the whole clip is, to the bit. In a longer one each part finds bone lengths, noise,
swaps, and the frames that gaps are predicted from by itself. A gap that is longer than `OVERLAP` and crosses the end of
a part counts as two, and where two parts fade, bones keep their lengths only as well as the two answers agree.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motionrecover import __version__, files, windows
from motionrecover.batch.facts import Facts, facts_of, joined, unseen
from motionrecover.io import MotionFormatError, from_xarray, to_xarray, write_beside
from motionrecover.io.border import counted, refuse_swollen
from motionrecover.io.movement import DIMS
from motionrecover.motion import Motion
from motionrecover.recovery import recover_motion

if TYPE_CHECKING:
    import xarray

SUFFIX = ".zarr"
PART, OVERLAP = 10_000, 400
"""Frames. The overlap is a window of `robust`."""
STORED = 1000
"""Frames in a chunk of an answer."""
LARGEST = 2**30
"""Bytes of a chunk, which is in memory as a whole."""
NEAR = 1e-6
"""Metres. What is more certain is not trusted more."""
_GROUP = {".zgroup": '{"zarr_format": 2}\n', "zarr.json": '{"zarr_format": 3, "node_type": "group"}\n'}
"""What makes a group of a folder, by version of Zarr."""


def takes(store: str) -> Iterator[tuple[str, str]]:
    """Path of each take of a store, and its name below the store; '.' where the store is one."""
    for place, folders, _ in os.walk(store):
        if "position" in folders:
            folders.clear()
            yield place, os.path.relpath(place, store)
        folders[:] = sorted(name for name in folders if not name.startswith("."))


def recover_take(
    path: Path,
    place: Path,
    preset: str,
    bone_lengths: files.BoneLengths,
    recovery: Mapping[str, Any],
    reading: Mapping[str, Any],
    digest: str,
) -> Facts:
    """Recover the take at `path` into the empty folder `place`, and return the facts for its record.

    Settings as `batch.Settings` has them; `digest` is the take's SHA-256. Raises `MotionFormatError` for what is no
    dataset of poses or cannot be read in bounded memory, and `ValueError` as `files.take_in` does.
    """
    with _without_notes_on_versions():
        dataset, version = _opened(path)
        dataset = dataset.isel(time=slice(1 if reading.get("skip_first") else 0, None))
        spans = windows.split(dataset.sizes["time"], PART, OVERLAP)
        note = f"recovered with {preset} of motionrecover {__version__} in {counted(len(spans), 'part')}; "
        take = _Take(path, dataset, reading, note + f"SHA-256 of the input {digest}")
        facts: list[Facts] = []

        def parts() -> Iterator[_Part]:
            for k, span in enumerate(spans):
                first = (spans[k - 1].stop + span.start) // 2 if k else span.start
                last = (spans[k + 1].start + span.stop) // 2 if k + 1 < len(spans) else span.stop
                of = slice(first - span.start, last - span.start)
                found = [_recovered(take, span, who, preset, bone_lengths, recovery, of) for who in take.individuals]
                own, answers, trust = zip(*found, strict=True)
                facts.append(joined(own) | {"frames": own[0]["frames"], "joints": sum(f["joints"] for f in own)})
                yield _Part(span, np.concatenate(answers, 1), np.concatenate(trust, 1))

        written = 0
        for positions in _faded(parts()):
            _append(place, take.as_dataset(positions, written), version)
            written += len(positions)
    if not take.seen:
        raise ValueError(f"{path} holds no measured sample: there is nothing to recover from")
    return joined(facts)


def make_groups(folder: str, name: str, path: Path) -> None:
    """Make the folders of the answer `name` that lie in its store groups, of the version of Zarr of the take `path`."""
    group = ".zgroup" if (path / ".zgroup").exists() else "zarr.json"
    places = Path(folder, name).parents[: len(Path(name).parts) - 1]
    for place in places:
        if any(part.endswith(SUFFIX) for part in place.relative_to(folder).parts):
            with write_beside(place / group, overwrite=True) as temporary:
                temporary.write_text(_GROUP[group], encoding="utf-8")


@dataclass
class _Take:
    """A take that is read part by part."""

    path: Path
    dataset: xarray.Dataset
    reading: Mapping[str, Any]
    note: str
    """For the history of the answer."""
    first: dict[str, Motion] = field(default_factory=dict)
    """First frame of each individual, for what all its parts have in common."""
    seen: bool = False
    """Whether some part held a measured sample."""

    @property
    def individuals(self) -> list[str]:
        return [str(name) for name in self.dataset["individuals"].values]

    def clip(self, span: slice, individual: str) -> Motion:
        """Some frames of an individual."""
        told = {name: self.reading.get(name) for name in ("skeleton", "unit", "up", "fps")}
        if self.first:  # bones that are inferred are so once
            told["skeleton"] = next(iter(self.first.values())).skeleton
        clip = from_xarray(self.dataset.isel(time=span), individual=individual, **told)
        if not self.first:  # what was taken is the whole
            *before, last = clip.history
            whole = counted(self.dataset.sizes["time"], "frame")
            clip = replace(clip, history=(*before, last.replace(counted(len(clip), "frame"), whole)))
        self.seen |= bool(clip.observed.any())
        if individual not in self.first:
            self.first[individual] = clip.with_positions(clip.positions[:1], self.note)
        return clip

    def as_dataset(self, positions: np.ndarray, start: int) -> xarray.Dataset:
        """The dataset of an answer (frame, joint, 3), the joints of all individuals in a row, from a frame on."""
        import xarray

        each = np.split(positions, len(self.first), axis=1)
        motions = zip(self.first.items(), each, strict=True)
        found = [to_xarray(replace(clip, positions=one, observed=None), who) for (who, clip), one in motions]
        fps = next(iter(self.first.values())).fps
        whole = xarray.concat(found, "individuals", combine_attrs="override")
        return whole.transpose(*DIMS).assign_coords(time=np.arange(start, start + len(positions)) / fps)


@dataclass(frozen=True, eq=False)
class _Part:
    """An answer (frame, joint, 3), and how far each of its samples is trusted (frame, joint)."""

    span: slice
    positions: np.ndarray
    trust: np.ndarray


def _recovered(take, span, individual, preset, bone_lengths, recovery, of):
    """Facts on the frames `of` a part, its answer, and how far it is trusted."""
    clip = take.clip(span, individual)
    if not clip.observed.any():
        dtype = np.dtype(recovery.get("dtype") or "float32")
        nothing = np.full(clip.positions.shape, np.nan, dtype), np.full(clip.observed.shape, NEAR)
        return unseen(of.stop - of.start, len(clip.names)), *nothing
    _, lengths = files.lengths_for(clip, bone_lengths, take.path)
    found = recover_motion(clip, preset=preset, bone_lengths=lengths, **recovery)
    # The published models do not say how certain they are.
    trust = 1 / np.maximum(np.nan_to_num(found.uncertainty, nan=1.0, posinf=1 / NEAR), NEAR) ** 2
    return facts_of(clip, found, found.positions, of), found.positions, trust


def _faded(parts: Iterable[_Part]) -> Iterator[np.ndarray]:
    """Positions (frame, joint, 3) of parts that overlap, in pieces, each as soon as nothing changes it any more."""
    last = None
    for part in parts:
        if last is not None:
            common = last.span.stop - part.span.start
            start = last.span.start
            spans = [slice(each.span.start - start, each.span.stop - start) for each in (last, part)]
            old, new = (share[..., None] for share in windows.shares(spans, [last.trust, part.trust]))
            a, b = last.positions[-common:], part.positions[:common]
            mixed = (old[-common:] * a + new[:common] * b).astype(a.dtype)
            yield last.positions[:-common]
            part.positions[:common] = np.where(np.isnan(a), b, np.where(np.isnan(b), a, mixed))
        last = part
    assert last is not None
    yield last.positions


def _opened(path: Path) -> tuple[xarray.Dataset, int]:
    """The dataset of a take, of which nothing big is read yet, and its version of Zarr."""
    try:
        import xarray
        import zarr
    except ImportError as error:
        raise ImportError(f"{path} needs Zarr: pip install motionrecover[zarr]") from error
    for metadata in (*path.glob("*/.zarray"), *path.glob("*/zarr.json")):
        if b"pickle" in metadata.read_bytes():
            raise MotionFormatError(f"{metadata} asks for pickle, which runs what a stranger wrote: store plain arrays")
    try:
        group = zarr.open_group(path, mode="r", use_consolidated=False)
        arrays = {name: array for name, array in group.arrays() if name in ("position", "confidence", *DIMS)}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MotionFormatError(f"{path} is no Zarr group: {error}") from error
    shape = [*arrays["position"].shape] if "position" in arrays else []
    if len(shape) != len(DIMS) or 0 in shape:
        raise MotionFormatError(
            f"{path} holds positions of shape {shape}: give one sample or more in {', '.join(DIMS)}"
        )
    for name, array in arrays.items():
        if np.prod(array.chunks, dtype=float) * array.dtype.itemsize > LARGEST:
            raise MotionFormatError(
                f"{path} holds {name} in chunks of {array.chunks}, which take more than {LARGEST / 1e9:.1f} GB each: "
                "rechunk it along time"
            )
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    for name in set(arrays) & set(DIMS):
        refuse_swollen(path, size, int(np.prod(arrays[name].shape)), 1)
    refuse_swollen(path, size, min(shape[0], PART), int(np.prod(shape[2:])))
    dataset = xarray.open_dataset(path, engine="zarr", chunks=None, cache=False, consolidated=False, decode_times=False)
    lost = {"position", *DIMS} - set(dataset.variables)
    if lost:
        raise MotionFormatError(f"{path} holds no {', '.join(sorted(lost))}: give a poses dataset of movement")
    return dataset, group.metadata.zarr_format


def _append(place: Path, piece: xarray.Dataset, version: int) -> None:
    """Write a piece of a dataset to the end of a take."""
    if any(place.iterdir()):
        piece.to_zarr(place, append_dim="time", zarr_format=version, consolidated=False)
        return
    chunks = {"time": (STORED,), "position": (STORED, *piece["position"].shape[1:])}
    chunks["confidence"] = chunks["position"][:1] + chunks["position"][2:]
    encoding = {name: {"chunks": size} for name, size in chunks.items()}
    piece.to_zarr(place, zarr_format=version, consolidated=False, encoding=encoding)


@contextmanager
def _without_notes_on_versions() -> Iterator[None]:
    """Without Zarr's warnings on how it stores names."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=FutureWarning)
        yield
