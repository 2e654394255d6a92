"""The rows of the benchmark. Each runs in a process of its own (`python -m benchmarks.speed NAME --here`), on one core
where that is said, and prints its results as JSON.

Where things are compared, they take turns in the same process, and the best of several runs counts.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from motionrecover.threads import processors

ROOT = Path(__file__).parents[2]
LENGTHS = (272, 584, 1100, 6784)
"""Frames of the paper's Table VI."""
KEPT = (1696, 6784, 27136)
"""Frames for which memory is measured."""


def iterations(frames: int, quick: bool) -> dict[str, Any]:
    """Every contender at one length: seconds, AJE in mm; the limit; one core."""
    from benchmarks.speed import limit
    from benchmarks.speed.contenders import CONTENDERS, STEPS, Task, ours_timed
    from motionrecover import metrics

    task = Task(frames, 3 if quick else STEPS)
    start = time.perf_counter()
    _, compiling = ours_timed(task)
    first = time.perf_counter() - start
    calls, prepared, found = {}, {}, {}
    for name, contender in CONTENDERS.items():
        start = time.perf_counter()
        calls[name] = contender(task)
        prepared[name] = time.perf_counter() - start
    best: dict[str, float] = {}
    bandwidths, runs = [], []
    for turn in range(2 if quick else 7):
        bandwidths.append(limit.bandwidth(frames, len(task.skeleton.names)))
        for _ in range(3):
            answer, seconds = ours_timed(task)
            runs.append(seconds["run"])
        found["ours"] = answer
        for name, call in calls.items():
            # What takes a minute runs once, what takes a second twice.
            if name == "ours" or (turn and best[name] > 20) or (turn > 1 and best[name] > 1):
                continue
            wall, cpu = time.perf_counter(), time.process_time()
            found[name] = call()
            # The smaller one: other work on the machine shall not make it look slow.
            seconds = min(time.perf_counter() - wall, time.process_time() - cpu)
            best[name] = min(best.get(name, np.inf), seconds)
    best["ours"] = min(runs)
    double, _ = ours_timed(task, "float64")
    return {
        "frames": frames,
        "joints": len(task.skeleton.names),
        "steps": task.steps,
        "seconds": {name: _round(value) for name, value in best.items()},
        "prepared": {name: _round(prepared[name]) for name in prepared},
        "aje": {name: round(1000 * metrics.aje(x, task.truth), 4) for name, x in found.items()},
        "apart_mm": {name: _round(1000 * metrics.aje(x, found["ours"])) for name, x in found.items() if name != "ours"},
        "float64_apart_mm": _round(1000 * metrics.aje(double, found["ours"])),
        "compile": _round(compiling["compile"]),
        "first_call": _round(first),
        "bandwidth": _round(max(bandwidths)),
        "limit": _round(task.steps * limit.bytes_moved(frames, len(task.skeleton.names)) / max(bandwidths)),
    }


def long_clips(quick: bool) -> dict[str, Any]:
    """Seconds a frame of 40 iterations at 1,696 and 27,136 frames, of whole clips and in windows; one core."""
    from benchmarks.speed.contenders import IN_WINDOWS, PRESET, Task, ours_timed

    lengths = (106, 424) if quick else (1696, 27136)
    tasks = [Task(frames, 2 if quick else 40) for frames in lengths]
    found: dict[str, Any] = {"frames": lengths}
    for name, preset in (("whole", PRESET), ("windows", IN_WINDOWS)):
        seconds: dict[int, list[float]] = {frames: [] for frames in lengths}
        for _ in range(3 if quick else 6):
            for task in tasks:
                seconds[task.frames].append(ours_timed(task, preset=preset)[1]["run"])
        a_frame = [min(seconds[frames]) / frames for frames in lengths]
        found[name] = {"seconds_a_frame": [_round(x) for x in a_frame], "ratio": _round(a_frame[1] / a_frame[0])}
    return found


