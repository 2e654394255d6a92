"""The account of a recovery in words: a verdict, what was broken, what was done, which moments to look at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motionrecover.io.border import counted
from motionrecover.motion import Motion
from motionrecover.recovery import Recovery
from motionrecover.report.account import NOTABLE, Moment, bone_deviations, measured, moved
from motionrecover.robust import Change
from motionrecover.solver import Result

DOUBTFUL = 0.05
"""Metres. An answer expected to be farther off than this is to be looked at before it is used."""

_STEADY = 1e-4
"""Metres. Bones that vary by less are not spoken of."""
_SPACE = "\N{NO-BREAK SPACE}"


@dataclass(frozen=True)
class Summary:
    """What a reader has to know first."""

    tone: str
    """good, check or bad."""
    verdict: str
    broken: str
    done: str
    check: str


def summarise(clip: Motion, recovery: Recovery, found: Sequence[Moment]) -> Summary:
    """The summary of a recovery, with the moments that were found in it."""
    changed, names = recovery.changed, clip.names
    unknown = changed == Change.UNKNOWN
    doubtful = np.isfinite(recovery.uncertainty) & (recovery.uncertainty > DOUBTFUL)
    if unknown.all():
        return Summary("bad", "No usable answer", recovery.message, "Nothing could be recovered.", "The whole take.")
    if unknown.any():
        tone, verdict = "check", "Recovered in part"
    elif doubtful.any() or not recovery.converged:
        tone, verdict = "check", "Usable, with moments to check"
    elif np.isnan(recovery.uncertainty).all():
        tone, verdict = "check", "Recovered, to be compared by eye"
    else:
        tone, verdict = "good", "Good to use"
    return Summary(
        tone,
        verdict,
        _broken(clip, recovery),
        _done(clip, recovery),
        _check(recovery, names, doubtful, found),
    )


def _broken(clip: Motion, recovery: Recovery) -> str:
    missing = ~recovery.observed
    repaired = recovery.changed == Change.REPAIRED
    wrong = missing | repaired
    if not wrong.any():
        return "Nothing: every sample was measured and plausible."
    parts = []
    if repaired.any():
        far = float(np.nanmax(np.where(repaired, moved(clip, recovery), np.nan)))
        parts.append(f"{counted(int(repaired.sum()), 'sample')} off by up to {mm(far)}")
    if missing.any():
        parts.append(f"{counted(int(missing.sum()), 'sample')} missing")
    if recovery.swaps:
        parts.append(f"{counted(len(recovery.swaps), 'swap')} of joints")
    share = wrong.mean(0)
    worst = [clip.names[joint] for joint in np.argsort(-share, kind="stable")[:3] if share[joint]]
    return (
        f"{percent(float(wrong.mean()))} of the samples, in {percent(float(wrong.any(1).mean()))} of the frames: "
        f"{_listed(parts)}. Worst: {_listed(worst)}."
    )


def _done(clip: Motion, recovery: Recovery) -> str:
    changed = recovery.changed
    verbs = {Change.REPAIRED: "repaired", Change.FILLED: "filled"}
    parts = [
        f"{counted(int((changed == kind).sum()), 'sample')} {verb}" for kind, verb in verbs.items() if kind in changed
    ]
    rest, they = ("all others", "they") if parts else ("every sample", "it")
    denoised = changed == Change.DENOISED
    if denoised.any():
        parts.append(f"{rest} denoised, by {mm(float(moved(clip, recovery)[denoised].mean()))} on average")
    elif Change.UNTOUCHED in changed:
        parts.append(f"{rest} left exactly as {they} came")
    said = _listed(parts)
    before, after = (_mean(bone_deviations(each, recovery)) for each in (measured(clip), recovery.positions))
    bones = f" Bones varied by {mm(before)} and now vary by {mm(after)}." if before > _STEADY else ""
    return f"{said[0].upper()}{said[1:]}.{bones}"


def _check(recovery: Recovery, names: Sequence[str], doubtful: np.ndarray, found: Sequence[Moment]) -> str:
    sentences = []
    unseen = [name for joint, name in enumerate(names) if (recovery.changed[:, joint] == Change.UNKNOWN).all()]
    if unseen:
        sentences.append(f"{_listed(unseen[:4], len(unseen) - 4)} stayed missing throughout.")
    elif Change.UNKNOWN in recovery.changed:
        sentences.append(
            f"{percent(float((recovery.changed == Change.UNKNOWN).mean()))} of the samples stayed missing."
        )
    known = np.isfinite(recovery.uncertainty)
    if known.any():
        typical = math.sqrt(float((recovery.uncertainty[known] ** 2).mean()))
        sentences.append(
            f"The error to expect is {mm(typical)}, at most {mm(float(recovery.uncertainty[known].max()))}."
        )
        if doubtful.any():
            sentences.append(
                f"{counted(int(doubtful.any(1).sum()), 'frame')} may be off by more than {mm(DOUBTFUL)} somewhere."
            )
    else:
        sentences.append("This preset does not say how far to trust it.")
    if recovery.result == Result.max_steps:
        sentences.append("It stopped at the last step allowed: more steps may refine it.")
    if found:
        sentences.append(f"Start with the {counted(len(found), 'moment')} listed here.")
    else:
        sentences.append(f"Nothing stands out: no moment moved or in doubt by more than {mm(NOTABLE)}.")
    return " ".join(sentences)


def describe(moment: Moment, recovery: Recovery, names: Sequence[str]) -> str:
    """What there is to see at a moment."""
    joints = [names[joint] for joint in moment.joints]
    who = _listed(joints[:3], len(joints) - 3)
    frames = counted(moment.stop - moment.start, "frame")
    if moment.kind == "unknown":
        return f"{who}: still missing for {frames}"
    if moment.kind == "swap":
        return f"{who}: swapped for {frames}, put right"
    if moment.kind == "repaired":
        within = f", within {frames} of repair" if moment.stop - moment.start > 1 else ""
        return f"{who}: moved by {mm(moment.metres)}{within}"
    what = {Change.FILLED: f"filled in over {frames}", Change.REPAIRED: "repaired"}
    kind = Change(recovery.changed[moment.frame, moment.joints[0]])
    return f"{who}: {what.get(kind, 'denoised')}, ±{_SPACE}{mm(moment.metres)}"


def mm(metres: float) -> str:
    """A length for people."""
    if not math.isfinite(metres):
        return "-"
    size = f"{1000 * metres:.{0 if metres >= 0.01 else 1}f}{_SPACE}mm"
    return size if metres < 1 else f"{metres:.2f}{_SPACE}m"


def percent(share: float) -> str:
    """A share for people, which is zero or whole only when it is so exactly."""
    if 0 < share < 0.001:
        return f"<{_SPACE}0.1{_SPACE}%"
    if 0.995 < share < 1:
        return f">{_SPACE}99{_SPACE}%"
    return f"{100 * share:.{0 if share >= 0.1 else 1}f}{_SPACE}%"


def _listed(parts: Sequence[str], more: int = 0) -> str:
    """`a, b and c`, or `a, b and 3 more`."""
    parts = [*parts, f"{more} more"] if more > 0 else list(parts)
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")
