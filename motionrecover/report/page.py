"""The page: the account in words and, drawn by plotly in the browser, in pictures. One file that needs no network."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from html import escape
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import Any

from motionrecover.io.atomic import write_beside
from motionrecover.io.border import counted
from motionrecover.motion import Motion
from motionrecover.recovery import Recovery
from motionrecover.report.account import Moment, moments
from motionrecover.report.payload import SHADES, payload
from motionrecover.report.words import describe, mm, percent, summarise
from motionrecover.robust import Change

_HERE = Path(__file__).parent
_SCRIPTS = ("data.js", "playback.js", "charts.js", "page.js")


def write_report(
    clip: Motion,
    recovery: Recovery,
    path: str | Path,
    *,
    truth: Motion | None = None,
    title: str = "motion",
    settings: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a page about the recovery of a clip, for any browser of 2023 or later.

    `truth`, on the frames and joints of the clip, is drawn too. `title` names the clip and `settings` what it was
    recovered with; both are only shown. Long clips are thinned for the eye: of each bin of frames the one is drawn
    where most was changed. The numbers come from all frames.

    Raises `ValueError` for a truth or a recovery of other frames or joints, `FileExistsError` unless `overwrite`, and
    `ImportError` without plotly.
    """
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise ImportError("a report needs plotly: pip install motionrecover[report]") from error
    for name, shape in (("truth", truth and truth.positions.shape), ("a recovery", recovery.positions.shape)):
        if shape not in (None, clip.positions.shape):
            raise ValueError(f"received {name} of shape {shape} for a clip of {clip.positions.shape}: give the same")
    found = moments(clip, recovery)
    data = payload(clip, recovery, truth, found)
    summary = summarise(clip, recovery, found)
    parts = {
        "title": escape(title),
        "tone": summary.tone,
        "verdict": escape(summary.verdict),
        "facts": escape(
            f"{counted(len(clip), 'frame')} at {clip.fps:g} fps ({clip.seconds:.1f} s) · "
            f"{counted(len(clip.names), 'joint')} · {counted(len(clip.skeleton.edges), 'bone')}"
        ),
        "broken": escape(summary.broken),
        "done": escape(summary.done),
        "check": escape(summary.check),
        "moments": "".join(_moment(moment, clip, recovery) for moment in found)
        or '<li class="none">Nothing stands out.</li>',
        "kinds": "".join(_kind(kind, recovery) for kind in Change),
        "feet": _feet(data["feet"], clip),
        "swaps": _swaps(clip, recovery),
        "settings": _settings(clip, recovery, settings or {}),
        "thinned": "" if data["size"] == 1 else f"Of every {data['size']} frames the one changed most is drawn.",
        "css": (_HERE / "page.css").read_text(encoding="utf-8"),
        "plotly": get_plotlyjs(),
        # In a script element only `<` could end the text early; JSON can write it as \\u003c.
        "data": json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "script": "\n".join((_HERE / name).read_text(encoding="utf-8") for name in _SCRIPTS),
    }
    page = Template((_HERE / "page.html").read_text(encoding="utf-8")).substitute(parts)
    with write_beside(path, overwrite=overwrite) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _button(frame: int, joint: int) -> str:
    """A button that takes the page to a frame and a joint; the page adds the time."""
    return f'<button data-frame="{frame}" data-joint="{joint}">frame {frame}</button>'


def _moment(moment: Moment, clip: Motion, recovery: Recovery) -> str:
    said = escape(describe(moment, recovery, clip.names))
    button = _button(moment.frame, moment.joints[0])
    return f'<li>{button}<span class="tag {moment.kind}">{moment.kind}</span><span>{said}</span></li>'


def _kind(kind: Change, recovery: Recovery) -> str:
    count = int((recovery.changed == kind).sum())
    low, middle, high = SHADES[kind]
    swatch = f'<i style="background: linear-gradient(90deg, {low}, {middle} 75%, {high})"></i>'
    share = percent(count / recovery.changed.size)
    return f'<span class="kind{"" if count else " none"}">{swatch}{kind.name.lower()} <b>{share}</b></span>'


def _feet(found: list[dict[str, Any]], clip: Motion) -> str:
    def slide(speed: float | None) -> str:
        return "-" if speed is None else f"{mm(speed)}/s"

    rows = "".join(
        f"<tr><td>{escape(clip.names[foot['joint']])}</td><td>{percent(foot['share'])}</td>"
        f"<td>{slide(foot['before'])}</td><td>{slide(foot['after'])}</td></tr>"
        for foot in found
    )
    head = "<tr><th>foot</th><th>in contact</th><th>slide of the input</th><th>slide now</th></tr>"
    return f"<table>{head}{rows}</table>" if rows else "<p>No feet were found on this skeleton.</p>"


def _swaps(clip: Motion, recovery: Recovery) -> str:
    rows = "".join(
        f"<tr><td>{_button(swap.start, swap.first_joint)}</td><td>frames {swap.start} to {swap.stop - 1}</td>"
        f"<td>{escape(clip.names[swap.first_joint])} and {escape(clip.names[swap.second_joint])}</td></tr>"
        for swap in recovery.swaps
    )
    return f"<table>{rows}</table>" if rows else "<p>No joints had each other's samples.</p>"


def _settings(clip: Motion, recovery: Recovery, settings: Mapping[str, Any]) -> str:
    packages = (f"{name} {version(name)}" for name in ("motionrecover", "jax", "numpy"))
    rows = {
        **{name.replace("_", " "): value for name, value in settings.items()},
        "verdict": recovery.message,
        "steps": recovery.steps,
        "time": f"compiled in {recovery.seconds['compile']:.1f} s, ran {recovery.seconds['run']:.1f} s",
        "versions": ", ".join((*packages, f"Python {platform.python_version()}")),
        "history": "\n".join(clip.history) or "-",
    }
    lines = (f"<tr><th>{escape(name)}</th><td>{escape(_said(value))}</td></tr>" for name, value in rows.items())
    return f'<table class="settings">{"".join(lines)}</table>'


def _said(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "-" if value is None else str(value)
