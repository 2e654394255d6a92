"""The speed of the solver, measured.

    python -m benchmarks.speed [ROW ...] [--quick] [--gpu] [--output FILE]

Runs every row, or those named (`iterations` for all that begin so), in processes of their own, writes
`benchmarks/speed/results.json` (rows that were not run stay) and makes `docs/performance.md` of it. About half an hour;
for figures to keep, on a machine where nothing else runs. The rows `recordings` need the CMU clips: MOTIONRECOVER_DATA,
or ../shared/data beside the repository. The row `pose2sim` runs where POSE2SIM names the Python of an environment with
Pose2Sim. `--gpu` runs the row `batch` on a GPU, at full size.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from benchmarks.speed import page
from benchmarks.speed.rows import ROOT, ROWS, batch
from motionrecover.io.atomic import write_beside

PACKAGES = ("jax", "numpy", "scipy", "PyWavelets", "optimistix", "lineax", "jaxopt")
ONE_CORE = {
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the rows, write results and page; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.speed", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("rows", nargs="*", help=f"of {', '.join(ROWS)}")
    add("--quick", action="store_true", help="a few small steps of everything, to see that it runs; makes no page")
    add("--gpu", action="store_true", help="only the row batch, on a GPU")
    add("--output", type=Path, default=page.RESULTS)
    add("--here", action="store_true", help=argparse.SUPPRESS)  # one row in this process, printed as JSON
    asked = parser.parse_args(arguments)
    names = ["batch"] if asked.gpu else [name for name in ROWS if not asked.rows or _named(name, asked.rows)]
    if "POSE2SIM" not in os.environ:
        names = [name for name in names if name != "pose2sim"]
    if unknown := [word for word in asked.rows if not any(_named(name, [word]) for name in ROWS)]:
        parser.error(f"received the row {unknown[0]!r}: give some of {', '.join(ROWS)}")
    if asked.here:
        found = batch(asked.quick, gpu=True) if asked.gpu else ROWS[names[0]][0](asked.quick)
        print(json.dumps(found))
        return 0
    results = json.loads(asked.output.read_text(encoding="utf-8")) if asked.output.exists() else {"rows": {}}
    results["machine"] = f"{_processor()}, {os.cpu_count()} cores"
    results["versions"] = {package: version(package) for package in PACKAGES}
    for name in names:
        found = _apart(name, asked.quick, asked.gpu)
        results["rows"]["batch-gpu" if asked.gpu else name] = found
        print(name, json.dumps(found), flush=True)
        with write_beside(asked.output, overwrite=True) as temporary:
            temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    if not asked.quick and asked.output == page.RESULTS:
        page.main()
    return 0


def _named(name: str, words: Sequence[str]) -> bool:
    return any(name == word or name.startswith(f"{word}-") for word in words)


def _apart(name: str, quick: bool, gpu: bool) -> dict:
    """The row in a process of its own, on one core where it asks for that."""
    one_core = ROWS[name][1]
    environment = os.environ | (ONE_CORE if one_core else {})
    arguments = [sys.executable, "-m", "benchmarks.speed", name, "--here"]
    arguments += ["--quick"] * quick + ["--gpu"] * gpu
    done = subprocess.run(
        arguments,
        env=environment,
        cwd=ROOT,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=_pin if one_core and hasattr(os, "sched_setaffinity") else None,
    )
    return json.loads(done.stdout.splitlines()[-1])


def _pin() -> None:
    """The last processor of those allowed: the first ones serve what else the machine does."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def _processor() -> str:
    """Its name, where the system says."""
    cpu = Path("/proc/cpuinfo")
    names = cpu.read_text(encoding="utf-8").splitlines() if cpu.exists() else []
    return next((line.split(":")[1].strip() for line in names if line.startswith("model name")), platform.processor())


if __name__ == "__main__":
    sys.exit(main())