def memory(frames: int, windows: bool, quick: bool) -> dict[str, Any]:
    """Peak memory of `recover` above that of the imports, in arrays of the size of D."""
    from benchmarks.speed.contenders import IN_WINDOWS, PRESET, Task, ours_timed

    task = Task(frames // 16 if quick else frames, 3)
    data, _ = task.data, task.lengths
    before = _peak()
    ours_timed(task, preset=IN_WINDOWS if windows else PRESET)
    size = data.size * 4
    return {"frames": task.frames, "arrays": _round((_peak() - before) / size)}


def _peak() -> int:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def importing(quick: bool) -> dict[str, Any]:
    """Seconds of `import motionrecover` and of `import jax`, each in a fresh process."""
    best: dict[str, list[float]] = {"motionrecover": [], "jax": []}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(2 if quick else 7):
            for name, values in best.items():
                values.append(_process([sys.executable, "-c", f"import {name}"], _installed(folder)))
    ours, jax = (min(values) for values in best.values())
    return {"motionrecover": _round(ours), "jax": _round(jax), "ratio": _round(ours / jax)}


def command(quick: bool) -> dict[str, Any]:
    """Seconds of `motionrecover recover` on 300 frames, beside those of a process that compiles x + 1 in JAX."""
    from motionrecover import corrupt, save, synthesize

    motion = synthesize(2.5, 120)
    motion = motion.with_positions(corrupt.joints(np.asarray(motion.positions), 0.2, seed=0)[0], "corrupted")
    trivial = "import jax; jax.jit(lambda x: x + 1)(1.0).block_until_ready()"
    # SciPy's linear algebra is what JAX's decompositions call.
    simple = {"trivial": trivial, "packages": f"import jaxtyping, pywt, rich.console, scipy.linalg, typer; {trivial}"}
    with tempfile.TemporaryDirectory() as folder:
        clip, answer = Path(folder) / "clip.npz", Path(folder) / "answer.npz"
        save(motion, clip)
        cli, environment = [sys.executable, "-m", "motionrecover"], _installed(folder) | {"XDG_CACHE_HOME": folder}
        run = [*cli, "recover", str(clip), "-o", str(answer), "--overwrite", "--quiet"]
        presets = ("str_yang2020",) if quick else ("str_yang2020", "robust")
        found: dict[str, list[float]] = {}
        for _ in range(1 if quick else 6):
            for name, code in simple.items():
                found.setdefault(name, []).append(_process([sys.executable, "-c", code], environment))
            for preset in presets:
                ways = {"cold": [*run, "--preset", preset, "--no-cache"], "warm": [*run, "--preset", preset]}
                if not found.get(f"{preset} warm"):
                    _process(ways["warm"], environment)
                for way, arguments in ways.items():
                    found.setdefault(f"{preset} {way}", []).append(_process(arguments, environment))
    best = {name: min(values) for name, values in found.items()}
    return {
        "seconds": {name: _round(value) for name, value in best.items()},
        "ratio": {name: _round(value / best["trivial"]) for name, value in best.items() if name != "trivial"},
    }


def many(quick: bool) -> dict[str, Any]:
    """`recover_many` over made-up clips of different lengths beside `recover` one at a time."""
    from motionrecover import corrupt, synthesize

    rng = np.random.default_rng(0)
    clips = []
    for frames in rng.integers(60, 900, 4 if quick else 24):
        motion = synthesize(frames / 120, 120)
        clips.append(motion.with_positions(corrupt.joints(np.asarray(motion.positions), 0.2, seed=rng)[0], "corrupted"))
    return _many(clips, {"preset": "str_yang2020", "max_steps": 100}, 1 if quick else 2)


def recordings(preset: str, quick: bool) -> dict[str, Any]:
    """The same over all CMU clips, 5 % of their samples displaced. Needs the recordings: `benchmarks.recordings`."""
    from benchmarks.recordings import MANIFEST, data_folder
    from motionrecover import corrupt, load

    clips = []
    for seed, path in enumerate(sorted((data_folder() / MANIFEST).parent.glob("*.npz"))[: 3 if quick else None]):
        clip = load(path)
        clips.append(clip.with_positions(corrupt.joints(np.asarray(clip.positions), 0.05, seed=seed)[0], "corrupted"))
    return _many(clips, {"preset": preset}, 0)


def _many(clips: list, settings: dict[str, Any], again: int) -> dict[str, Any]:
    """Seconds of `recover_many` and of `recover` on each, at first and `again`; what each compiled; the verdicts."""
    import jax

    from motionrecover import recover_many
    from motionrecover.recovery import recover_motion

    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, seconds, **_: (
            compiled.append(event) if event == "/jax/core/compile/backend_compile_duration" else None
        )
    )
    verdicts: list[str] = []

    def at_once() -> None:
        outcomes = recover_many(clips, **settings)
        verdicts[:] = [outcome.recovery.result.name if outcome.recovery else "no answer" for outcome in outcomes]

    def one_by_one() -> None:
        for clip in clips:
            recover_motion(clip, **settings)

    found: dict[str, Any] = {"clips": len(clips), "frames": sum(map(len, clips)), "processors": processors()}
    for name, call in (("recover_many", at_once), ("recover", one_by_one)):
        del compiled[:]
        seconds = [_seconds(call) for _ in range(1 + again)]
        found[name] = {"first": _round(seconds[0]), "again": _round(min(seconds)), "compiled": len(compiled)}
    return found | {"verdicts": {name: verdicts.count(name) for name in sorted(set(verdicts))}}


