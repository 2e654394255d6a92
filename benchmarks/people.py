"""The poses that the package ships, without those of the person that a clip shows: what is measured knows nobody."""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files
from unittest.mock import patch

import numpy as np

from motionrecover import poses
from motionrecover.evidence.pose_prior import Poses

SAME_BODY = {"13": "14"}
"""Recordings of subject 13 have the skeleton of 14."""


def person(clip: str) -> str:
    """Of a clip of the CMU database, by its name."""
    subject = clip.split("_")[0]
    return SAME_BODY.get(subject, subject)


@lru_cache
def strangers(clip: str) -> Poses:
    """The shipped poses of everybody but the person of a clip."""
    with (files("motionrecover") / poses.FILE).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        others = arrays["people"][arrays["bodies"]] != person(clip)
        return poses.with_mirror_images(arrays["positions"][others].astype(float), arrays["bodies"][others].astype(int))


def left_out(clip: str):
    """A context in which the package has the poses of `strangers` alone."""
    return patch.object(poses, "shipped", lambda: strangers(clip))
