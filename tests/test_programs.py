"""Compiled programs that are kept for other processes, and what happens to damaged ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from motionrecover import programs
from motionrecover.solver import Result
from motionrecover.solver.result import Solution


def _twice(x, factor):
    return Solution(2 * x * factor, x, Result.converged, jnp.array(1), None, None)


@pytest.fixture
def folder(tmp_path):
    before = jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs
    jax.config.update("jax_compilation_cache_dir", None)
    programs.keep_in(tmp_path / "cache")
    compilation_cache.reset_cache()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    yield tmp_path / "cache"
    jax.config.update("jax_compilation_cache_dir", before[0])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", before[1])
    compilation_cache.reset_cache()
    programs._compile.cache_clear()


def call():
    programs._compile.cache_clear()
    jax.clear_caches()
    x = np.arange(6.0).reshape(2, 3)
    answer = programs.run(_twice, {"x": x}, {"factor": 3.0}, {"compile": 0.0, "run": 0.0})
    np.testing.assert_array_equal(answer.positions, 6 * x)
    assert answer.result == Result.converged


def test_programs_are_kept_and_come_back(folder):
    call()
    kept = {file.name: file.read_bytes() for file in folder.glob("*-cache")}
    assert kept
    call()
    assert {file.name: file.read_bytes() for file in folder.glob("*-cache")} == kept


def test_a_damaged_file_is_ignored_with_a_warning(folder):
    call()
    for file in folder.glob("*-cache"):
        file.write_bytes(file.read_bytes()[:20])
    with pytest.warns(UserWarning, match="cache"):
        call()


def test_what_takes_long_is_named(monkeypatch, caplog):
    caplog.set_level("INFO", "motionrecover")
    monkeypatch.setattr(programs, "SLOW", 0.0)
    programs._compile.cache_clear()
    programs.run(_twice, {"x": np.zeros((5, 4))}, {"factor": 2.0}, {"compile": 0.0, "run": 0.0})
    assert "compiling _twice for arrays of 5x4" in caplog.text


def test_what_does_not_fit_into_memory_is_refused_with_its_size(monkeypatch, refused):
    monkeypatch.setattr(programs, "_memory", lambda: 1000)
    programs._compile.cache_clear()
    arrays, seconds = {"x": np.zeros((500, 10))}, {"compile": 0.0, "run": 0.0}
    refused(
        lambda: programs.run(_twice, arrays, {"factor": 2.0}, seconds),
        "500x10",
        "there are 1e-06 GB",
        "windows",
        error=MemoryError,
    )


@pytest.mark.parametrize("frames", [1, 49, 50, 51, 100, 127, 201, 400])
def test_a_bucket_holds_the_clip(frames):
    stored = programs.bucket(frames, 400)
    assert stored in (400, 200, 100, 50, 25, 12)
    assert stored // 2 < max(frames, 8) <= max(stored, 8)


@pytest.mark.parametrize("frames", [1, 7, 8, 9, 100, 272, 1000, 6784])
def test_without_a_window_there_is_little_to_spare(frames):
    assert frames <= programs.bucket(frames) <= max(8, frames * 9 / 8)
    assert programs.bucket(programs.bucket(frames)) == programs.bucket(frames)
