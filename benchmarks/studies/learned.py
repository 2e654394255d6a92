"""Tables of networks, on people never trained on: Choi et al. 2024, 2-6, Li et al. 2020, 1 and 3, Yang et al. 2020, V.

    python -m benchmarks.studies.learned --train [MINUTES]    trains the networks of the tables, one after the other
    python -m benchmarks.studies.learned [TABLE ...]          measures what the results lack, and renders the page
    python -m benchmarks.studies.learned --again METHOD ...   measures these methods anew
    python -m benchmarks.studies.learned --render             renders docs/reproduction.md from the results

Runs lie in MOTIONRECOVER_RUNS (runs/learned). A network without weights there is left out of what is measured, and one
that was trained further is measured anew. Clips are `--clips` of the subjects `HELD_OUT`, the middle `FRAMES` frames at
60 Hz on 21 joints; every seed draws another corruption. Networks refine a clip as `load_refiner` does, once with what
they make of observed samples and once with these kept. Results: `results/learned.json`, in centimetres.

    P    mean distance of all joints, as both papers count it; beside it that of the missing samples alone
    B    mean error of bone lengths
    J    mean over windows of 64 frames of | |O X|_2 / (T + 2) of the answer - that of the truth |, about the root
    R    mean absolute error of a coordinate (Li et al. 2020, Eq. 3 read so that its numbers can be)
    S    |O X|_2 / (T + 2) of the answer
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.people import left_out
from benchmarks.recordings import data_folder
from benchmarks.studies import learned_report
from benchmarks.studies.learned_tables import GUIDED, HELD_OUT, NETWORKS, ROWS, SUFFIXES, TABLES, Row
from benchmarks.suite import clips
from benchmarks.suite.clips import Clip
from benchmarks.suite.peers_time import cubic
from motionrecover import metrics, recover
from motionrecover.intake import fill
from motionrecover.io import write_beside
from motionrecover.refine import Refiner, load_refiner
from motionrecover.refine.normalise import CHOI, place
from motionrecover.refine.train import Settings, set_up, train

RESULTS = Path(__file__).parent / "results" / "learned.json"
RUNS = Path(os.environ.get("MOTIONRECOVER_RUNS", "runs/learned"))
FRAMES = 160
"""Of a clip: 2.7 s, which is two and a half windows of Choi's networks."""
SEEDS = 3
MEASURES = ("P", "missing", "B", "J", "R", "S")
Method = Callable[[np.ndarray, Clip], np.ndarray]


@dataclass(frozen=True)
class Baselines:
    """What needs no training but the mean pose, which is that of the subjects trained on."""

    mean: np.ndarray

    def linear(self, data: np.ndarray, clip: Clip) -> np.ndarray:
        """Straight lines in time; nothing for a joint never seen."""
        seen = np.isfinite(data[..., 0]).any(0)
        return np.where(seen[:, None], fill(data), np.nan)

    def cubic(self, data: np.ndarray, clip: Clip) -> np.ndarray:
        """Splines in time."""
        return cubic(data)

    def mean_pose(self, data: np.ndarray, clip: Clip) -> np.ndarray:
        """The mean pose where a sample is missing, put where the true clip has its root and heading."""
        everywhere = np.ones(len(clip.skeleton.names), bool)
        there = place(clip.positions, everywhere, clip.skeleton, CHOI, clip.fps)
        pose = there.outward(np.broadcast_to(self.mean, data.shape))
        return np.where(np.isnan(data), pose, data)

    def robust(self, data: np.ndarray, clip: Clip) -> np.ndarray:
        """The default preset, poses of the clip's own person left out."""
        with left_out(clip.name):
            return recover(data, clip.skeleton, fps=clip.fps, fill_unseen=True).positions

    def str_yang2020(self, data: np.ndarray, clip: Clip) -> np.ndarray:
        """The published model without a guide, which knows no joint that is never seen."""
        return recover(data, clip.skeleton, preset="str_yang2020", fps=clip.fps).positions


def methods_of(row: Row, networks: dict[str, Refiner], mean: np.ndarray) -> dict[str, Method]:
    """All that a row compares."""
    base = Baselines(mean)
    found: dict[str, Method] = {
        "linear": base.linear,
        "cubic": base.cubic,
        "mean pose": base.mean_pose,
        "robust": base.robust,
    }
    shown = {name for table in TABLES.values() if row.name in table.rows for name in table.beside}
    if "str_yang2020" in shown or (any(row.name in rows for rows in GUIDED.values()) and not row.joints):
        found["str_yang2020"] = base.str_yang2020
    for name, refiner in networks.items():
        if row.name in {r for table in TABLES.values() if name in table.networks for r in table.rows}:
            alone, kept, guides, turns = (name + suffix for suffix in SUFFIXES)
            found[alone] = _refined(refiner, keep=False)
            if not row.noisy:
                found[kept] = _refined(refiner, keep=True)
            if row.name in GUIDED.get(name, ()):
                found[guides], found[turns] = _guiding(refiner, 1), _guiding(refiner, 3)
    return found


def _refined(refiner: Refiner, keep: bool) -> Method:
    return lambda data, clip: refiner(data, clip.skeleton, fps=clip.fps, keep_observed=keep).positions


def _guiding(refiner: Refiner, rounds: int) -> Method:
    def run(data: np.ndarray, clip: Clip) -> np.ndarray:
        return recover(
            data, clip.skeleton, preset="str_yang2020", fps=clip.fps, guide=refiner, guide_rounds=rounds
        ).positions

    return run


