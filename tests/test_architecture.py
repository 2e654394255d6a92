"""The shape of the package: imports point down, importing does nothing."""

import ast
import subprocess
import sys
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "motionrecover"

LAYERS = [
    {
        "kernel",
        "motion",
        "skeleton",
        "standards",
        "rig",
        "rotations",
        "source",
        "runs",
        "threads",
        "whittaker",
        "prox",
        "wavelets",
        "metrics",
        "corrupt",
        "synthetic",
    },
    {"solver", "isometry"},
    {"evidence"},
    {"presets", "kept", "programs", "intake", "windows", "io", "refine", "poses"},
    {"body", "estimate", "robust", "finishing", "sliding"},
    {"recovery", "stream"},
    {"many"},
    {"figures", "report", "view"},
    {"files"},
    {"batch"},
    {"cli", "__main__"},
]
"""Top-level modules from the bottom up; a module may import its own layer and those below. `__init__` sees all."""


def imports(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "motionrecover":
            parts = node.module.split(".")
            yield from [parts[1]] if len(parts) > 1 else [alias.name for alias in node.names]
        elif isinstance(node, ast.Import):
            yield from (a.name.split(".")[1] for a in node.names if a.name.startswith("motionrecover."))


def test_imports_point_down():
    level = {name: k for k, layer in enumerate(LAYERS) for name in layer}
    upward = []
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if name == "__init__":
            continue
        upward += [f"{name} imports {other}" for other in imports(path) if level.get(other, -1) > level[name]]
    assert not upward


def test_every_module_has_a_layer():
    modules = {path.name.removesuffix(".py") for path in PACKAGE.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert modules - {"__pycache__", "__init__"} == set.union(*LAYERS)


def test_importing_loads_nothing_and_the_names_no_array_and_nothing_heavy():
    program = (
        "import sys, motionrecover\n"
        "assert not {'jax', 'scipy'} & set(sys.modules)\n"
        "for name in motionrecover.__all__: getattr(motionrecover, name)\n"
        "import jax\n"
        "assert not jax.live_arrays(), jax.live_arrays()\n"
        "heavy = {'matplotlib', 'plotly', 'rerun', 'optimistix', 'jaxopt', 'dask', 'optax', 'pybvh', 'typer', 'rich'}\n"
        "heavy |= {'safetensors'}\n"
        "heavy |= {'cvxpy', 'distributed', 'fsspec', 'xarray', 'zarr'}\n"
        "loaded = heavy & {name.split('.')[0] for name in sys.modules}\n"
        "sys.exit(f'importing loads {loaded}' if loaded else 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_command_line_loads_nothing_heavy_before_a_command_runs():
    program = (
        "import sys, motionrecover.cli\n"
        "motionrecover.cli.main(['recover', '--help'])\n"
        "loaded = {'jax', 'equinox', 'scipy', 'pywt', 'motionrecover.io'} & set(sys.modules)\n"
        "sys.exit(f'help loads {loaded}' if loaded else 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_core_knows_no_names_units_or_files():
    for part in ("solver", "isometry"):
        for path in (PACKAGE / part).rglob("*.py"):
            source = path.read_text(encoding="utf-8")
            assert not {"motion", "io"} & set(imports(path)), path
            assert "open(" not in source
            assert "logging" not in source
