"""What the commands report: plain dictionaries for JSON, and the same as text. Lengths in millimetres."""

from __future__ import annotations

from typing import Any

import numpy as np

from motionrecover import metrics
from motionrecover.cli.terminal import mm, percent, table
from motionrecover.evidence.bone_lengths import estimate_bone_lengths
from motionrecover.evidence.rigid_graph import spreads
from motionrecover.io.border import counted
from motionrecover.motion import UNITS, Motion
from motionrecover.recovery import Recovery
from motionrecover.report.account import measured
from motionrecover.skeleton import ZERO_LENGTH

AJE, ABE, DEVIATION = "joint error (AJE)", "bone-length error (ABE)", "bone-length deviation"
"""The last is the mean of |length - one length a bone|: of a rigid body it is 0."""

Facts = dict[str, Any]


def size(motion: Motion) -> str:
    """`960 frames at 120 fps (8.0 s), 25 joints`."""
    return (
        f"{counted(len(motion), 'frame')} at {motion.fps:g} fps ({motion.seconds:.1f} s), "
        f"{counted(len(motion.names), 'joint')}"
    )


def contents(motion: Motion) -> Facts:
    """What a motion holds."""
    skeleton, positions = motion.skeleton, measured(motion)
    found = skeleton.bone_lengths_of(positions)
    typical = estimate_bone_lengths(found).length
    lengths = typical if skeleton.rest_lengths is None else skeleton.rest_lengths
    steps = np.nan_to_num(np.linalg.norm(np.diff(positions, axis=0), axis=-1))
    if not steps.size:
        steps = np.zeros((1, len(motion.names)))
    frame, joint = divmod(int(steps.argmax()), steps.shape[1])
    return {
        "frames": len(motion),
        "fps": float(motion.fps),
        "seconds": float(motion.seconds),
        "joints": list(motion.names),
        "skeleton": "tree" if skeleton.is_forest else "graph",
        "skeleton_parts": len(skeleton.components),
        "bones": len(skeleton.edges),
        "zero_length_bones": [skeleton.bone_names[bone] for bone in np.flatnonzero(lengths < ZERO_LENGTH)],
        "rest_pose": skeleton.rest_offsets is not None,
        "unit_in_metres": float(motion.unit),
        "up": motion.up,
        "missing_share": float((~motion.observed).mean()),
        "largest_step_mm": 1000 * float(steps.max()),
        "largest_step_at": {"frame": frame + 1, "joint": motion.names[joint]},
        "bone_length_deviation_mm": 1000 * metrics.abe(positions, typical, skeleton, motion.observed),
        "history": list(motion.history),
    }


def print_contents(facts: Facts) -> None:
    """Print what `contents` found."""
    metres = facts["unit_in_metres"]
    unit = next((name for name, each in UNITS.items() if each == metres), f"{metres:.6g} m")
    skeleton = f"{facts['skeleton']} of {counted(facts['bones'], 'bone')}"
    if facts["skeleton_parts"] > 1:
        skeleton += f" in {facts['skeleton_parts']} parts"
    if facts["zero_length_bones"]:
        skeleton += f", {len(facts['zero_length_bones'])} of length 0"
    if facts["rest_pose"]:
        skeleton += ", with a rest pose"
    step = "{}, {joint} into frame {frame}".format(mm(facts["largest_step_mm"]), **facts["largest_step_at"])
    if facts["largest_step_at"]["frame"] == 1 and facts["largest_step_mm"] > 100:
        step += " (if frame 0 is an added T-pose: --skip-first)"
    table(
        ("", ""),
        [
            ("length", f"{counted(facts['frames'], 'frame')} at {facts['fps']:g} fps, {facts['seconds']:.2f} s"),
            ("joints", f"{len(facts['joints'])}: {', '.join(facts['joints'])}"),
            ("skeleton", skeleton),
            ("unit and up of the file", f"{unit}, {facts['up']}"),
            ("missing", f"{percent(facts['missing_share'])} of the samples"),
            ("largest step", step if facts["largest_step_mm"] else "-"),
            (DEVIATION, mm(facts["bone_length_deviation_mm"])),
            *(("" if line else "history", text) for line, text in enumerate(facts["history"])),
        ],
    )


def bones(motion: Motion) -> list[Facts]:
    """How well each bone keeps its length, over the frames that show both ends."""
    skeleton = motion.skeleton
    first, second = np.asarray(skeleton.edges, int).reshape(-1, 2).T
    length, spread = spreads(measured(motion), first, second)
    share = np.divide(spread, length, where=length > 0, out=np.full(len(length), np.nan))
    together = (motion.observed[:, first] & motion.observed[:, second]).sum(0)
    return [
        {
            "bone": [skeleton.names[i], skeleton.names[j]],
            "length_mm": 1000 * float(length[bone]),
            "spread_mm": 1000 * float(spread[bone]),
            "spread_share": float(share[bone]),
            "frames": int(together[bone]),
        }
        for bone, (i, j) in enumerate(skeleton.edges)
    ]


