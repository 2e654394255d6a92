"""The methods of the suite: every preset of the package, and the peers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.people import left_out
from benchmarks.suite import peers_lowrank, peers_rigid, peers_time
from benchmarks.suite.clips import Clip
from motionrecover.presets import PRESETS
from motionrecover.recovery import recover


@dataclass(frozen=True)
class Method:
    """`run(data, clip, lengths)` gives positions. The clip lends skeleton and rate only; `lengths` are true or None."""

    name: str
    run: Callable[[np.ndarray, Clip, np.ndarray | None], np.ndarray]
    ours: bool = False


def _preset(name: str) -> Method:
    def run(data: np.ndarray, clip: Clip, lengths: np.ndarray | None) -> np.ndarray:
        with left_out(clip.name):
            return recover(data, clip.skeleton, preset=name, bone_lengths=lengths, fps=clip.fps).positions

    return Method(name, run, ours=True)


def _peer(name: str, fill: Callable[[np.ndarray, float], np.ndarray]) -> Method:
    return Method(name, lambda data, clip, lengths: fill(data, clip.fps))


def _median(positions: np.ndarray, fps: float, frames: int) -> np.ndarray:
    return peers_time.running_median(positions, frames)


PEERS = (
    _peer("nothing", peers_time.nothing),
    _peer("spline", peers_time.spline),
    *(_peer(f"median-{frames}", partial(_median, frames=frames)) for frames in (5, 15, 31)),
    _peer("hampel-butterworth", peers_time.hampel_butterworth),
    _peer("kalman", peers_time.kalman),
    _peer("rigid-donors", peers_rigid.rigid_donors),
    _peer("pca", peers_lowrank.pca),
    _peer("soft-impute", peers_lowrank.soft_impute),
    _peer("rpca-poses", peers_lowrank.rpca_poses),
    _peer("rpca-motion", peers_lowrank.rpca_motion),
)

METHODS = {method.name: method for method in (*map(_preset, PRESETS), *PEERS)}
"""By name, ours first."""


def find(names: list[str]) -> list[Method]:
    """The named methods, all without names; `ours` and `peers` name a group. Raises `ValueError` for an unknown one."""
    groups = {"ours": [m for m in METHODS.values() if m.ours], "peers": [m for m in METHODS.values() if not m.ours]}
    unknown = [name for name in names if name not in METHODS and name not in groups]
    if unknown:
        raise ValueError(f"received the method {unknown[0]!r}: give ours, peers or some of {', '.join(METHODS)}")
    chosen = {method.name for name in names for method in groups.get(name, [METHODS.get(name)]) if method}
    return [method for method in METHODS.values() if not names or method.name in chosen]
