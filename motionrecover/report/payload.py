"""What the page draws, packed: every sample for a clip of ordinary length, the worst frame of each bin for a long one.

A series (frame, ...) is counted in tenths of a millimetre as 32-bit integers, differenced along time, split into its
four byte planes, compressed and written in base64. Smooth motion then takes about one byte a number; `data.js` undoes
it.
"""

from __future__ import annotations

import base64
import gzip
from typing import Any

import numpy as np

from motionrecover.motion import Motion
from motionrecover.recovery import Recovery
from motionrecover.report.account import Feet, Moment, binned, extent, feet, measured
from motionrecover.robust import Change

STEP = 1e-4
"""Metres in one count."""
MISSING = -(2**31)
"""The count of NaN."""
SHADES = {
    Change.UNTOUCHED: ("#e9edf1", "#e9edf1", "#e9edf1"),
    Change.DENOISED: ("#eaf4fb", "#cfe6f5", "#b3d9f1"),
    Change.REPAIRED: ("#f2a66b", "#d55e00", "#8f3d00"),
    Change.FILLED: ("#dba3cc", "#a64d92", "#6b2a5d"),
    Change.UNKNOWN: ("#111111", "#111111", "#111111"),
}
"""Colours of what was hardly changed, changed three quarters of the most, and most. Kinds differ in lightness too."""
SAMPLES = 1_200_000
"""Samples of joints, over all clips, that a page holds at most: with noise in the input that is 7 MB."""


def pack(values: np.ndarray, step: float = STEP) -> str:
    """The base64 of a series (frame, ...) in counts of `step`, NaN where it is not finite."""
    counts = np.clip(np.nan_to_num(np.round(np.asarray(values, np.float64) / step), posinf=0, neginf=0), -2e9, 2e9)
    counts = np.where(np.isfinite(values), counts, MISSING).astype(np.int32).reshape(len(values), -1)
    steps = np.diff(counts, axis=0, prepend=np.int32(0))  # wraps around and back where samples are missing
    planes = np.ascontiguousarray(steps).view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(gzip.compress(planes.tobytes(), 6, mtime=0)).decode()


def payload(clip: Motion, recovery: Recovery, truth: Motion | None, found: list[Moment]) -> dict[str, Any]:
    """What `page.js` needs, as JSON can hold it. Names are as they came: the page escapes them where it shows them."""
    shown, size = _shown(clip, recovery, 2 if truth is None else 3, found)
    steps = feet(clip, recovery)
    series = {
        "input": pack(measured(clip)[shown]),
        "recovered": pack(recovery.positions[shown]),
        "uncertainty": pack(recovery.uncertainty[shown]),
        # Two of the kinds at once: the graver one counts, and its extent.
        "changed": pack(binned(recovery.changed, size), 1),
        "extent": pack(binned(_within(recovery.changed, extent(clip, recovery), size), size)),
        "slide": pack(binned(np.nan_to_num(steps.speeds, nan=-1.0), size)),
    }
    if truth is not None:
        series["truth"] = pack(measured(truth)[shown])
    skeleton = clip.skeleton
    return {
        "names": list(clip.names),
        "edges": [[int(i), int(j)] for i, j in skeleton.edges],
        "bones": list(skeleton.bone_names),
        "lengths": _plain(recovery.bone_lengths),
        "intervals": _plain(recovery.bone_intervals),
        "fps": float(clip.fps),
        "frames": len(clip),
        "size": size,
        "shown": shown.tolist(),
        "feet": _feet(steps),
        "shades": list(SHADES.values()),
        "series": series,
    }


def _shown(clip: Motion, recovery: Recovery, clips: int, found: list[Moment]) -> tuple[np.ndarray, int]:
    """Frames that are drawn, one of every `size`: a moment's, else the one where most was changed."""
    size = -(-clips * recovery.changed.size // SAMPLES)
    worst = extent(clip, recovery).max(1)
    worst[[moment.frame for moment in found]] = np.inf
    starts = np.arange(0, len(clip), size)
    padded = np.pad(worst, (0, len(starts) * size - len(worst)), constant_values=-1.0)
    return starts + padded.reshape(-1, size).argmax(1), size


def _within(changed: np.ndarray, far: np.ndarray, size: int) -> np.ndarray:
    """`far` (frame, joint) where the sample is of the gravest kind of its bin, 0 elsewhere."""
    gravest = np.repeat(binned(changed, size), size, axis=0)[: len(changed)]
    return np.where(changed == gravest, far, 0)


def _feet(steps: Feet) -> list[dict[str, Any]]:
    share, slides = steps.contacts.mean(0), zip(_plain(steps.before), _plain(steps.after), strict=True)
    return [
        {"joint": joint, "share": float(share[k]), "before": before, "after": after}
        for k, (joint, (before, after)) in enumerate(zip(steps.joints, slides, strict=True))
    ]


def _plain(values: Any) -> Any:
    """The values as lists, None where they are not finite."""
    array = np.asarray(values, np.float64).astype(object)
    array[~np.isfinite(array.astype(np.float64))] = None
    return array.tolist()
