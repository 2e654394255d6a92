"""Clips in the viewer of rerun: skeletons in space and numbers of joints over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from motionrecover.io.atomic import write_beside
from motionrecover.motion import Motion

# As in the figures.
_COLOURS = {"truth": (0x22, 0x22, 0x22), "input": (0xE6, 0x9F, 0x00), "recovered": (0x00, 0x72, 0xB2)}
_RADIUS = 0.008
"""Metres."""


def view(
    clips: Mapping[str, Motion],
    series: Mapping[str, np.ndarray] | None = None,
    *,
    save: str | Path | None = None,
    overwrite: bool = False,
) -> None:
    """Open the viewer on clips by name (input, recovered, truth), or write what it would show to `save` (.rrd).

    `series`, by name, are numbers (frame, joint) of the joints of the first clip, such as `Recovery.weights`. What is
    missing is left out. Raises `ImportError` without rerun.
    """
    try:
        import rerun
    except ImportError as error:
        raise ImportError("the viewer needs rerun: pip install motionrecover[view]") from error
    recording = rerun.RecordingStream("motionrecover")
    if save is None:
        recording.spawn()
        _log(rerun, recording, clips, series or {})
        return
    with write_beside(save, overwrite=overwrite) as temporary:
        recording.save(temporary)
        _log(rerun, recording, clips, series or {})
        recording.disconnect()


def _log(rerun, recording, clips: Mapping[str, Motion], series: Mapping[str, np.ndarray]) -> None:
    recording.log("/", rerun.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    first = next(iter(clips.values()))
    frames = np.arange(len(first))
    times = [rerun.TimeColumn("frame", sequence=frames), rerun.TimeColumn("time", duration=frames / first.fps)]
    for name, clip in clips.items():
        look = {"colors": [_COLOURS[name]], "radii": [_RADIUS]}
        known = clip.observed
        joints = rerun.Points3D.columns(positions=clip.positions[known].astype(np.float32))
        recording.log(f"{name}/joints", rerun.Points3D.from_fields(**look), static=True)
        recording.send_columns(f"{name}/joints", times, joints.partition(known.sum(1)))
        if clip.skeleton.edges:
            ends = np.array(clip.skeleton.edges)
            whole = known[:, ends].all(-1)
            strips = rerun.LineStrips3D.columns(strips=clip.positions[:, ends][whole].astype(np.float32))
            recording.log(f"{name}/bones", rerun.LineStrips3D.from_fields(**look), static=True)
            recording.send_columns(f"{name}/bones", times, strips.partition(whole.sum(1)))
    for name, values in series.items():
        recording.log(name, rerun.SeriesLines(names=first.names), static=True)
        rows = rerun.Scalars.columns(scalars=values.ravel()).partition([values.shape[1]] * len(values))
        recording.send_columns(name, times, rows)
