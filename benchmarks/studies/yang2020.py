"""Do the published models, run as published, give the published numbers? Yang et al. 2020, Sec. IV.

    python -m benchmarks.studies.yang2020             measures everything, writes the results and renders the page
    python -m benchmarks.studies.yang2020 table3      measures only the named sections anew
    python -m benchmarks.studies.yang2020 --render    renders docs/reproduction.md and its figures from the results
    python -m benchmarks.studies.yang2020 --quick     a small run that writes nothing, unless given --output

Needs the CMU clips: MOTIONRECOVER_DATA, or ../shared/data beside the repository. Errors are in millimetres.
"""

from __future__ import annotations

import argparse
import json
import platform
import re
import time
import warnings
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

import jax
import numpy as np

from benchmarks.recordings import GLITCHED, data_folder
from benchmarks.reference import algorithm1
from benchmarks.studies import yang2020_report
from benchmarks.studies.yang2020_protocol import (
    FULL,
    PIECE,
    QUICK,
    SEED,
    STR,
    WHOLE,
    Clip,
    Plan,
    clip_of,
    cmu25,
    energy,
    preset_positions,
    variant,
)
from benchmarks.suite.peers_time import cubic, running_median
from motionrecover import corrupt, intake, metrics
from motionrecover.io import MotionFormatWarning, load, write_beside
from motionrecover.motion import UNITS
from motionrecover.presets import PRESETS
from motionrecover.recovery import recover
from motionrecover.synthetic import synthesize

RESULTS = Path(__file__).parent / "results" / "yang2020.json"
# The 21 joints of Holden et al. 2016, by their names in the BVH files of cgspeed's conversion.
HOLDEN21 = (
    "Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase", "RightUpLeg", "RightLeg", "RightFoot", "RightToeBase",
    "Spine", "Spine1", "Neck1", "Head", "LeftArm", "LeftForeArm", "LeftHand", "LeftHandIndex1",
    "RightArm", "RightForeArm", "RightHand", "RightHandIndex1",
)  # fmt: skip
FILE_UNIT = UNITS["in"] / 0.45
"""Metres in one unit of CMU's files."""


def main(arguments: list[str] | None = None) -> dict:
    """The command line; returns the results."""
    parser = argparse.ArgumentParser(description="Reproduction of Yang et al. 2020.")
    parser.add_argument("sections", nargs="*", help=f"of {', '.join(SECTIONS)}; all if left out")
    parser.add_argument("--render", action="store_true", help="only render the page from the results")
    parser.add_argument("--quick", action="store_true", help="a small run")
    parser.add_argument("--output", type=Path, help="where the results go")
    asked = parser.parse_args(arguments)
    if unknown := set(asked.sections) - set(SECTIONS):
        parser.error(f"received sections {', '.join(sorted(unknown))}: choose from {', '.join(SECTIONS)}")
    results = json.loads(RESULTS.read_text()) if asked.render or (asked.sections and not asked.quick) else {}
    if not asked.render:
        output = asked.output or (None if asked.quick else RESULTS)
        plan, folder = QUICK if asked.quick else FULL, data_folder()
        versions = {name: version(name) for name in ("jax", "numpy", "scipy")}
        results |= {"versions": {"python": platform.python_version()} | versions, "seed": SEED}
        for section in asked.sections or SECTIONS:
            results[section] = SECTIONS[section](plan, folder)
            if output:
                with write_beside(output, overwrite=True) as temporary:
                    temporary.write_text(dumps(results))
    if not asked.quick:
        yang2020_report.write(results)
    return results


def table2(plan: Plan, folder: Path) -> dict:
    """Per clip: AJE and ABE of every method at every rate, on whole joints and, for subject 09, on single entries."""
    presets = PRESETS | {
        "windows of 300": replace(STR, window=PIECE),
        "whole clip": WHOLE["str_yang2020"],
    }
    methods = {
        "nothing": lambda clip, data, hit: data,
        **{f"median {n}": lambda clip, data, hit, n=n: running_median(data, n) for n in (5, 15, 31)},
        # No method knows this mask: it bounds what time alone can tell about a sample.
        "oracle spline": lambda clip, data, hit: cubic(np.where(hit[..., None], np.nan, data)),
        **{name: lambda clip, data, hit, p=p: preset_positions(p, clip, data) for name, p in presets.items()},
    }
    entries = [name for name in methods if name in ("nothing", *PRESETS)]
    rows = []
    for subject, names in plan.subjects.items():
        for name in names:
            clip = cmu25(name, folder)
            row = {"clip": name, "frames": len(clip.positions), "glitch": name in GLITCHED}
            row |= _rows(clip, plan.rates, methods)
            if subject == "09":
                row["entries"] = _rows(clip, plan.rates, {n: methods[n] for n in entries}, corrupt.entries)
            rows.append(row)
            print("table2", name, row["aje"]["str_yang2020"], flush=True)
    return {"rates": plan.rates, "clips": rows}


