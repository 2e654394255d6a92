"""Recover the human motion that really happened from recordings with jitter, spikes and missing joints."""

from importlib.metadata import version

from motionrecover import corrupt, metrics
from motionrecover.evidence.rigid_graph import infer_graph
from motionrecover.io import (
    MotionFormatError,
    MotionFormatWarning,
    from_xarray,
    load,
    save,
    save_skeleton,
    to_xarray,
)
from motionrecover.many import Outcome, recover_many
from motionrecover.motion import Motion
from motionrecover.presets import PRESETS, Preset
from motionrecover.recover import Recovery, RecoveryError, recover
from motionrecover.skeleton import Skeleton
from motionrecover.solver import Result
from motionrecover.synthesize import synthesize

__version__ = version("motionrecover")

__all__ = [
    "PRESETS",
    "Motion",
    "MotionFormatError",
    "MotionFormatWarning",
    "Outcome",
    "Preset",
    "Recovery",
    "RecoveryError",
    "Result",
    "Skeleton",
    "corrupt",
    "from_xarray",
    "infer_graph",
    "load",
    "metrics",
    "recover",
    "recover_many",
    "save",
    "save_skeleton",
    "synthesize",
    "to_xarray",
]
