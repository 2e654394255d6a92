"""Learned refiners: networks that map corrupted motion to clean motion, one model a file."""

from motionrecover.refine.refiner import Refinement, Refiner, load_refiner

__all__ = ["Refinement", "Refiner", "load_refiner"]
