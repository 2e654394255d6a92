"""Other programs, each in an environment of its own that `make clients` makes."""

import os
import subprocess
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
HERE = Path(__file__).parent


@pytest.fixture
def client(tmp_path):
    """Runs a script of this folder in the environment of another program."""

    def run(environment: str, script: str, *arguments: object) -> None:
        python = REPOSITORY / f".venv-{environment}" / "bin" / "python"
        if not python.exists():
            pytest.skip(f"no {python.relative_to(REPOSITORY)}: run make clients")
        own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        done = subprocess.run(
            [str(python), str(HERE / script), *map(str, arguments)],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            # Blender keeps its extensions and preferences there.
            env=own | {"BLENDER_USER_RESOURCES": str(tmp_path / "blender")},
        )
        assert done.returncode == 0, done.stdout + done.stderr

    return run
