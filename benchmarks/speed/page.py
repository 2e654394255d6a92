"""`docs/performance.md` and its picture, made of the committed results.

python -m benchmarks.speed.page
"""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.markdown import table
from benchmarks.speed.rows import KEPT, ROOT
from motionrecover.io.atomic import write_beside

RESULTS = Path(__file__).parent / "results.json"
PAGE = ROOT / "docs" / "performance.md"
FIGURE = ROOT / "docs" / "figures" / "performance.png"
TITLE = """# Performance

Made by `python -m benchmarks.speed` (about half an hour), which measures everything anew; a test holds this page to the
committed `benchmarks/speed/results.json`. Rows that compare take turns in one process and the best of several runs
counts; rows of one core are pinned to it, with one thread for XLA and BLAS.

{machine}; {versions}."""
ITERATIONS = """Seconds for 40 iterations of `str_yang2020` on the whole clip at once: a made-up motion of {joints}
joints, 20 % of its samples displaced; one core. Ours is `recover`, float32, without compiling. The others:

- reference: `benchmarks/reference.py`, NumPy, PyWavelets and SciPy's sparse conjugate gradients, float64;
- numpy: vectorised over frames, float64, the systems of all frames by one `np.linalg.solve`;
- numpy elimination: our algorithm in NumPy, float64 (what is left is the compiler's);
- optimistix + lineax, jaxopt: assembled from the parts of these libraries in JAX, float32.

The second table is the mean joint error of each in mm: the time of one that has another error than the rest says
nothing. The conjugate gradients of the two libraries see all frames as one system, and lose their way on long clips."""
LIMIT = """An iteration must read or write {arrays:.1f} arrays of the size of D, because the singular value threshold
must have seen all of H before any of A (`benchmarks/speed/limit.py` counts them). At the bandwidth at which this core
copies blocks of the size of the eight arrays that an iteration keeps, that is the limit: where the filters, the
products and the elimination cost nothing and everything made on the way stays in the cache."""
OTHERS = """40 iterations on long clips, one core: of the clip as a whole, and in windows of 100 frames, as users of
`str_yang2020` have them. Peak memory is that of `recover` above its imports; compiling takes about 100 MB of it,
whatever the length."""
MANY = """`recover_many` on {processors} processors, beside `recover` on one clip after the other with programs that are
compiled by then. The recordings are all clips of the CMU database that the studies use, with 5 % of their samples
displaced."""

POSE2SIM = """Of these, `hampel-butterworth` is ours, for all joints at once. Pose2Sim {version} itself runs its Hampel
filter, and then its Butterworth filter of order 4 at 6 Hz, through the numbers of every column in Python. In a process
of their own, without reading and writing, on the same clip:"""


def render(results: dict) -> str:
    """The page."""
    rows = results["rows"]
    found = [row for name, row in rows.items() if name.startswith("iterations-")]
    versions = ", ".join(f"{name} {number}" for name, number in results["versions"].items())
    blocks = [
        TITLE.format(machine=results["machine"], versions=versions),
        "## The same iterations, computed in other ways",
        ITERATIONS.format(joints=found[0]["joints"]),
        _iterations(found),
        _errors(found),
        "## The limit",
        LIMIT.format(arrays=_arrays()),
        _limit(found),
        "![Seconds of 40 iterations against frames](figures/performance.png)",
        "## Long clips",
        OTHERS,
        _long(rows),
        "## Starting and compiling",
        _starting(rows, found),
        "## Many clips",
        MANY.format(processors=rows["many"]["processors"]),
        _many(rows),
        "## `robust`",
        _robust(rows["robust"]),
        *_pose2sim(rows.get("pose2sim")),
        "## Batches",
        _batch(rows),
    ]
    return "\n\n".join(blocks) + "\n"


def _iterations(found: list[dict]) -> str:
    names = [name for name in found[0]["seconds"] if name != "ours"]
    head = ["frames", "ours, s", *(f"{name}, s" for name in names), *(f"{name} / ours" for name in names)]
    lines = []
    for row in found:
        seconds = row["seconds"]
        ratios = [f"**{_number(seconds[name] / seconds['ours'])}**" for name in names]
        times = [_number(seconds[name]) for name in ("ours", *names)]
        lines.append([str(row["frames"]), *times, *ratios])
    return table(head, lines)


def _errors(found: list[dict]) -> str:
    names = list(found[0]["aje"])
    lines = [
        [str(row["frames"]), *(f"{row['aje'][name]:.4f}" for name in names), f"{row['float64_apart_mm']:.2g}"]
        for row in found
    ]
    return table(["frames", *names, "ours in float32 from float64"], lines)


def _arrays() -> float:
    from benchmarks.speed.limit import ARRAYS

    return ARRAYS


def _limit(found: list[dict]) -> str:
    lines = [
        [
            str(row["frames"]),
            f"{row['bandwidth'] / 1e9:.1f}",
            _number(1e3 * row["limit"] / row["steps"]),
            _number(1e3 * row["seconds"]["ours"] / row["steps"]),
            f"**{row['seconds']['ours'] / row['limit']:.1f}**",
        ]
        for row in found
    ]
    return table(["frames", "copy, GB/s", "limit, ms an iteration", "ours, ms", "ours / limit"], lines)


