"""The figures of docs/reproduction.md: Fig. 2 to 5 of Yang et al. 2020, measured anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

# Okabe & Ito's colours, which colour-blind readers tell apart.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
MARKERS = "os^D"
PRESETS = ("lowrank_wang2016", "isometry_li2017", "str_yang2020")
SWEEPS = {
    "outlier_weight": ("λ √T", 1.0),
    "isometry_weight": ("γ (1/m³)", 100.0),
    "smoothness_weight": ("μ", 0.01),
}
"""Axis label, and the paper's value."""


def draw(results: dict, folder: Path) -> None:
    """Writes the figures into the folder."""
    folder.mkdir(exist_ok=True)
    for name, figure in (
        ("energy", _energy(results)),
        ("weights", _weights(results)),
        ("joint_errors_09", _joint_errors(results)),
        ("bone_errors_09", _bone_errors(results)),
    ):
        # Without metadata the same results give the same bytes.
        figure.savefig(folder / f"yang2020_{name}.png", dpi=72, metadata={"Software": None})


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _energy(results: dict) -> Figure:
    """Fig. 2: energy over that of the preset's last step."""
    figure = _figure(8, 3.6)
    for axis, (run, title) in zip(
        figure.subplots(1, 2, sharey=True),
        {"preset": "preset", "early": "A = D, ρ as printed"}.items(),
        strict=True,
    ):
        for row, colour in zip(results["fig2"], COLOURS, strict=False):
            energy = np.array(row[run]["energy"])
            axis.plot(row[run]["steps"], energy / row["preset"]["energy"][-1], color=colour, label=row["clip"])
        axis.set(xscale="log", yscale="log", xlabel="iteration", title=title)
        axis.grid(alpha=0.3)
    figure.axes[0].set_ylabel("energy (Eq. 8) / the preset's last")
    figure.axes[0].legend(frameon=False)
    return figure


def _weights(results: dict) -> Figure:
    """Fig. 3: AJE (left axis, full) and ABE (right axis, dashed) against each weight."""
    rows = results["fig3"]
    clips = list(dict.fromkeys(row["clip"] for row in rows))
    figure = _figure(11, 7.5)
    for line, (field, (label, printed)) in zip(
        figure.subplots(len(SWEEPS), len(clips), squeeze=False), SWEEPS.items(), strict=True
    ):
        for axis, clip in zip(line, clips, strict=True):
            bone_axis = axis.twinx()
            for rate, colour in ((10, COLOURS[0]), (20, COLOURS[1])):
                (row,) = (r for r in rows if (r["clip"], r["rate"], r["field"]) == (clip, rate, field))
                axis.plot(row["values"], row["aje"], "o-", color=colour, markersize=4, label=f"AJE, {rate} %")
                bone_axis.plot(row["values"], row["abe"], "s--", color=colour, markersize=3, label=f"ABE, {rate} %")
            axis.axvline(printed, color="0.5", linewidth=1, linestyle=":")
            axis.set(xscale="log", yscale="log", xlabel=label)
            bone_axis.set_yscale("log")
            if field == "outlier_weight":
                axis.set_xticks(row["values"], [f"{value:g}" * (value != 1.5) for value in row["values"]])
                axis.minorticks_off()
            if field == "outlier_weight":
                axis.set_title(clip)
            if clip == clips[0]:
                axis.set_ylabel("AJE (mm)")
            if clip == clips[-1]:
                bone_axis.set_ylabel("ABE (mm)")
    handles = figure.axes[0].lines[:2] + bone_axis.lines[:2]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _joint_errors(results: dict) -> Figure:
    """Fig. 4: AJE of the sequences of subject 09."""
    rows, rates = _subject09(results)
    figure = _figure(8, 3.6)
    axis = figure.subplots()
    for k, (colour, marker) in enumerate(zip(COLOURS, MARKERS, strict=True)):
        errors = [row["aje"]["str_yang2020"][k] for row in rows]
        axis.plot([row["clip"] for row in rows], errors, f"{marker}-", color=colour, label=f"{rates[k]} %")
    axis.set(ylabel="AJE (mm)", ylim=(0, None))
    axis.tick_params(axis="x", rotation=45)
    axis.grid(alpha=0.3)
    axis.legend(frameon=False, ncols=4)
    return figure


def _bone_errors(results: dict) -> Figure:
    """Fig. 5: ABE of the sequences of subject 09, in centimetres as printed."""
    rows, rates = _subject09(results)
    figure = _figure(11.5, 3.4)
    for k, axis in enumerate(figure.subplots(1, 4, sharey=True)):
        for preset, colour, marker in zip(PRESETS, COLOURS, MARKERS, strict=False):
            errors = [row["abe"][preset][k] / 10 for row in rows]
            axis.plot(
                [int(row["clip"][3:]) for row in rows], errors, f"{marker}-", color=colour, markersize=4, label=preset
            )
        axis.set(
            title=f"{rates[k]} %", xlabel="sequence of subject 09", yscale="log", xticks=range(1, len(rows) + 1, 2)
        )
        axis.grid(alpha=0.3)
    figure.axes[0].set_ylabel("ABE (cm)")
    figure.legend(handles=figure.axes[0].lines, loc="outside upper center", ncols=3, frameon=False)
    return figure


def _subject09(results: dict) -> tuple[list[dict], list[int]]:
    return [row for row in results["table2"]["clips"] if row["clip"].startswith("09")], results["table2"]["rates"]
