"""Compiled programs that are kept for other processes, and what happens to damaged ones."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from motionrecover import kept, load, programs, save, synthesize
from motionrecover.solver import Result
from motionrecover.solver.result import Solution


def _twice(x, factor):
    return Solution(2 * x * factor, x, jnp.asarray(Result.converged), jnp.array(1), None, None)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in names}
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.setattr(programs, "_folder", None)
    compilation_cache.reset_cache()
    yield tmp_path / "cache"
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
    programs._place.cache_clear()


def keep_in_ours(folder):
    programs.keep_in(folder)
    return "*.program"


def keep_in_the_users(folder):
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    programs.keep_in(folder)
    return "*-cache"


WAYS = pytest.mark.parametrize("keep", [keep_in_ours, keep_in_the_users])


def call(factor=3.0):
    programs._place.cache_clear()
    jax.clear_caches()
    x = np.arange(6.0).reshape(2, 3)
    answer = programs.run(_twice, {"x": x}, {"factor": factor}, {"compile": 0.0, "run": 0.0})
    np.testing.assert_array_equal(answer.positions, 2 * factor * x)
    assert answer.result == Result.converged


@WAYS
def test_programs_are_kept_once_and_come_back(folder, keep):
    pattern = keep(folder)
    call()
    kept = {file.name: file.read_bytes() for file in folder.iterdir() if "-atime" not in file.name}
    assert kept
    assert all(Path(name).match(pattern) for name in kept)
    call()
    assert {file.name: file.read_bytes() for file in folder.glob(pattern)} == kept


def test_what_was_kept_is_not_made_again(folder, monkeypatch):
    keep_in_ours(folder)
    call()
    monkeypatch.setattr(programs, "_compiled", lambda _: pytest.fail("compiled"))
    call()


@WAYS
def test_a_damaged_file_is_made_anew_with_a_warning(folder, keep):
    pattern = keep(folder)
    call()
    for file in folder.glob(pattern):
        file.write_bytes(file.read_bytes()[:20])
    with pytest.warns(UserWarning, match="cache"):
        call()
    if keep is keep_in_ours:  # JAX leaves it as it is
        call()


def test_where_nothing_can_be_written_the_answer_comes_with_a_warning(folder, monkeypatch):
    monkeypatch.setattr(programs, "_folder", folder)
    with pytest.warns(UserWarning, match="not kept"):
        call()


def test_other_code_values_and_processors_have_other_files(folder, monkeypatch):
    keep_in_ours(folder)
    call()
    call(2.0)
    assert len(list(folder.glob("*.program"))) == 2
    for part in range(len(kept._surroundings())):
        there = [*kept._surroundings()]
        there[part] += " of another machine"
        monkeypatch.setattr(kept, "_surroundings", lambda there=there: tuple(there))
        call()
        monkeypatch.undo()
        monkeypatch.setattr(programs, "_folder", folder)
    assert len(list(folder.glob("*.program"))) == 2 + len(kept._surroundings())


def test_what_is_kept_was_compiled_and_not_taken_from_the_cache_of_jax(folder, monkeypatch):
    """Which would keep a program without its functions; an older version left such a cache in the same folder."""
    keep_in_ours(folder)
    call()
    (kept_first,) = (file.stat().st_size for file in folder.glob("*.program"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    with monkeypatch.context() as before:
        before.setattr(programs, "_file", lambda *_: None)
        call()
    assert list(folder.glob("*-cache"))
    for file in folder.glob("*.program"):
        file.unlink()
    call()
    (kept_again,) = (file.stat().st_size for file in folder.glob("*.program"))
    assert kept_again == kept_first


def test_programs_are_made_side_by_side_each_once(folder, monkeypatch):
    keep_in_ours(folder)
    programs._place.cache_clear()
    compiled, both = [], threading.Barrier(2, timeout=60)
    compiler = programs._compiled

    def together(lowered):
        both.wait()
        compiled.append(lowered)
        return compiler(lowered)

    monkeypatch.setattr(programs, "_compiled", together)
    shapes = {"x": jax.ShapeDtypeStruct((4, 3), np.dtype("float32"))}
    called = []

    def meanwhile():
        called.append(True)
        programs.prepare(_twice, shapes, {"factor": 3.0})

    seconds = {"compile": 0.0, "run": 0.0}
    small, large = np.ones((2, 3), np.float32), np.ones((4, 3), np.float32)
    for _ in range(2):
        answer = programs.run(_twice, {"x": small}, {"factor": 3.0}, seconds, meanwhile)
        np.testing.assert_array_equal(answer.positions, 6 * small)
        np.testing.assert_array_equal(programs.run(_twice, {"x": large}, {"factor": 3.0}, seconds).positions, 6 * large)
    assert len(compiled) == len(list(folder.glob("*.program"))) == 2
    assert len(called) == 1
    assert jax.config.jax_enable_compilation_cache
    assert seconds["compile"] > 0


def test_what_fails_while_it_is_prepared_fails_where_it_is_run(monkeypatch):
    programs._place.cache_clear()
    monkeypatch.setattr(programs, "_compiled", lambda _: 1 / 0)
    programs.prepare(_twice, {"x": jax.ShapeDtypeStruct((7, 3), np.dtype("float32"))}, {"factor": 3.0})
    with pytest.raises(ZeroDivisionError):
        programs.run(_twice, {"x": np.ones((7, 3), np.float32)}, {"factor": 3.0}, {"compile": 0.0, "run": 0.0})


def test_a_process_of_its_own_takes_a_kept_program(tmp_path):
    """Where nothing was lowered yet, LAPACK too."""
    clip = tmp_path / "clip.npz"
    save(synthesize(0.1, 120), clip)
    command = [sys.executable, "-m", "motionrecover", "recover", str(clip), "--overwrite", "-o"]
    environment = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    for preset in ("str_yang2020", "robust"):
        answers = []
        for turn in range(2):
            answer = tmp_path / f"{turn}.npz"
            subprocess.run([*command, answer, "--preset", preset], env=environment, check=True, capture_output=True)
            answers.append(np.asarray(load(answer).positions))
        np.testing.assert_array_equal(*answers)


def test_what_takes_long_is_named(monkeypatch, caplog):
    caplog.set_level("INFO", "motionrecover")
    monkeypatch.setattr(programs, "SLOW", 0.0)
    programs._place.cache_clear()
    programs.run(_twice, {"x": np.zeros((5, 4))}, {"factor": 2.0}, {"compile": 0.0, "run": 0.0})
    assert "compiling _twice for arrays of 5x4" in caplog.text


def test_what_does_not_fit_into_memory_is_refused_with_its_size(monkeypatch, refused):
    monkeypatch.setattr(programs, "_memory", lambda: 1000)
    programs._place.cache_clear()
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