def robust(quick: bool) -> dict[str, Any]:
    """`robust` on 1000 frames of 24 joints beside `str_yang2020` and the peers of the suite; one core."""
    from benchmarks.suite.clips import Clip
    from benchmarks.suite.methods import PEERS
    from motionrecover import metrics, recover

    truth, skeleton, data = _take(quick)
    frames = len(truth)
    clip = Clip("made up", truth, skeleton, 120)
    calls: dict[str, Callable[[], np.ndarray]] = {
        "robust": lambda: recover(data, skeleton, fps=120).positions,
        "str_yang2020": lambda: recover(data, skeleton, preset="str_yang2020", fps=120).positions,
        **{peer.name: partial(peer.run, data, clip, None) for peer in PEERS if peer.name != "nothing"},
    }
    found = {name: call() for name, call in calls.items()}
    best = dict.fromkeys(calls, np.inf)
    for _ in range(1 if quick else 4):
        for name, call in calls.items():
            best[name] = min(best[name], _seconds(call))
    return {
        "frames": frames,
        "seconds": {name: _round(value) for name, value in best.items()},
        "aje": {name: round(1000 * metrics.aje(x, truth), 3) for name, x in found.items()},
    }


def pose2sim(quick: bool) -> dict[str, Any]:
    """`robust` beside the filters of Pose2Sim itself, in an environment of its own: `$POSE2SIM` is its Python."""
    from motionrecover import metrics, recover
    from motionrecover.threads import processors

    truth, skeleton, data = _take(quick)
    calls = {
        f"robust, {n} processor{'s' * (n > 1)}": partial(recover, data, skeleton, fps=120, workers=n)
        for n in sorted({1, processors()})
    }
    aje = {name: 1000 * metrics.aje(call().positions, truth) for name, call in calls.items()}
    seconds = dict.fromkeys(calls, np.inf)
    with tempfile.TemporaryDirectory() as folder:
        np.save(f"{folder}/data.npy", data)
        for _ in range(1 if quick else 3):
            for name, call in calls.items():
                seconds[name] = min(seconds[name], _seconds(call))
            done = subprocess.run(
                [os.environ["POSE2SIM"], "-c", FILTERED_BY_POSE2SIM],
                cwd=folder,
                env=os.environ | {"MPLBACKEND": "Agg"},
                check=True,
                stdout=subprocess.PIPE,
                text=True,
            )
            version, *taken = done.stdout.split()
            seconds["Pose2Sim"] = min(seconds.get("Pose2Sim", np.inf), *map(float, taken))
        aje["Pose2Sim"] = 1000 * metrics.aje(np.load(f"{folder}/filtered.npy"), truth)
    return {
        "frames": len(truth),
        "version": version,
        "seconds": {name: _round(value) for name, value in seconds.items()},
        "aje": {name: round(value, 3) for name, value in aje.items()},
    }