def score(found: np.ndarray, data: np.ndarray, clip: Clip) -> list[float]:
    """The `MEASURES`, in centimetres."""
    truth, missing = clip.positions, np.isnan(data[..., 0])
    off = found - truth
    distance = np.linalg.norm(off, axis=-1)
    rough, true = (roughness(x - truth[:, :1]) for x in (found, truth))
    alone = distance[missing].mean() if missing.any() else np.nan
    bones = metrics.abe(found, truth, clip.skeleton)
    return [
        100 * float(x)
        for x in (distance.mean(), alone, bones, np.abs(rough - true).mean(), np.abs(off).mean(), rough.mean())
    ]


def roughness(about: np.ndarray, window: int = 64) -> np.ndarray:
    """|O X|_2 / (T + 2) of each window, the last one to the clip's end; `losses.smooth` in NumPy."""
    starts = {*range(0, len(about) - window + 1, window), max(0, len(about) - window)}
    cuts = [about[s : s + window] for s in sorted(starts)]
    padded = [np.concatenate([cut[:1], cut, cut[-1:]]) for cut in cuts]
    return np.array([np.linalg.norm(np.diff(x, 2, axis=0)) / len(x) for x in padded])


def measure(row: Row, found: dict, networks: dict[str, Refiner], mean: np.ndarray, folder: Path, count: int) -> dict:
    """The row's results with what they lack: method -> measure -> [mean, deviation over the seeds]."""
    wanted = {name: run for name, run in methods_of(row, networks, mean).items() if name not in found}
    if not wanted:
        return found
    # Corruptions first: all methods see the same, and a method one skeleton after the other.
    cases = [
        (clip, [row.corrupted(clip, seed) for seed in range(SEEDS)])
        for clip in (cut(clips.read(folder, name, "cmu21", 60)) for name in names(folder, count))
    ]
    for name, run in wanted.items():
        table = np.array(
            [[score(run(data.copy(), clip), data, clip) for data in corrupted] for clip, corrupted in cases]
        )
        per_seed = table.mean(0)
        found[name] = {
            m: [round(float(per_seed[:, k].mean()), 4), round(float(per_seed[:, k].std(ddof=1)), 4)]
            for k, m in enumerate(MEASURES)
            if np.isfinite(per_seed[:, k]).all()
        }
    return found


def names(folder: Path, count: int) -> list[str]:
    """The clips."""
    return clips.pick(folder, "cmu21", 60, count, HELD_OUT, 64)[0]


def cut(clip: Clip) -> Clip:
    """The middle `FRAMES` frames."""
    start = max(0, (len(clip.positions) - FRAMES) // 2)
    return Clip(clip.name, clip.positions[start : start + FRAMES], clip.skeleton, clip.fps)


def run_of(network: str) -> Path:
    """The folder of a network's run."""
    return RUNS / network.replace(" ", "-")


def train_all(folder: Path, seconds: float) -> None:
    """Trains the networks in the order of the tables until the time is over."""
    from motionrecover.skeleton import Skeleton

    end = time.monotonic() + seconds
    for name, network in NETWORKS.items():
        out = run_of(name)
        if (out / "weights.safetensors").is_file():
            continue
        settings = Settings(
            network.model,
            network.protocol,
            network.preset,
            held_out=HELD_OUT,
            steps=network.steps,
            heading=network.heading,
        )
        resume = (out / "config.json").is_file()
        run = set_up(settings, folder / "cmu" / "npz", out, Skeleton.standard("cmu21"), resume)
        for line in train(run, seconds=end - time.monotonic()):
            if line["held_out_mm"]:
                print(name, line["step"], round(line["held_out_mm"], 1), flush=True)
        if time.monotonic() > end:
            return


def main() -> None:
    """Train, measure, render."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", help=f"of {', '.join(TABLES)}; all if left out")
    parser.add_argument("--train", type=float, nargs="?", const=1e6, metavar="MINUTES")
    parser.add_argument("--again", nargs="+", default=[], metavar="METHOD")
    parser.add_argument("--render", action="store_true")
    parser.add_argument("--clips", type=int, default=4, help="(4) one a subject")
    asked, folder = parser.parse_args(), data_folder()
    if asked.train:
        train_all(folder, 60 * asked.train)
        return
    results = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    if not asked.render:
        runs = {name: run_of(name) for name in NETWORKS if list(run_of(name).glob("*.safetensors"))}
        networks = {name: load_refiner(path) for name, path in runs.items()}
        mean = next(each.normaliser.mean.astype(float) for each in networks.values() if each.convention == CHOI)
        results |= {"clips": names(folder, asked.clips), "seeds": SEEDS}
        rows, before = results.setdefault("rows", {}), results.get("steps", {})
        results["steps"] = before | {name: learned_report.steps_of(path) for name, path in runs.items()}
        trained = [name for name in runs if results["steps"][name] != before.get(name)]
        again = {name + suffix for name in (*asked.again, *trained) for suffix in SUFFIXES}
        for found in rows.values():
            for name in again & found.keys():
                del found[name]
        for row in dict.fromkeys(name for table in asked.tables or TABLES for name in TABLES[table].rows):
            began = time.monotonic()
            rows[row] = measure(ROWS[row], rows.get(row, {}), networks, mean, folder, asked.clips)
            with write_beside(RESULTS, overwrite=True) as temporary:
                temporary.write_text(learned_report.dumps(results))
            print(
                row,
                {name: each["P"][0] for name, each in rows[row].items() if "P" in each},
                f"{time.monotonic() - began:.0f} s",
                flush=True,
            )
    learned_report.write(results)


if __name__ == "__main__":
    main()
