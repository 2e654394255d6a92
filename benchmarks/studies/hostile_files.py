"""What reading makes of damaged files: whether each loads or is refused in a sentence, how soon, in how much memory.

    python -m benchmarks.studies.hostile_files [--files N] [--output FILE] [FORMAT ...]

The damage is `tests.mutate`'s, a seed a file. Of ten files nine are damaged clips of five frames, and one is a damaged
clip of a thousand frames or, where there are any, a recording of the data folder. Each format is read in a process of
its own whose memory is limited to `LIMIT` more than it begins with, and each file within `SECONDS` of CPU time. What
loads of the short clips is written in every format and read again.

    loaded, refused  files
    failed           files, with seed and reason, that did anything else, were it a warning
    seconds          CPU time of the slowest file, with what is written of it
    memory           most memory over the size of the files, of 100 kB and more
    kilobytes        most memory of the smaller files, of which one in `SOME` is measured

Results: `results/hostile_files.json`.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

from benchmarks.recordings import data_folder
from motionrecover.io import MotionFormatWarning, write_beside
from tests.mutate import damaged, memory_of, tried
from tests.whole_files import Case, cases

FORMATS = ("bvh", "amc", "c3d", "trc", "csv", "csv-long", "npz", "kinect", "freemocap", "toml")
SECONDS = 5
LIMIT = 2**31
SOME = 20
LARGE = 100_000


def recordings() -> dict[str, list[Case]]:
    """Recordings of the data folder, none without one."""
    try:
        folder = data_folder()
    except FileNotFoundError:
        return {}

    def case(path: str, **asked) -> Case:
        return Case(Path(path).name, (folder / path).read_bytes(), asked=asked)

    skeleton = next((folder / "cmu/amc/05").glob("*.asf"))
    walk = next((folder / "cmu/amc/05").glob("*.amc"))
    return {
        "bvh": [case("cmu/bvh/09_05.bvh"), case("cmu/bvh/02_01.bvh")],
        "amc": [Case(walk.name, walk.read_bytes(), {skeleton.name: skeleton.read_bytes()})],
        "c3d": [case("markers/cmu_02_01.c3d")],
        "trc": [case("markers/markers.trc", up="z")],
        "csv": [case("markers/gait-raw.csv", fps=100, unit="m")],
        "npz": [case("cmu/npz/05_01.npz")],
        "kinect": [case("kinect/Ges01_wavehand.csv")],
    }


def survey(format: str, files: int, folder: Path) -> dict:
    """Every measure of one format."""
    short, long = cases(folder)[format], [*cases(folder, 1000)[format], *recordings().get(format, [])]
    signal.signal(signal.SIGPROF, _late)
    counts, failed, seconds, memory, kilobytes = {"loaded": 0, "refused": 0}, [], 0.0, 0.0, 0.0
    for seed in range(files):
        large = seed % 10 == 9
        bases = long if large else short
        case = bases[seed // 10 % len(bases)]
        content = damaged(case.content, np.random.default_rng([seed, FORMATS.index(format)]))
        here = folder / "here"
        here.mkdir()
        # Kills the process where the timer is not heard, inside C.
        faulthandler.dump_traceback_later(60 * SECONDS, exit=True)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            begun = time.process_time()
            counts[tried(case, content, here, saves=not large)] += 1
            seconds = max(seconds, time.process_time() - begun)
            signal.setitimer(signal.ITIMER_PROF, 0)
            size = case.size(content)
            if size >= LARGE:
                memory = max(memory, (ratio := memory_of(case, content, here) / size))
                assert ratio < 20, f"takes {ratio:.1f} times its size"
            elif seed % SOME == 0:
                kilobytes = max(kilobytes, memory_of(case, content, here) / 1000)
        except Exception as error:
            failed.append([seed, f"{type(error).__name__}: {error}"[:300]])
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            faulthandler.cancel_dump_traceback_later()
        for path in sorted(here.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        here.rmdir()
    return {
        "files": files,
        **counts,
        "failed": failed,
        "seconds": round(seconds, 2),
        "memory": round(memory, 1),
        "kilobytes": round(kilobytes),
    }


def _late(*_):
    raise TimeoutError(f"takes more than {SECONDS} s")


def main() -> None:
    """Survey every format, print the table and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("formats", nargs="*", default=list(FORMATS), metavar="FORMAT")
    parser.add_argument("--files", type=int, default=2000, help="damaged files a format (2000)")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "hostile_files.json")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.worker:
        used = 4096 * int(Path("/proc/self/statm").read_text().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT, used + LIMIT))
        warnings.simplefilter("ignore", MotionFormatWarning)
        with tempfile.TemporaryDirectory() as folder:
            print(json.dumps(survey(asked.formats[0], asked.files, Path(folder))))
        return
    results = {}
    for format in asked.formats:
        command = [sys.executable, "-m", __spec__.name, format, "--worker", "--files", str(asked.files)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        results[format] = json.loads(done.stdout) if done.returncode == 0 else {"crashed": done.returncode}
        print(f"{format:10} {json.dumps(results[format])}", flush=True)
    with write_beside(asked.output, overwrite=True) as temporary:
        temporary.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