def _long(rows: dict) -> str:
    long = rows["long"]
    ways = "whole", "windows"
    lines = [
        [f"{frames} frames", *(f"{1e6 * long[way]['seconds_a_frame'][k]:.0f} us a frame" for way in ways)]
        for k, frames in enumerate(long["frames"])
    ]
    lines.append(["ratio", *(f"**{long[way]['ratio']:.2f}**" for way in ways)])
    kept = {"whole": "memory-", "windows": "memory-windows-"}
    arrays = {way: [rows[f"{prefix}{frames}"]["arrays"] for frames in KEPT] for way, prefix in kept.items()}
    for k, frames in enumerate(KEPT):
        lines.append([f"memory, {frames} frames", *(f"{arrays[way][k]:.0f} times D" for way in ways)])
    grown = {way: (KEPT[-1] * arrays[way][-1] - KEPT[-2] * arrays[way][-2]) / (KEPT[-1] - KEPT[-2]) for way in ways}
    lines.append(["memory, each further frame", *(f"**{grown[way]:.0f}** times the frame" for way in ways)])
    return table(["", "whole", "in windows"], lines)


def _starting(rows: dict, found: list[dict]) -> str:
    importing, command = rows["import"], rows["command"]
    lines = [
        ["compiling `str_yang2020`, one core", f"{max(row['compile'] for row in found):.2f} s at most"],
        ["`import motionrecover`", f"{importing['motionrecover']:.2f} s, {importing['ratio']:.2f} of `import jax`"],
    ]
    for name, ratio in command["ratio"].items():
        what = "compiling x + 1, with the packages that the command imports"
        if name != "packages":
            preset, cache = name.split()
            what = f"command, 300 frames, `{preset}`, {cache} cache"
        lines.append([what, f"{command['seconds'][name]:.1f} s, {ratio:.2f} of a process that compiles x + 1"])
    return table(["", ""], lines)


def _many(rows: dict) -> str:
    lines = []
    for name, row in rows.items():
        if name == "many" or name.startswith("recordings-"):
            what = "made up, `str_yang2020`" if name == "many" else f"CMU, `{name.removeprefix('recordings-')}`"
            many, alone = row["recover_many"], row["recover"]
            verdicts = ", ".join(f"{count} {verdict.replace('_', ' ')}" for verdict, count in row["verdicts"].items())
            seconds = [_number(many["again"]), _number(alone["again"]), f"**{alone['again'] / many['again']:.2f}**"]
            lines.append([what, str(row["clips"]), f"{row['frames']:,}", *seconds, str(many["compiled"]), verdicts])
    head = ["clips", "number", "frames", "`recover_many`, s", "`recover`, s", "ratio", "compilations", "verdicts"]
    return table(head, lines)


def _robust(row: dict) -> str:
    seconds, ours = row["seconds"], row["seconds"]["robust"]
    lines = [
        [name, _number(seconds[name]), _number(seconds[name] / ours), f"{row['aje'][name]:.2f}"] for name in seconds
    ]
    head = [f"{row['frames']} frames, 24 joints, 5 % displaced, one core", "s", "/ robust", "AJE, mm"]
    return table(head, lines)


def _pose2sim(row: dict | None) -> list[str]:
    if row is None:
        return []
    seconds, theirs = row["seconds"], row["seconds"]["Pose2Sim"]
    lines = [
        [name, _number(seconds[name]), f"**{_number(theirs / seconds[name])}**", f"{row['aje'][name]:.2f}"]
        for name in seconds
    ]
    head = [f"{row['frames']} frames, 24 joints", "s", "Pose2Sim / it", "AJE, mm"]
    return [POSE2SIM.format(version=row["version"]), table(head, lines)]


def _batch(rows: dict) -> str:
    lines = [
        [
            row["device"],
            str(row["clips"]),
            str(row["frames"]),
            str(row["steps"]),
            f"{row['seconds']:.2f}",
            f"{row['frames_a_second']:,.0f}",
            f"{row['aje']:.2f}",
        ]
        for name, row in rows.items()
        if name.startswith("batch")
    ]
    return table(["one vmapped program on", "clips", "frames", "iterations", "s", "frames / s", "AJE, mm"], lines)


def _number(value: float) -> str:
    return f"{value:.3g}" if value < 100 else f"{value:.0f}"


def draw(results: dict, path: Path) -> None:
    """Seconds of 40 iterations against frames, with the limit and four times it."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found = [row for name, row in results["rows"].items() if name.startswith("iterations-")]
    frames = [row["frames"] for row in found]
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    limit = [row["limit"] for row in found]
    axes.fill_between(frames, limit, [4 * x for x in limit], color="0.85", label="the limit to 4 times it")
    for name in found[0]["seconds"]:
        width = 2.5 if name == "ours" else 1.2
        axes.plot(frames, [row["seconds"][name] for row in found], marker="o", linewidth=width, label=name)
    axes.set(xscale="log", yscale="log", xlabel="frames", ylabel="seconds for 40 iterations, one core")
    axes.set_xticks(frames, [str(x) for x in frames])
    axes.minorticks_off()
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main() -> None:
    """Write the page and the picture."""
    results = json.loads(RESULTS.read_text(encoding="utf-8"))
    with write_beside(PAGE, overwrite=True) as temporary:
        temporary.write_text(render(results), encoding="utf-8")
    draw(results, FIGURE)


if __name__ == "__main__":
    main()