FILTERED_BY_POSE2SIM = """
import time
from importlib.metadata import version
import numpy, pandas
from Pose2Sim.filtering import filter1d, hampel_filter
data = numpy.load("data.npy")
table = pandas.DataFrame(data.reshape(len(data), -1))
settings = {"filtering": {"butterworth": {"order": 4, "cut_off_frequency": 6}}}
print(version("pose2sim"))
for _ in range(2):
    start = time.perf_counter()
    filtered = table.apply(hampel_filter).apply(filter1d, args=[settings, "butterworth", 120])
    print(time.perf_counter() - start)
numpy.save("filtered.npy", filtered.to_numpy().reshape(data.shape))
"""
"""Both filters on every column of a table, with their default settings: `filter_all` without its files."""


def _take(quick: bool):
    """1000 frames of 24 joints, 5 % of the samples displaced: the truth, the skeleton and the data."""
    from motionrecover import Skeleton, corrupt
    from motionrecover.synthetic import synthesize

    motion = synthesize((120 if quick else 1000) / 120, 120)
    truth = np.asarray(motion.positions, float)[:, :24]
    skeleton = Skeleton(motion.skeleton.names[:24], [edge for edge in motion.skeleton.edges if max(edge) < 24])
    return truth, skeleton, corrupt.joints(truth, 0.05, seed=0)[0]


def batch(quick: bool, gpu: bool = False) -> dict[str, Any]:
    """Frames a second of 40 iterations on many clips in one vmapped program: 1024 clips of 512 frames on a GPU."""
    import jax
    import jax.numpy as jnp

    from benchmarks.speed.contenders import PRESET, Task
    from motionrecover import corrupt, intake, metrics
    from motionrecover.solver import solve

    if gpu and jax.default_backend() != "gpu":
        raise RuntimeError(f"received --gpu: JAX runs on {jax.default_backend()} here, install jax[cuda12]")
    clips, frames, steps = (2, 64, 3) if quick else (1024 if gpu else 16, 512, 40)
    task = Task(frames)
    with jax.enable_x64(True):
        pairs = []
        for seed in range(min(clips, 16)):
            data = corrupt.joints(task.truth, 0.2, seed=seed)[0]
            taken = intake.take_in(data, task.skeleton, bone_lengths=task.lengths)
            problem, origin = taken.problem(slice(0, frames), frames, np.dtype(np.float32))
            pairs.append((PRESET.solver(problem), problem))
        pairs = [pairs[k % len(pairs)] for k in range(clips)]
        arguments = jax.tree.map(lambda *leaves: jnp.stack(leaves), *pairs)
        start = time.perf_counter()
        program = jax.jit(jax.vmap(lambda pair: partial(solve, max_steps=steps)(*pair).positions))
        program = program.lower(arguments).compile()
        compiled = time.perf_counter() - start
        answer = jax.block_until_ready(program(arguments))
        best = min(_seconds(lambda: jax.block_until_ready(program(arguments))) for _ in range(3))
        last = np.asarray(answer[min(clips, 16) - 1]).transpose(2, 1, 0) + origin
    return {
        "device": jax.devices()[0].device_kind,
        "clips": clips,
        "frames": frames,
        "steps": steps,
        "compile": _round(compiled),
        "seconds": _round(best),
        "frames_a_second": _round(clips * frames / best),
        "aje": round(1000 * metrics.aje(last, task.truth), 4),
    }


ROWS: dict[str, tuple[Callable[[bool], dict[str, Any]], bool]] = {
    **{f"iterations-{frames}": (partial(iterations, frames), True) for frames in LENGTHS},
    "long": (long_clips, True),
    **{f"memory-{frames}": (partial(memory, frames, False), True) for frames in KEPT},
    **{f"memory-windows-{frames}": (partial(memory, frames, True), True) for frames in KEPT},
    "import": (importing, False),
    "command": (command, False),
    "many": (many, False),
    **{f"recordings-{name}": (partial(recordings, name), False) for name in ("str_yang2020", "robust")},
    "robust": (robust, True),
    "pose2sim": (pose2sim, False),
    "batch": (batch, False),
}
"""By name: the function of whether to be quick, and whether it runs on one core."""


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _installed(folder: str) -> dict[str, str]:
    """The environment in which a package has its bytecode, as an installed one does."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPYCACHEPREFIX": folder}


def _process(arguments: list[str], environment: dict[str, str] | None = None) -> float:
    start = time.perf_counter()
    subprocess.run(arguments, env=environment, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def _round(value: float) -> float:
    return float(f"{value:.4g}")
