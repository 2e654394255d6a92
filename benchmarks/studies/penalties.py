"""Which penalties make Algorithm 1 converge, and from how many frames on it helps: evidence for `presets.Preset`.

    python -m benchmarks.studies.penalties [--output FILE]

Question 1: AJE and steps of `str_yang2020` under other starts, growths and ends of the penalties, on clips of 8 to 1918
frames. Question 2: how often a clip of a few frames comes back worse than it went in. Corruption is that of Yang et al.
2020, Table II; bone lengths are the true ones, as there. Results: `results/penalties.json`.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.recordings import data_folder
from benchmarks.studies.yang2020_protocol import cmu25
from motionrecover import corrupt, metrics
from motionrecover.evidence.bone_lengths import estimate_bone_lengths
from motionrecover.io.atomic import write_beside
from motionrecover.presets import PRESETS
from motionrecover.recovery import recover

STR = replace(PRESETS["str_yang2020"], window=None)
CLIPS = {"05_02": 300, "09_01": 148, "05_10": 300, "09_12": 1918, "05_05": 30, "09_03": 8}
RATES = (0.0, 0.05, 0.2)
ENDLESS = {"reach": 1e-9, "isometry_penalty_max": 1e9}
VARIANTS = {
    "preset": {},
    "penalties grow without end": ENDLESS,
    "first penalty x 0.1": {"penalty": 0.125},
    "first penalty x 10": {"penalty": 12.5},
    "growth 1.05": {"penalty_growth": 1.05},
    "growth 2": {"penalty_growth": 2.0},
    "reach 5 mm": {"reach": 0.005},
    "reach 8 cm": {"reach": 0.08},
    "isometry penalty up to 1": {"isometry_penalty_max": 1.0},
    "isometry penalty up to 3": {"isometry_penalty_max": 3.0},
    "isometry penalty up to 100": {"isometry_penalty_max": 100.0},
    "printed": {"initialisation": "printed"},
}
SHORT_CLIPS = ("05_02", "05_10", "09_01", "09_05", "05_15", "09_11")
SHORT_FRAMES = (1, 2, 3, 4, 5, 6, 7, 8)
SHORT_RATES = (0.05, 0.2, 0.8)
SHORT_SEEDS = 30


def schedules(data: Path) -> dict:
    """AJE in mm after 40 steps and at the end, and the steps to the end, of every variant on every clip and rate."""
    table: dict[str, dict] = {name: {} for name in VARIANTS}
    for clip, frames in CLIPS.items():
        known = cmu25(clip, data)
        truth, skeleton, lengths = known.positions[:frames], known.skeleton, known.lengths
        for rate in RATES:
            corrupted, _ = corrupt.joints(truth, rate, seed=1)
            for name, changes in VARIANTS.items():
                preset = replace(STR, **changes)
                early, end = (
                    recover(corrupted, skeleton, preset=preset, bone_lengths=lengths, max_steps=steps)
                    for steps in (40, preset.max_steps)
                )
                table[name][f"{clip} {rate:.0%}"] = {
                    "before": round(1000 * metrics.aje(corrupted, truth), 2),
                    "after 40 steps": round(1000 * metrics.aje(early.positions, truth), 2),
                    "at the end": round(1000 * metrics.aje(end.positions, truth), 2),
                    "steps": end.steps if end.converged else f"over {preset.max_steps}",
                }
    return table


def short_clips(data: Path) -> dict:
    """How many corrupted pieces of a few frames came back worse, of how many, and the mean ratio of AJE."""
    preset, table = replace(STR, min_frames=1), {}
    for frames in SHORT_FRAMES:
        for rate in SHORT_RATES:
            ratios: dict[str, list[float]] = {"true lengths": [], "estimated lengths": []}
            for clip, seed in product(SHORT_CLIPS, range(SHORT_SEEDS)):
                known = cmu25(clip, data)
                truth = known.positions[40 : 40 + frames]
                corrupted, hit = corrupt.joints(truth, rate, seed=seed)
                estimate = estimate_bone_lengths(known.skeleton.bone_lengths_of(corrupted)).length
                for name, lengths in zip(ratios, (known.lengths, estimate), strict=True):
                    if hit.any():
                        found = recover(corrupted, known.skeleton, preset=preset, bone_lengths=lengths).positions
                        ratios[name].append(metrics.aje(found, truth) / metrics.aje(corrupted, truth))
            table[f"{frames} frames, {rate:.0%}"] = {
                name: {
                    "worse": sum(r > 1 for r in found),
                    "of": len(found),
                    "mean ratio": round(float(np.mean(found)), 3),
                }
                for name, found in ratios.items()
            }
    return table


def main() -> None:
    """Run both questions and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "penalties.json")
    output = parser.parse_args().output
    data = data_folder()
    results = {"unit": "mm", "schedules": schedules(data), "short clips": short_clips(data)}
    output.parent.mkdir(exist_ok=True)
    with write_beside(output, overwrite=True) as temporary:
        temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    for name, rows in results["schedules"].items():
        print(f"{name:28}", *(f"{row['at the end']:7.2f} ({row['steps']})" for row in rows.values()))
    for name, row in results["short clips"].items():
        print(name, row)


if __name__ == "__main__":
    main()