def _rows(clip: Clip, rates, methods, model=corrupt.joints, **how) -> dict:
    """`{"aje": {method: [a number a rate]}, "abe": ...}`."""
    aje, abe = {name: [] for name in methods}, {name: [] for name in methods}
    for rate in rates:
        data, hit = clip.corrupted(rate, model, **how)
        for name, method in methods.items():
            errors = clip.score(method(clip, data, hit))
            aje[name].append(errors[0])
            abe[name].append(errors[1])
    return {"aje": aje, "abe": abe}


def variants(plan: Plan, folder: Path) -> dict:
    """From the letter of Algorithm 1 to the preset, one change at a time: AJE, final energy and steps."""
    letter = replace(STR, initialisation="printed")
    runs = {
        "letter": partial(variant, letter, centre=False, zero=True),
        "from data": partial(variant, STR, centre=False, penalties="printed"),
        "centred": partial(variant, STR, penalties="printed"),
        "preset": partial(variant, STR),
        "preset from zero": partial(variant, STR, zero=True),
        "preset not centred": partial(variant, STR, centre=False),
        "preset in float64": partial(variant, STR, dtype=np.float64),
    }
    rates = [rate for rate in (5, 20, 80) if rate in plan.rates]
    rows = []
    for name in plan.few:
        clip = cmu25(name, folder).head(PIECE)
        row = {"clip": name, "frames": len(clip.positions), "aje": {}, "energy": {}, "steps": {}}
        for rate in rates:
            data, _ = clip.corrupted(rate)
            for run, solved in runs.items():
                positions, energies = solved(clip, data)
                row["aje"].setdefault(run, []).append(clip.score(positions)[0])
                row["energy"].setdefault(run, []).append(float(f"{energies[-1]:.6g}"))
                row["steps"].setdefault(run, []).append(len(energies))
            estimated = recover(data, clip.skeleton, preset=WHOLE["str_yang2020"]).positions
            row["aje"].setdefault("bones estimated", []).append(clip.score(estimated)[0])
            row["aje"].setdefault("nothing", []).append(clip.score(data)[0])
        rows.append(row)
        print("variants", name, row["aje"], flush=True)
    return {"rates": rates, "clips": rows}


