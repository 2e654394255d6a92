"""The pictures that show what a recovery did."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from motionrecover.io.atomic import write_beside
from motionrecover.motion import Motion
from motionrecover.recovery import Recovery
from motionrecover.report.account import binned, extent
from motionrecover.report.payload import SHADES
from motionrecover.report.words import percent
from motionrecover.robust import Change
from motionrecover.runs import runs_of

FIGURES = ("recovery.png", "changes.png")
"""What `write_figures` draws: `recovery_figure` and `changes_figure`."""

# Okabe & Ito's colours, which colour-blind readers tell apart.
_COLOURS = {"truth": "#222222", "corrupted": "#E69F00", "recovered": "#0072B2"}
_PANELS = 3
_POSES = 5
_SPACING = 0.9
"""Metres between two stick figures."""
_COLUMNS = 1000


def write_figures(
    folder: str | Path,
    truth: Motion | None,
    corrupted: Motion,
    recovered: Motion,
    recovery: Recovery,
    *,
    overwrite: bool = False,
) -> None:
    """Draws `FIGURES` into a folder, which is made if there is none."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    first, second = (Path(folder) / name for name in FIGURES)
    with write_beside(first, overwrite=overwrite) as temporary:
        recovery_figure(truth, corrupted, recovered, temporary)
    with write_beside(second, overwrite=overwrite) as temporary:
        changes_figure(corrupted, recovery, temporary)


