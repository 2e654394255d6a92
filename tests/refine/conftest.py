"""What the tests of the learned refiners share."""

from collections.abc import Iterator
from pathlib import Path

import jax
import pytest
from helpers import SMALL_BODY, clip

from motionrecover import Motion, save


@pytest.fixture(scope="session")
def clips_folder(tmp_path_factory) -> Path:
    """Four subjects with a clip of 160 frames at 60 frames a second each, on `SMALL_BODY`."""
    folder = tmp_path_factory.mktemp("clips")
    for subject in range(4):
        save(Motion(clip(SMALL_BODY, 160, seed=subject), SMALL_BODY, 60.0), folder / f"{subject}_01.npz")
    return folder


@pytest.fixture(autouse=True, scope="module")
def _compile_quickly() -> Iterator[None]:
    """Networks compile four times as fast, and these run for milliseconds."""
    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
