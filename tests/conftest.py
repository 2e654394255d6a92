"""What the tests share."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import batches
import jax
import pytest
from hypothesis import settings

from motionrecover import programs, save
from motionrecover.cli import main
from motionrecover.io import MotionFormatError

jax.config.update("jax_enable_x64", True)  # float32 is asked for where it is tested
# A shell starts what it puts in the background with Ctrl-C ignored, and so would every process that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
# Compiling makes the first example of a test slow, and a seeded test is the same test every time.
settings.register_profile("motionrecover", deadline=None, derandomize=True)
settings.load_profile("motionrecover")


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The command keeps compiled programs for the tests alone."""
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="session", autouse=True)
def _no_notes_on_compiling() -> None:
    """They would come and go with the load of the machine."""
    programs.SLOW = 3600


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real recordings, which is no part of the project."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("MOTIONRECOVER_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no folder of real recordings at {folder}: set MOTIONRECOVER_DATA to one")
    return folder


@pytest.fixture
def refused() -> Callable[..., None]:
    """Checks that a call is refused with one sentence that holds all the given words."""

    def check(call: Callable[[], object], *words: str, error: type[Exception] = MotionFormatError) -> None:
        with pytest.raises(error) as caught:
            call()
        assert type(caught.value) is error
        sentence = str(caught.value)
        assert "\n" not in sentence
        assert not [word for word in words if word not in sentence], sentence

    return check


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs the command line and gives its exit code, stdout and stderr."""

    def call(*arguments: object) -> tuple[int, str, str]:
        code = main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return call


@pytest.fixture(scope="module")
def recovered_archive(tmp_path_factory):
    """A folder with clips in `in` and what an undisturbed batch made of them in `undisturbed`."""
    folder = tmp_path_factory.mktemp("archive")
    (folder / "in" / "sub").mkdir(parents=True)
    for seed in range(batches.CLIPS):
        save(batches.motion(seed, 30 + seed), folder / "in" / ("sub" if seed % 2 else "") / f"{seed}.npz")
    out, error = batches.done(batches.command(folder, "undisturbed", workers=1))
    assert f"{batches.CLIPS} clips" in out
    assert error == ""
    assert {line["process"]["programs"] for line in batches.lines(folder / "undisturbed")} == {2}
    return folder