def recovery_figure(truth: Motion | None, corrupted: Motion, recovered: Motion, path: str | Path) -> None:
    """Writes a picture of a recovery to `path`; the suffix names the format (png, pdf, svg).

    From top to bottom: stick figures where the corruption is worst, the height of the most corrupted joints over time,
    the lengths of the most corrupted bones over time, and the mean error of each joint before and after. Grey bands
    mark where a joint was missing. Without `truth`, what needs it is left out, and `recovered` tells the worst places.

    Raises `ValueError` for clips of different frames or joints, `ImportError` without matplotlib.
    """
    try:
        from matplotlib.artist import Artist
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch
    except ImportError as error:
        raise ImportError("a figure needs matplotlib: pip install motionrecover[figures]") from error
    clips = {"truth": truth, "corrupted": corrupted, "recovered": recovered}
    clips = {name: clip for name, clip in clips.items() if clip is not None}
    for name, clip in clips.items():
        if (len(clip), clip.names) != (len(recovered), recovered.names):
            raise ValueError(
                f"received {name} of {len(clip)} frames and {len(clip.names)} joints, and recovered of "
                f"{len(recovered)} and {len(recovered.names)}: give the same frames and joints"
            )
    reference = recovered if truth is None else truth
    rows = {"poses": 6.0 / len(clips), "heights": 2.3}
    if recovered.skeleton.edges:
        rows["lengths"] = 2.2
    if truth is not None:
        rows["errors"] = 2.4
    figure = Figure(figsize=(11.5, sum(rows.values()) + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    parts = figure.subfigures(len(rows), 1, height_ratios=list(rows.values()), squeeze=False)[:, 0]
    for row, part in zip(rows, parts, strict=True):
        if row == "poses":
            _draw_poses(part.subplots(1, len(clips)), clips, reference)
        elif row == "heights":
            _draw_heights(part.subplots(1, _PANELS), clips, reference)
        elif row == "lengths":
            _draw_lengths(part.subplots(1, _PANELS), clips)
        else:
            _draw_errors(part.subplots(), reference, corrupted, recovered)
    handles: list[Artist] = [Line2D([], [], color=_COLOURS[name], linewidth=3, label=name) for name in clips]
    if not corrupted.observed.all():
        handles.append(Patch(color="0.9", label="missing"))
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=13)
    figure.savefig(path, dpi=140)


def changes_figure(corrupted: Motion, recovery: Recovery, path: str | Path) -> None:
    """Writes a picture of what happened to each joint in each frame: the kind of change, darker the farther it went.

    Of the frames that share a column the gravest change is drawn. Raises `ImportError` without matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.colors import LinearSegmentedColormap
        from matplotlib.figure import Figure
        from matplotlib.patches import Patch
    except ImportError as error:
        raise ImportError("a figure needs matplotlib: pip install motionrecover[figures]") from error
    changed, far = recovery.changed, extent(corrupted, recovery)
    full = [np.quantile(far[changed == kind], 0.98) if (changed == kind).any() else 1.0 for kind in Change]
    height = changed + np.minimum(0.999, far / np.maximum(full, 1e-6)[changed])
    rows = binned(height, -(-len(height) // _COLUMNS)).T
    stops = [
        ((kind + k) / len(Change), shade)
        for kind in Change
        for k, shade in zip((0, 0.75, 1), SHADES[kind], strict=True)
    ]
    figure = Figure(figsize=(11.5, 1.4 + 0.17 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    axis.imshow(
        rows, LinearSegmentedColormap.from_list("changes", stops, 1280), aspect="auto", interpolation="nearest",
        vmin=0, vmax=len(Change), extent=(0, corrupted.seconds, len(rows) - 0.5, -0.5),
    )  # fmt: skip
    axis.set_yticks(range(len(rows)), corrupted.names, fontsize=9)
    axis.set_xlabel("seconds")
    axis.spines[:].set_visible(False)
    kinds = [kind for kind in Change if (changed == kind).any()]
    handles = [
        Patch(color=SHADES[kind][1], label=f"{kind.name.lower()} {percent((changed == kind).mean())}") for kind in kinds
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False, fontsize=11)
    figure.savefig(path, dpi=140)


def _damage(corrupted: Motion, reference: Motion) -> np.ndarray:
    """How badly each sample (frame, joint) is corrupted, in metres: its error, at most 0.25; 0.25 where missing."""
    error = np.linalg.norm(corrupted.positions - reference.positions, axis=-1)
    return np.where(corrupted.observed, np.minimum(np.nan_to_num(error), 0.25), 0.25)


def loss_figure(log: str | Path, path: str | Path) -> None:
    """Draws the log of a training run (CSV) to `path`: losses over steps, and errors on held-out windows.

    Raises `ImportError` without matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("a figure needs matplotlib: pip install motionrecover[figures]") from error
    with Path(log).open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    losses, errors = figure.subplots(1, 2)
    steps = [int(line["step"]) for line in lines]
    for name in ("loss", "position", "bone", "smooth", "perceptual"):
        values = [float(line[name]) for line in lines]
        if any(values):
            losses.plot(steps, values, label=name, linewidth=2 if name == "loss" else 1)
    losses.set(xlabel="step", ylabel="loss", yscale="log")
    measured = [line for line in lines if line["held_out_mm"]]
    names = {
        "held_out_mm": "all samples",
        "held_out_missing_mm": "missing",
        "mean_pose_missing_mm": "missing, mean pose",
    }
    for name, label in names.items():
        errors.plot([int(line["step"]) for line in measured], [float(line[name]) for line in measured], label=label)
    errors.set(xlabel="step", ylabel="mean error on held-out windows (mm)")
    for axes in (losses, errors):
        axes.legend(fontsize="small")
    figure.savefig(Path(path), dpi=110)


def _draw_poses(axes, clips: dict[str, Motion], reference: Motion) -> None:
    """Stick figures at the worst frame of each stretch of time, each seen from where its limbs spread widest."""
    damage = _damage(clips["corrupted"], reference).mean(1)
    stretches = np.array_split(np.arange(len(damage)), min(_POSES, len(damage)))
    frames = [int(stretch[damage[stretch].argmax()]) for stretch in stretches]
    heights = reference.positions[frames][..., 1]
    for name, axis in zip(clips, axes, strict=True):
        for place, frame in enumerate(frames):
            pose = reference.positions[frame]
            middle = np.nanmean(pose, axis=0) if np.isfinite(pose).any() else np.zeros(3)
            flat = np.nan_to_num((pose - middle)[:, [0, 2]])
            across = np.linalg.svd(flat, full_matrices=False)[2][0]
            # One sign for all poses: the singular vector's is arbitrary.
            across = across * (1 if across.sum() >= 0 else -1)
            points = clips[name].positions[frame]
            x = (points - middle)[:, [0, 2]] @ across + _SPACING * place
            for i, j in clips[name].skeleton.edges:
                axis.plot(x[[i, j]], points[[i, j], 1], color=_COLOURS[name], linewidth=2, solid_capstyle="round")
            axis.plot(x, points[:, 1], ".", color=_COLOURS[name], markersize=4)
            axis.annotate(
                f"{frame / reference.fps:.1f} s", (_SPACING * place, 0), (0, -12), xycoords=("data", "axes fraction"),
                textcoords="offset points", ha="center", color="0.4", fontsize=10,
            )  # fmt: skip
        axis.set_title(name, color=_COLOURS[name], fontweight="bold")
        axis.set_aspect("equal")
        axis.axis("off")
        axis.set_xlim(-0.65, _SPACING * (len(frames) - 1) + 0.65)
        axis.set_ylim(np.nanmin(heights) - 0.15, np.nanmax(heights) + 0.15)


def _draw_heights(axes, clips: dict[str, Motion], reference: Motion) -> None:
    corrupted, names = clips["corrupted"], clips["corrupted"].names
    worst = np.argsort(-_damage(corrupted, reference).mean(0), kind="stable")[:_PANELS]
    for axis, joint in zip(axes, worst, strict=False):
        _band(axis, ~corrupted.observed[:, joint], corrupted.fps)
        _curves(axis, {name: clip.positions[:, joint, 1] for name, clip in clips.items()}, corrupted.fps)
        axis.set_title(f"{names[joint]}: height")
    axes[0].set_ylabel("metres")
    _hide(axes[len(worst) :])


def _draw_lengths(axes, clips: dict[str, Motion]) -> None:
    lengths = {name: clip.skeleton.bone_lengths_of(clip.positions) for name, clip in clips.items()}
    skeleton = clips["recovered"].skeleton
    spread = np.nan_to_num(np.abs(lengths["corrupted"] - lengths["recovered"])).mean(0)
    worst = np.argsort(-spread, kind="stable")[:_PANELS]
    for axis, bone in zip(axes, worst, strict=False):
        fps = clips["corrupted"].fps
        _band(axis, ~np.all(clips["corrupted"].observed[:, skeleton.edges[bone]], axis=1), fps)
        _curves(axis, {name: length[:, bone] for name, length in lengths.items()}, fps)
        axis.set_title(f"{skeleton.bone_names[bone]}: bone length")
        axis.set_xlabel("seconds")
    axes[0].set_ylabel("metres")
    _hide(axes[len(worst) :])


def _draw_errors(axis, truth: Motion, corrupted: Motion, recovered: Motion) -> None:
    names = truth.names
    means = []
    for name, positions, shift in (
        ("corrupted", _bridged(corrupted), -0.2),
        ("recovered", recovered.positions, 0.2),
    ):
        errors = 1000 * np.linalg.norm(positions - truth.positions, axis=-1)
        means.append(np.nanmean(errors))
        axis.bar(np.arange(len(names)) + shift, errors.mean(0), 0.4, color=_COLOURS[name])
        axis.axhline(means[-1], color=_COLOURS[name], linewidth=1.2, linestyle="--")
    before = "corrupted" if corrupted.observed.all() else "corrupted (straight lines across the gaps)"
    axis.set_title(f"mean error of each joint; over all {means[0]:.1f} mm {before}, {means[1]:.1f} mm recovered")
    axis.set_xticks(range(len(names)), names, rotation=40, ha="right", rotation_mode="anchor")
    axis.set_xlim(-0.7, len(names) - 0.3)
    axis.set_ylabel("millimetres")
    axis.spines[["top", "right"]].set_visible(False)


def _bridged(clip: Motion) -> np.ndarray:
    """Positions with straight lines across the gaps; a joint that was never measured stays NaN."""
    positions, frames = clip.positions.copy(), np.arange(len(clip))
    for joint, seen in enumerate(clip.observed.T):
        for axis in range(3) if seen.any() else ():
            positions[:, joint, axis] = np.interp(frames, frames[seen], clip.positions[seen, joint, axis])
    return positions


def _curves(axis, series: dict[str, np.ndarray], fps: float) -> None:
    """One curve a clip; measured samples are dots, so that lone ones between gaps stay visible."""
    looks = {
        "corrupted": {"linestyle": "", "marker": ".", "markersize": 3, "zorder": 1},
        "truth": {"linewidth": 3, "alpha": 0.55, "zorder": 2},
        "recovered": {"linewidth": 1.5, "zorder": 3},
    }
    for name, values in series.items():
        axis.plot(np.arange(len(values)) / fps, values, color=_COLOURS[name], **looks[name])
    axis.margins(x=0)
    axis.spines[["top", "right"]].set_visible(False)


def _band(axis, missing: np.ndarray, fps: float) -> None:
    for start, stop in runs_of(missing):
        axis.axvspan((start - 0.5) / fps, (stop - 0.5) / fps, color="0.9", linewidth=0, zorder=0)


def _hide(axes) -> None:
    for axis in axes:
        axis.axis("off")
