"""What a record says of a recovery, and of a take that was recovered in parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from motionrecover.intake import fill
from motionrecover.motion import Motion
from motionrecover.recovery import Recovery
from motionrecover.report import account
from motionrecover.robust import Change

Facts = dict[str, Any]


def facts_of(clip: Motion, recovery: Recovery, answer: np.ndarray, of: slice = slice(None)) -> Facts:
    """Facts on a clip, its recovery and the positions (frame, joint, 3) of the answer, for some of the frames."""
    before, lengths = fill(account.measured(clip)), recovery.bone_lengths
    off = account.measures({"before": before[of], "after": answer[of]}, clip.skeleton, lengths)
    moved = account.moved(clip, recovery)[of]
    moved = moved[np.isfinite(moved)]
    verdict = account.verdict(recovery)
    return {
        "frames": len(answer[of]),
        "joints": len(clip.names),
        "converged": verdict["converged"],
        "message": verdict["message"],
        "steps": verdict["steps"],
        "samples": {kind.name.lower(): int((recovery.changed[of] == kind).sum()) for kind in Change},
        "moved_mm": _number(1000 * moved.mean() if moved.size else np.nan),
        "bone_length_deviation_mm": {name: _number(value) for name, value in off["bone_length_deviation_mm"].items()},
        "seconds": {name: round(value, 3) for name, value in verdict["seconds"].items()},
    }


def unseen(frames: int, joints: int) -> Facts:
    """Facts on a part in which nothing was measured."""
    return {
        "frames": frames,
        "joints": joints,
        "converged": True,
        "message": "",
        "steps": 0,
        "samples": {kind.name.lower(): frames * joints * (kind == Change.UNKNOWN) for kind in Change},
        "moved_mm": None,
        "bone_length_deviation_mm": {"before": None, "after": None},
        "seconds": {"compile": 0.0, "run": 0.0},
    }


def joined(parts: Sequence[Facts]) -> Facts:
    """Facts on all parts: counts and seconds add up, lengths are means over frames, the first bad verdict counts."""

    def mean(values: list[float | None]) -> float | None:
        known = [(value, part["frames"]) for value, part in zip(values, parts, strict=True) if value is not None]
        frames = sum(count for _, count in known)
        return _number(sum(value * count for value, count in known) / frames) if frames else None

    worst = next((part for part in parts if not part["converged"]), max(parts, key=lambda part: part["steps"]))
    return {
        "frames": sum(part["frames"] for part in parts),
        "joints": parts[0]["joints"],
        "converged": worst["converged"],
        "message": worst["message"],
        "steps": max(part["steps"] for part in parts),
        "samples": {name: sum(part["samples"][name] for part in parts) for name in parts[0]["samples"]},
        "moved_mm": mean([part["moved_mm"] for part in parts]),
        "bone_length_deviation_mm": {
            name: mean([part["bone_length_deviation_mm"][name] for part in parts]) for name in ("before", "after")
        },
        "seconds": {name: round(sum(part["seconds"][name] for part in parts), 3) for name in ("compile", "run")},
    }


def _number(value: float) -> float | None:
    """Four significant digits; None where there is no number."""
    return float(f"{value:.4g}") if np.isfinite(value) else None
