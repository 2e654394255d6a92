"""Reading and writing motion files: one registry, one file a format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from motionrecover.io import asf, bvh, bvh_out, c3d, csv, csv_out, freemocap, kinect, npz, trc
from motionrecover.io.atomic import write_beside
from motionrecover.io.border import Asked, frame_rate, metres_in, up_axis
from motionrecover.io.errors import MotionFormatError, MotionFormatWarning
from motionrecover.io.movement import from_xarray, to_xarray
from motionrecover.io.skeleton_file import save_skeleton
from motionrecover.motion import Motion
from motionrecover.skeleton import Skeleton

__all__ = [
    "Format",
    "MotionFormatError",
    "MotionFormatWarning",
    "format_of",
    "formats",
    "from_xarray",
    "load",
    "save",
    "save_skeleton",
    "to_xarray",
    "write_beside",
]


@dataclass(frozen=True)
class Format:
    """One file format; `load` and `save` also take one from outside, as their `format`."""

    name: str
    """What `format=` calls it."""
    suffixes: tuple[str, ...]
    """Endings of file names that choose it, in lower case with the dot."""
    description: str
    """One line for people."""
    read: Callable[[Path, Asked], Motion] | None = None
    """Reads a file; `Asked` goes before what the file says. None for formats that are only written."""
    write: Callable[[Motion, Path], None] | None = None
    """Writes a file that does not matter until it is whole. None for formats that are only read."""
    fits: Callable[[Path], bool] | None = None
    """Tells by its content whether a file to read is of this format, where others share the ending."""
    beside: Callable[[Path], list[Path]] | None = None
    """The other files that reading looks at, for formats of several files."""

    @property
    def reads(self) -> bool:
        """Whether `load` takes it."""
        return self.read is not None

    @property
    def writes(self) -> bool:
        """Whether `save` takes it."""
        return self.write is not None


_FORMATS = (
    Format("bvh", (".bvh",), "Biovision hierarchy: offsets and rotations", bvh.read, bvh_out.write),
    Format("amc", (".amc", ".asf"), "Acclaim motion on the .asf skeleton beside it", read=asf.read, beside=asf.beside),
    Format("c3d", (".c3d",), "Optical markers, with analog data and events", c3d.read, c3d.write),
    Format("trc", (".trc",), "Optical markers as a table, as OpenSim has it", trc.read, trc.write),
    Format(
        "kinect", (".csv",), "Kinect v2 recording, told from other CSV by its content", kinect.read, fits=kinect.fits
    ),
    Format("csv", (".csv",), "Table, a row a frame; both CSV layouts are read", csv.read, csv_out.write_wide),
    Format("csv-long", (), "Table, a row a joint and frame; by name only", csv.read, csv_out.write_long),
    Format("npz", (".npz",), "NumPy arrays, exact and fast", npz.read, npz.write),
    Format(
        "freemocap",
        (".npy",),
        "FreeMoCap body, with its names and errors if beside it",
        read=freemocap.read,
        beside=freemocap.beside,
    ),
)


def formats() -> tuple[Format, ...]:
    """The known formats."""
    return _FORMATS


def load(
    path: str | Path,
    *,
    format: str | Format | None = None,
    skeleton: Skeleton | str | Path | None = None,
    unit: str | float | None = None,
    up: str | None = None,
    fps: float | None = None,
    skip_first: bool = False,
) -> Motion:
    """Motion of a file, in metres with y up whatever the file has.

    `format` is chosen by the ending of the name, and where formats share it by the content, unless given. `skeleton`
    (a skeleton, the name of a standard, "infer", or the path of a TOML file; of an ASF file for AMC), `unit` (a name of
    `motion.UNITS` or metres in one unit), `up` (x, y or z) and `fps` go before what the file says; one that neither
    states is an error, or an assumption that is said aloud (`MotionFormatWarning`) and kept in `Motion.history`.
    `skip_first` leaves frame 0 out, which in some BVH files is an added T-pose.

    Raises `MotionFormatError` for everything wrong with the file, `ValueError` for unusable arguments.
    """
    path = Path(path)
    asked = Asked(
        skeleton,
        None if unit is None else metres_in(unit),
        None if up is None else up_axis(up),
        None if fps is None else frame_rate(fps),
    )
    chosen = format_of(path, format)
    if chosen.read is None:
        raise MotionFormatError(f"{path} is {chosen.name}, which is written but not read: {_readable()}")
    try:
        motion = chosen.read(path, asked)
    except MotionFormatError:
        raise
    except ValueError as error:
        raise MotionFormatError(f"{path}: {error}") from error
    if not skip_first:
        return motion
    if len(motion) == 1:
        raise MotionFormatError(f"{path} holds only the frame to be skipped: leave skip_first (--skip-first) out")
    return replace(
        motion,
        positions=motion.positions[1:],
        observed=motion.observed[1:],
        confidence=None if motion.confidence is None else motion.confidence[1:],
        rig=None if motion.rig is None else motion.rig.frames(slice(1, None)),
        source=None if motion.source is None else motion.source.frames(slice(1, None)),
        history=(*motion.history, "left frame 0 out"),
    )


def save(motion: Motion, path: str | Path, *, overwrite: bool = False, format: str | Format | None = None) -> Path:
    """Write a motion, in metres with y up, and return its path; the file appears whole or not at all.

    `format` is chosen by the ending of the name unless given. BVH of a motion that came from BVH has the unit, axes,
    hierarchy and channels of that file, C3D and TRC of one that came from C3D and TRC its unit, axes and whatever else
    it holds: see `io.bvh_out`, `io.c3d`, `io.trc`.

    Raises `FileExistsError` when the file exists and `overwrite` is false, other `OSError` when it cannot be written,
    `MotionFormatError` for a format that is not written or that cannot hold the motion.
    """
    path = Path(path)
    chosen = _choose(path, format)
    if chosen.write is None:
        writable = ", ".join(known.name for known in _FORMATS if known.writes)
        raise MotionFormatError(f"{path} would be {chosen.name}, which is read but not written: write {writable}")
    with write_beside(path, overwrite=overwrite) as temporary:
        try:
            chosen.write(motion, temporary)
        except MotionFormatError:
            raise
        except ValueError as error:
            raise MotionFormatError(f"{path}: {error}") from error
    return path


def format_of(path: str | Path, format: str | Format | None = None) -> Format:
    """The format that `load` reads a file as. Raises as `load` does where none is known."""
    return _choose(Path(path), format, reading=True)


def _choose(path: Path, format: str | Format | None, reading: bool = False) -> Format:
    """The format that is given, or that the ending of the name says, and the content of a file to read."""
    if isinstance(format, Format):
        return format
    names = ", ".join(known.name for known in _FORMATS)
    for known in _FORMATS:
        by_ending = format is None and path.suffix.lower() in known.suffixes
        if known.name == format or (by_ending and (known.fits is None or (reading and known.fits(path)))):
            return known
    if format is not None:
        raise ValueError(f"received format {format!r}: give one of {names}")
    raise MotionFormatError(
        f"{path} ends in {path.suffix or 'nothing'!r}, which tells no format: give format=, {names}"
    )


def _readable() -> str:
    return "read " + ", ".join(known.name for known in _FORMATS if known.reads)