def length(plan: Plan, folder: Path) -> dict:
    """First frames and whole clips, solved at once: AJE, and the energy of the answer over that of the truth."""
    rates = [rate for rate in (5, 20, 80) if rate in plan.rates]
    rows = []
    for name in plan.whole:
        clip = cmu25(name, folder)
        # `energy` needs a number of frames that is divisible by 4.
        whole = clip.head(len(clip.positions) // 4 * 4)
        for part, factor in ((whole.head(PIECE), 1), (whole, 1), (whole, 2), (whole, 4)):
            preset = replace(WHOLE["str_yang2020"], outlier_weight=factor)
            row = {"clip": name, "frames": len(part.positions), "factor": factor, "aje": [], "energy": []}
            for rate in rates:
                data, _ = part.corrupted(rate)
                answer = preset_positions(preset, part, data)
                ratio = energy(preset, part, data, answer) / energy(preset, part, data, part.positions)
                row["aje"].append(part.score(answer)[0])
                row["energy"].append(round(float(ratio), 4))
            rows.append(row)
            print("length", name, row, flush=True)
    return {"rates": rates, "rows": rows}


def fig2(plan: Plan, folder: Path) -> list:
    """Energy (Eq. 8) against the iteration at 10 %: the preset, and from A = D with the printed penalties."""
    rows = []
    for name in plan.curves:
        clip = cmu25(name, folder)
        data, _ = clip.corrupted(10)
        row = {"clip": name}
        for run, penalties in (("preset", "data"), ("early", "printed")):
            _, energies = variant(STR, clip, data, penalties=penalties)
            steps = np.unique(np.geomspace(1, len(energies), 60).round().astype(int))
            row[run] = {"steps": steps.tolist(), "energy": [float(f"{x:.4g}") for x in energies[steps - 1]]}
        rows.append(row)
    return rows


def fig3(plan: Plan, folder: Path) -> list:
    """AJE and ABE against each weight, the other two at the paper's values, at 10 and 20 %."""
    sweeps = {"outlier_weight": plan.factors, "isometry_weight": plan.gammas, "smoothness_weight": plan.mus}
    rows = []
    for name in plan.few:
        clip = cmu25(name, folder).head(PIECE)
        for rate in (10, 20):
            data, _ = clip.corrupted(rate)
            for field, values in sweeps.items():
                errors = [
                    clip.score(preset_positions(replace(WHOLE["str_yang2020"], **{field: value}), clip, data))
                    for value in values
                ]
                rows.append(
                    {
                        "clip": name,
                        "rate": rate,
                        "field": field,
                        "values": values,
                        "aje": [aje for aje, _ in errors],
                        "abe": [abe for _, abe in errors],
                    }
                )
        print("fig3", name, flush=True)
    return rows


def table3(plan: Plan, folder: Path) -> dict:
    """21 joints of the BVH files, +-2.5 inches, in three readings of what the numbers fed to the solver were.

    AJE in inches; in the reading `file` both noise and errors are in units of the file. The paper's weights stay the
    same numbers, the settings of our solver follow the unit: gamma |F|, which the penalty of the isometry term must
    exceed, grows with the square of a length. float64, because float32 leaves the finite numbers in inches.
    """
    rows = []
    for name in plan.bvh:
        with warnings.catch_warnings():
            # The files state no unit; the reader's assumption, 1/0.45 inch, is CMU's own.
            warnings.simplefilter("ignore", MotionFormatWarning)
            motion = load(folder / "cmu" / "bvh" / f"{name}.bvh", skip_first=True).select(HOLDEN21)
        truth = clip_of(name, motion)
        for reading, metres in {"metres": 1.0, "inches": UNITS["in"], "file": FILE_UNIT}.items():
            clip = replace(truth, positions=truth.positions / metres, lengths=truth.lengths / metres)
            presets = {
                key: replace(
                    preset,
                    reach=preset.reach / metres,
                    isometry_penalty_max=preset.isometry_penalty_max / metres**2,
                )
                for key, preset in PRESETS.items()
            }
            methods = {
                "nothing": lambda clip, data, hit: data,
                "median 5": lambda clip, data, hit: running_median(data, 5),
                **{
                    key: lambda clip, data, hit, p=p: preset_positions(p, clip, data, np.float64)
                    for key, p in presets.items()
                },
            }
            inch = UNITS["in"] if reading == "metres" else 1.0
            found = _rows(clip, plan.rates, methods, amplitude=2.5 * inch)["aje"]
            aje = {method: [round(x / inch / 1000, 4) for x in row] for method, row in found.items()}
            rows.append({"clip": name, "reading": reading, "aje": aje})
            print("table3", name, reading, aje["str_yang2020"], flush=True)
    return {"rates": plan.rates, "rows": rows}


def table6(plan: Plan, folder: Path) -> list:
    """Seconds for 40 iterations on made-up motion, each model on the whole clip, beside the plain reference."""
    rows = []
    for frames in plan.lengths:
        clip = clip_of("0", synthesize(frames / 120, 120))
        data, _ = clip.corrupted(20)
        row = {"frames": frames, "seconds": {}, "compile": {}}
        for name, preset in WHOLE.items():
            call = partial(recover, data, clip.skeleton, preset=preset, bone_lengths=clip.lengths, max_steps=40)
            first = call()
            row["compile"][name] = round(first.seconds["compile"], 2)
            row["seconds"][name] = float(f"{min(call().seconds['run'] for _ in range(plan.repeats)):.3g}")
        row["reference"], apart = _reference(clip, data, first.positions)
        row["apart_mm"] = round(1000 * apart, 4)
        full = recover(data, clip.skeleton, preset=STR, bone_lengths=clip.lengths)
        row["until_done"] = {"seconds": round(full.seconds["run"], 2), "steps": full.steps}
        rows.append(row)
        print("table6", row, flush=True)
    return rows


def _reference(clip: Clip, data: np.ndarray, ours: np.ndarray) -> tuple[float, float]:
    """Seconds of the reference with the settings of the preset, and the mean distance of its answer from ours."""
    taken = intake.take_in(data, clip.skeleton, bone_lengths=clip.lengths)
    with jax.enable_x64(True):
        problem, origin = taken.problem(slice(0, len(data)), len(data), np.dtype(np.float64))
        solver = STR.solver(problem)
    settings = [np.asarray(x) for x in (solver.outlier_weight, solver.isometry_weight, solver.smoothness_weight)]
    rho = [np.asarray(x) for x in (solver.penalty, solver.penalty_growth, solver.penalty_max)]
    wall, cpu = time.perf_counter(), time.process_time()
    answer, _, _ = algorithm1(
        intake.matrix_from(data - origin), clip.skeleton.edges, clip.lengths, *settings, *rho, steps=40
    )
    # The smaller one: it runs once, and other work on the machine shall not make it look slow.
    seconds = min(time.perf_counter() - wall, time.process_time() - cpu)
    return float(f"{seconds:.3g}"), metrics.aje(intake.positions_from(answer) + origin, ours)


def dumps(results: dict) -> str:
    """JSON with a row of numbers a line."""
    text = json.dumps(results, indent=1)
    return re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), text) + "\n"


SECTIONS = {
    "variants": variants,
    "length": length,
    "table2": table2,
    "fig2": fig2,
    "fig3": fig3,
    "table3": table3,
    "table6": table6,
}

if __name__ == "__main__":
    main()
