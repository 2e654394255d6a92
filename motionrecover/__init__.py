"""Recover the human motion that really happened from recordings with jitter, spikes and missing joints."""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
    from motionrecover.recovery import Recovery, RecoveryError, recover
    from motionrecover.refine import Refinement, Refiner, load_refiner
    from motionrecover.skeleton import Skeleton
    from motionrecover.solver import Result
    from motionrecover.stream import Stream
    from motionrecover.synthetic import synthesize

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
    "Refinement",
    "Refiner",
    "Result",
    "Skeleton",
    "Stream",
    "corrupt",
    "from_xarray",
    "infer_graph",
    "load",
    "load_refiner",
    "metrics",
    "recover",
    "recover_many",
    "save",
    "save_skeleton",
    "synthesize",
    "to_xarray",
]

_HOMES = {
    "evidence.rigid_graph": ("infer_graph",),
    "io": ("MotionFormatError", "MotionFormatWarning", "from_xarray", "load", "save", "save_skeleton", "to_xarray"),
    "many": ("Outcome", "recover_many"),
    "motion": ("Motion",),
    "presets": ("PRESETS", "Preset"),
    "recovery": ("Recovery", "RecoveryError", "recover"),
    "refine": ("Refinement", "Refiner", "load_refiner"),
    "skeleton": ("Skeleton",),
    "solver": ("Result",),
    "stream": ("Stream",),
    "synthetic": ("synthesize",),
}
"""Modules of the public names, which load at their first use (PEP 562): importing JAX takes half a second."""


def __getattr__(name: str) -> Any:
    if name in ("corrupt", "metrics"):
        return import_module(f"motionrecover.{name}")
    for module, names in _HOMES.items():
        if name in names:
            value = getattr(import_module(f"motionrecover.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'motionrecover' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
