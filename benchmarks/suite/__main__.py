"""Every protocol for every preset and its peers, in one run.

    python -m benchmarks.suite [--clips N] [--seeds N] [--protocols ...] [--methods ...] [--workers N] [--quick]

Writes one results file, prints the table, and compares our methods with the committed baseline: exit status 1 for a
regression. `--update-baseline` writes the baseline from the results instead.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

from benchmarks.recordings import data_folder
from benchmarks.suite import baseline, measure, methods, rows, table
from motionrecover.io.atomic import write_beside

HERE = Path(__file__).parent
PACKAGES = ("jax", "numpy", "scipy", "gapfill", "simdkalman", "tensorly")
"""Whose versions the results name."""


def run(chosen: Sequence[rows.Row], names: Sequence[str], settings: dict[str, int], workers: int) -> dict:
    """The results of the chosen rows and methods, twenty notes on the way. A worker is a process with one thread."""
    folder = data_folder()
    work, short = measure.tasks(folder, chosen, settings["clips"], settings["seeds"])
    # The libraries of a worker read these when it starts.
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false"
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(measure.perform, folder, task, names) for task in work]
        for done, _ in enumerate(as_completed(futures), 1):
            if 20 * done // len(work) > 20 * (done - 1) // len(work):
                print(f"{done} of {len(work)} clips under a seed", file=sys.stderr)
        runs = [run for future in futures for run in future.result()]
    return {
        "settings": settings,
        "ours": [name for name in names if methods.METHODS[name].ours],
        "versions": {package: version(package) for package in PACKAGES},
        "rows": measure.summarise(runs, chosen, short),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, write, print, compare; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.suite", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--clips", type=int, help="clips a row, spread evenly over subjects (6)")
    add("--seeds", type=int, help="seeds a clip (5)")
    add("--protocols", nargs="+", default=[], help="protocols or whole names of rows")
    add("--methods", nargs="+", default=[], help="names of methods, ours, peers")
    add("--workers", type=int, default=2, help="processes, each with one thread (2)")
    add("--quick", action="store_true", help="a few rows, two clips, one seed")
    add("--output", type=Path, default=HERE / "results.json")
    add("--baseline", type=Path, default=HERE / "baseline.json")
    add("--update-baseline", action="store_true", help="write the baseline from these results")
    asked = parser.parse_args(arguments)
    try:
        chosen = rows.find(asked.protocols or (list(rows.QUICK) if asked.quick else []))
        names = [method.name for method in methods.find(asked.methods)]
    except ValueError as error:
        parser.error(str(error))
    few, once = (2, 1) if asked.quick else (6, 5)
    settings = {"clips": asked.clips or few, "seeds": asked.seeds or once}
    results = run(chosen, names, settings, asked.workers)
    _write(asked.output, results)
    print(table.render(results))
    if asked.update_baseline:
        _write(asked.baseline, baseline.of(results))
        print(f"wrote {asked.baseline}")
        return 0
    if not asked.baseline.exists():
        print(f"no baseline at {asked.baseline}: write one with --update-baseline")
        return 0
    known = json.loads(asked.baseline.read_text(encoding="utf-8"))
    if results["settings"] != known["settings"]:
        print(f"not compared: the baseline was made with {known['settings']}, this run with {results['settings']}")
        return 0
    worse = baseline.regressions(results, known)
    print(f"{baseline.compared(results, known)} metrics compared: {baseline.sentences(worse)}")
    return 1 if worse else 0


def _write(path: Path, content: dict) -> None:
    with write_beside(path, overwrite=True) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
