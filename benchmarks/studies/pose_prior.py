"""What the poses of other people are worth, and the file of them that the package ships.

    python -m benchmarks.studies.pose_prior --train
    python -m benchmarks.studies.pose_prior [--clips N] [--seeds N] [--output FILE]

`--train` writes `motionrecover/poses.npz` from all CMU recordings with 31 joints. The study leaves the subject of each
clip out of the poses. `unseen`: a joint is hidden in the whole of a clip, every joint in turn, and bones are estimated;
mean error on it in mm, beside the straight limbs that robust draws without poses (with the true bone lengths), and the
mean pose in the same frame and proportions. `gaps`: rows of the suite with and without poses. Results:
`results/pose_prior.json`.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path
from unittest.mock import patch

import numpy as np

from benchmarks.people import left_out, person, strangers
from benchmarks.recordings import GLITCHED, MANIFEST, data_folder
from benchmarks.suite import clips, measure, rows
from motionrecover import finishing, poses, recover
from motionrecover.evidence import pose_prior
from motionrecover.evidence.local_shape import rigid_frames
from motionrecover.evidence.regression import bone_distance
from motionrecover.io import load
from motionrecover.io.atomic import write_beside
from motionrecover.skeleton import Skeleton

POSES = 800
STEP = 6
"""Of the frames at 120 Hz, those that `unseen` looks at are so far apart."""
SECONDS = {"compile": 0.0, "run": 0.0}
GAPS = ("gap3x60 cmu25 120 Hz", "gap3x240 cmu25 120 Hz", "gap3x60 cmu21 120 Hz", "gap3x240 cmu21 120 Hz")


def train(folder: Path) -> dict[str, np.ndarray]:
    """`positions` (pose, joint, 3), each centred, `bodies` (pose,), and the names of the `people` that these are.

    A recording counts by the root of its length; its poses are evenly spread over it.
    """
    with (folder / MANIFEST).open(encoding="utf-8") as file:
        table = [r for r in csv.DictReader(file) if r["skeleton"] == "asfamc31" and r["clip"] not in GLITCHED]
    people = sorted({person(row["clip"]) for row in table})
    share = np.sqrt([float(row["frames"]) for row in table])
    ends = (POSES * np.cumsum(share) / share.sum()).round().astype(int)
    positions, bodies = [], []
    for row, count in zip(table, np.diff(ends, prepend=0), strict=True):
        motion = load(folder / "cmu" / "npz" / f"{row['clip']}.npz").select(poses.NAMES)
        frames = motion.positions[np.linspace(0, len(motion.positions) - 1, count + 2).round().astype(int)[1:-1]]
        positions.append(frames - frames.mean(1, keepdims=True))
        bodies += [people.index(person(row["clip"]))] * len(frames)
    return {
        "positions": np.concatenate(positions).astype(np.float32),
        "bodies": np.array(bodies, np.uint8),
        "people": np.array(people),
    }


def unseen(folder: Path, skeleton: str, count: int) -> dict[str, dict[str, float]]:
    """Mean error in mm on each joint never seen, by what places it, and the root mean square of error over
    uncertainty."""
    standard, found = Skeleton.standard(skeleton), {}
    unmeasured = np.full(len(standard.edges), np.nan)
    for name in clips.pick(folder, skeleton, 120, count)[0]:
        clip = clips.read(folder, name, skeleton, 120)
        truth = clip.positions[::STEP]
        people = strangers(name).of([poses.NAMES.index(label) for label in standard.names])
        for joint, label in enumerate(standard.names):
            data = truth.copy()
            data[:, joint] = np.nan
            placed, variance = finishing.place_by_poses(data, people, standard.edges, unmeasured, 64, dict(SECONDS))
            off = np.linalg.norm(placed - truth, axis=-1)[:, joint]
            straight = finishing.fill_unseen(data, standard.edges, clip.bone_lengths)[:, joint]
            errors = {
                "poses": off.mean(),
                "squared": (off**2).mean(),
                "claimed": 3 * variance[:, joint].mean(),
                "mean pose": _mean_pose(data, joint, standard, people, truth),
                "bones": np.linalg.norm(straight - truth[:, joint], axis=-1).mean(),
            }
            for key, value in errors.items():
                found.setdefault(label, {}).setdefault(key, []).append(value)
    table = {}
    for label, errors in found.items():
        means = {key: float(np.nanmean(values)) for key, values in errors.items()}
        table[label] = {key: round(1e3 * means[key], 1) for key in ("poses", "mean pose", "bones")}
        table[label]["error over uncertainty"] = round(float(np.sqrt(means["squared"] / means["claimed"])), 2)
    kinds = next(iter(table.values()))
    return {"mean": {key: round(float(np.mean([row[key] for row in table.values()])), 2) for key in kinds}} | table


def _mean_pose(data, joint, standard, people, truth):
    """Mean error of the joint in the mean of the poses, on this body and fitted to its other joints."""
    body = pose_prior.proportioned(people, pose_prior.median_distances(data)).positions
    others = np.arange(len(standard.names)) != joint
    away = bone_distance(standard.edges, len(others))[joint, others]
    weights = np.tile(np.exp(-(away - away.min()) / finishing.NEAR), (len(body) + len(data), 1))
    rotations, centres, _ = rigid_frames(np.concatenate([body, data])[:, others], weights, len(body))
    local = np.einsum("ti,tij->tj", body[:, joint] - centres[: len(body)], rotations[: len(body)]).mean(0)
    placed = centres + rotations @ local
    return np.linalg.norm(placed[len(body) :] - truth[:, joint], axis=-1).mean()


def gaps(folder: Path, name: str, count: int, seeds: int) -> dict[str, float]:
    """Mean error in mm over the missing samples of a row of the suite, with poses and without."""
    row, found = rows.find([name])[0], {"poses": [], "none": []}
    for clip_name in clips.pick(folder, row.skeleton, row.fps, count, row.subjects, row.frames)[0]:
        clip = clips.read(folder, clip_name, row.skeleton, row.fps)
        for seed in range(seeds):
            data = row.corrupted(clip, seed)
            for key, least in (("poses", poses.LEAST), ("none", np.inf)):
                with left_out(clip_name), patch.object(poses, "LEAST", least):
                    answer = recover(data.copy(), clip.skeleton, fps=clip.fps, dtype=np.float64)
                found[key].append(measure.score(answer.positions, data, clip)[row.headline])
    return {key: round(float(np.mean(values)), 2) for key, values in found.items()}


def main() -> None:
    """Train, or measure, print and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--train", action="store_true", help="write the poses that the package ships, and end")
    parser.add_argument("--clips", type=int, default=6, help="a skeleton and a row, each of another subject (6)")
    parser.add_argument("--seeds", type=int, default=1, help="of the gaps (1)")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "pose_prior.json")
    asked, folder = parser.parse_args(), data_folder()
    if asked.train:
        with write_beside(Path(poses.__file__).with_name(poses.FILE), overwrite=True) as temporary:
            np.savez_compressed(temporary, **train(folder))
        return
    results = {"clips": asked.clips, "seeds": asked.seeds, "unseen": {}, "gaps": {}}
    for skeleton in ("cmu21", "cmu25"):
        results["unseen"][skeleton] = unseen(folder, skeleton, asked.clips)
        print(skeleton, results["unseen"][skeleton]["mean"], flush=True)
    for name in GAPS:
        results["gaps"][name] = gaps(folder, name, asked.clips, asked.seeds)
        print(name, results["gaps"][name], flush=True)
    with write_beside(asked.output, overwrite=True) as temporary:
        temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