def print_bones(found: list[Facts], frames: int) -> None:
    """Print what `bones` found in a clip of so many frames."""
    rows = [
        (
            "-".join(bone["bone"]),
            mm(bone["length_mm"]),
            mm(bone["spread_mm"]),
            percent(bone["spread_share"]),
            bone["frames"],
        )
        for bone in found
    ]
    table(("bone", "length", "varies by", "", f"frames of {frames}"), [tuple(map(str, row)) for row in rows])


def reason(bone: Facts, frames: int) -> str:
    """One of `bones` in a line."""
    varies = f"{mm(bone['spread_mm'])} ({percent(bone['spread_share'])})"
    return f"{mm(bone['length_mm'])}, varies by {varies}, seen in {bone['frames']} of {frames} frames"


def apart(motion: Motion, other: Motion) -> Facts:
    """Distance of the joints that both know."""
    off = 1000 * np.linalg.norm(motion.positions - other.positions, axis=-1)
    off = off[np.isfinite(off)]
    return {"mean": float(off.mean()), "largest": float(off.max())} if len(off) else {"mean": 0.0, "largest": 0.0}


def verdict_line(recovery: Recovery) -> str:
    """The verdict in a line, or in its own sentence where it is not the best one."""
    seconds = f"compiled in {recovery.seconds['compile']:.1f} s, ran {recovery.seconds['run']:.1f} s"
    if recovery.converged:
        return f"converged after {counted(recovery.steps, 'step')}; {seconds}"
    return f"{recovery.message}\n{counted(recovery.steps, 'step')}; {seconds}"


def print_changes(facts: Facts) -> None:
    """Print what `changes` found."""
    total = sum(facts["samples"].values())
    print(", ".join(f"{kind} {percent(n / total)}" for kind, n in facts["samples"].items() if n), "of the samples")
    if facts["filled_uncertainty_mm"] is not None:
        print(f"filled samples are uncertain by {mm(facts['filled_uncertainty_mm'])} (root mean square)")
    for swap in facts["swaps"]:
        print(f"swapped, put right: {swap}")
    if facts["never_seen"]:
        print(f"never seen: {', '.join(facts['never_seen'])}")
    if facts["partly_unknown"]:
        print(f"missing in part or throughout, also in the answer: {', '.join(facts['partly_unknown'])}")


def print_apart(facts: Facts) -> None:
    """Print what `apart` found."""
    off = facts["rotations_mm"]
    print(
        f"written as rotations, joints are off by {off['mean']:.3f} mm in the mean and {off['largest']:.3f} mm at most"
    )


def print_measures(facts: Facts) -> None:
    """Print what `measures` found."""
    names = {"aje_mm": AJE, "abe_mm": ABE, "bone_length_deviation_mm": DEVIATION}
    rows = [(name, *map(mm, facts[key].values())) for key, name in names.items() if key in facts]
    table(("", *facts["bone_length_deviation_mm"]), rows)


def comparison(clip: Motion, truth: Motion, common: list[str]) -> Facts:
    """Errors of a clip against a truth with the same frames and joints, of which `common` are known."""
    counts = clip.observed & truth.observed
    where = {name: clip.names.index(name) for name in common}
    lengths = estimate_bone_lengths(clip.skeleton.bone_lengths_of(truth.positions)).length
    joints = {
        name: 1000 * metrics.aje(clip.positions[:, [j]], truth.positions[:, [j]], counts[:, [j]])
        for name, j in where.items()
        if counts[:, j].any()
    }
    return {
        "frames": len(clip),
        "joints": common,
        "compared_share": float(counts[:, list(where.values())].mean()),
        "aje_mm": 1000 * metrics.aje(clip.positions, truth.positions, counts),
        "abe_mm": 1000 * metrics.abe(clip.positions, truth.positions, clip.skeleton, counts),
        "bone_length_deviation_mm": 1000 * metrics.abe(clip.positions, lengths, clip.skeleton, counts),
        "acceleration_ratio": metrics.acceleration_ratio(clip.positions, truth.positions, counts),
        "worst_joints_mm": dict(sorted(joints.items(), key=lambda item: -item[1])[:5]),
    }


def print_comparison(facts: Facts) -> None:
    """Print what `comparison` found."""
    if facts["compared_share"] < 1:
        print(f"missing in either, and left out: {percent(1 - facts['compared_share'])} of their samples")
    print()
    worst = [f"{name} {mm(error)}" for name, error in facts["worst_joints_mm"].items()]
    table(
        ("", ""),
        [
            (AJE, mm(facts["aje_mm"])),
            (ABE, mm(facts["abe_mm"])),
            (DEVIATION, mm(facts["bone_length_deviation_mm"])),
            ("acceleration, true one = 1", f"{facts['acceleration_ratio']:.2f}"),
            ("worst joints", ", ".join(worst)),
        ],
    )
