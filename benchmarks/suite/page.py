"""`docs/robust.md` and a table of README.md, made of the committed results of the suite and the studies of `robust`.

python -m benchmarks.suite.page
"""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.markdown import filled, table
from motionrecover.io.atomic import write_beside

HERE = Path(__file__).parent
STUDIES = HERE.parent / "studies" / "results"
README, PAGE = HERE.parents[1] / "README.md", HERE.parents[1] / "docs" / "robust.md"
TITLE = """# What `robust` does to recordings, measured

Made by `python -m benchmarks.suite.page` from committed results. One command each measures them anew:
`python -m benchmarks.suite` and `python -m benchmarks.studies.{kinect,markers,robust,pose_prior,stream}`. Errors are in
mm."""
SUITE = """{clips} clips a row, spread evenly over subjects, at most 300 frames from the middle of each, {seeds} seeds.
The error is over missing samples where the protocol makes gaps and over all samples elsewhere, +- its standard error
over clips. The best peer has the least error of a cubic spline, running medians of 5, 15 and 31 frames, Hampel filter
with Butterworth, a Kalman smoother, rigid donors, PCA, soft-impute and robust PCA of poses and of motion. Accelerations
are relative to the truth's: denoised motion is calmer than a recording, whose own jitter cannot be told from noise."""
KINECT = """Tracked samples count with confidence 1, inferred ones with 0.3. Bones: the largest standard deviation of a
bone's length over its mean. Jitter: second differences of joints that barely move, before over after. Hidden: distance
from tracked samples that were hidden, scattered and in runs of 15 frames. At scattered ones a spline is better: it
follows the sensor's drift, which constant bones do not."""
MARKERS = """{frames} frames a take, the graph from `infer_graph`; mean distance from hidden samples. In
`cmu_85_12.c3d` two markers of a shoe part from 7 to 17 cm in twelve frames: `robust` takes them for displaced, and
hidden samples among them count as errors."""
POSES = """The package ships poses of 10 people (`poses.npz`), from all CMU recordings at hand. All measurements on this
page leave the clip's own person out of them. `uncertainty` knows how much people of this database differ: for motions
unlike its walks, dances and sports it promises too much. A joint hidden in the whole clip, each in turn; straight limbs
are given the true bone lengths, poses guess them ({clips} clips, {seeds} seed):"""

STREAM = """`Stream` beside `recover` on the whole clip, and beside what is simple: cmu25, {clips} clips a row of
{frames} frames, from the second second on; all samples, those of the second half, and missing ones in rows that make
gaps. `recover` up to 1 s has all that came until a second after each frame, which is what can be known by then: of the
body and its motion a stream knows the past, and of a gap often one end. The running median has 5 frames; it, hold and
the one-euro filter hold the last sample over gaps."""
TIMES = """Joined recordings at their rate on one core, a delay of 0.25 s: the time of `push` as a share of a frame's,
and what its own thread worked of it; load is the processor time of all threads over the time of the frames."""

SHORT = {
    "iid-5 cmu25 120 Hz": "5 % of the samples displaced, 120 Hz",
    "iid-20 cmu25 120 Hz": "20 % displaced",
    "iid-80 cmu25 120 Hz": "80 % displaced",
    "iid-20 cmu25 30 Hz, bones known": "20 % displaced, 30 Hz, bone lengths given",
    "rand30 cmu25 120 Hz": "30 % missing, here and there",
    "gap3x60 cmu21 120 Hz": "three gaps of half a second",
    "gap3x240 cmu21 120 Hz": "three gaps of two seconds",
    "noise-3 cmu21 120 Hz": "noise of 3 mm",
    "mixed cmu21 120 Hz": "noise, spikes and gaps at once",
    "mixed cmu21 30 Hz": "the same at 30 Hz",
    "clean cmu21 120 Hz": "nothing",
}
"""Rows of README.md, as users would call them."""


def render() -> str:
    """The page."""
    studies = (STUDIES / f"{name}.json" for name in ("kinect", "markers", "robust", "pose_prior", "stream"))
    suite, kinect, markers, parts, poses, stream = (
        json.loads(path.read_text(encoding="utf-8")) for path in (HERE / "results.json", *studies)
    )
    parts_note = (
        f"{parts['clips']} clips a row, one seed; `benchmarks/studies/robust.py` lists what was dropped altogether."
    )
    blocks = [
        TITLE,
        "## Corrupted CMU recordings",
        SUITE.format(**suite["settings"]),
        _suite(suite),
        "## Kinect recordings",
        KINECT,
        _kinect(kinect),
        "## Optical markers",
        MARKERS.format(**markers),
        _markers(markers["rows"]),
        "## What its parts are worth",
        parts_note,
        _parts(parts["errors"]),
        "## Poses of other people",
        POSES.format(**poses),
        _unseen(poses["unseen"]),
        "Missing samples of gaps:",
        table(["row", "with poses", "without"], [[k, *map(_number, v.values())] for k, v in poses["gaps"].items()]),
        "## Live streams",
        STREAM.format(**stream),
        _streams(stream["errors"]),
        TIMES.format(**stream),
        _times(stream["times"]),
    ]
    return "\n\n".join(blocks) + "\n"


def readme(text: str) -> str:
    """README.md with its table made anew."""
    results = json.loads((HERE / "results.json").read_text(encoding="utf-8"))
    lines = []
    for name, words in SHORT.items():
        scores, headline, best = _scores(results, name)
        columns = (scores[method][headline]["mean"] for method in ("nothing", best, "robust"))
        nothing, peer, ours = map(_number, columns)
        lines.append([words, nothing, f"{peer} ({best})", f"**{ours}**"])
    found = table(["what happened to it", "do nothing", "best peer", "`robust`"], lines)
    return filled(text, {"readme": found}.__getitem__, "suite")


def _scores(results: dict, name: str) -> tuple[dict, str, str]:
    """A row's scores by method, the one that counts in it, and the peer that is best in that."""
    row = results["rows"][name]
    headline, scores = row["headline"], {method: summary["scores"] for method, summary in row["methods"].items()}
    peers = {
        method: found[headline]["mean"]
        for method, found in scores.items()
        if method not in results["ours"] and method != "nothing" and found[headline]["mean"] is not None
    }
    return scores, headline, min(peers, key=peers.__getitem__)


def _suite(results: dict) -> str:
    rows = []
    for name in results["rows"]:
        scores, headline, best = _scores(results, name)
        ours = scores["robust"]
        error = f"{_number(ours[headline]['mean'])} +- {_number(ours[headline]['error'])}"
        others = [_number(ours[score]["mean"]) for score in ("all", "bone", "acceleration")]
        rows.append([name, error, *others, f"{_number(scores[best][headline]['mean'])} {best}"])
    return table(["protocol, skeleton, rate", "`robust`", "all samples", "bones", "accelerations", "best peer"], rows)


def _kinect(results: dict) -> str:
    rows = []
    for name, row in results.items():
        bones, still = row["bones"], row["still"]
        hidden = [
            f"{_number(row[kind][f'{who} mm'])}" for kind in ("scattered", "runs") for who in ("robust", "spline")
        ]
        bones = f"{100 * bones['before']:.0f} to {100 * bones['after']:.3f} %"
        rows.append([name, bones, f"{still['ratio']:.1f}", str(row["lag"]), *hidden])
    head = ["recording", "bones", "jitter", "lag, frames", "scattered: `robust`", "spline", "runs: `robust`", "spline"]
    return table(head, rows)


def _markers(rows: dict) -> str:
    names = ("linear", "spline", "pca", "rigid donors", "robust")
    lines = [
        [row, take, *(_number(found[name]) for name in names)]
        for row, takes in rows.items()
        for take, found in takes.items()
    ]
    return table(["hidden", "take", *names], lines)


def _parts(errors: dict) -> str:
    rows = next(iter(errors.values()))
    return table(["", *rows], [[name, *map(_number, found.values())] for name, found in errors.items()])


def _unseen(skeletons: dict) -> str:
    names = ("poses", "mean pose", "bones", "error over uncertainty")
    rows = [
        [f"{joint}, {skeleton}", *(_number(found[name]) for name in names)]
        for skeleton, joints in skeletons.items()
        for joint, found in joints.items()
    ]
    return table(["hidden", "poses", "mean pose", "straight limbs", "error over uncertainty"], rows)


def _streams(rows: dict) -> str:
    methods = ("recover", "recover up to 1 s", "1 s", "0.25 s", "0 s", "hold last", "running median", "one-euro")
    lines = [
        [f"{row}, {what}", *(_number(found[method][kind]) for method in methods)]
        for row, found in rows.items()
        for kind, what in (("all", "all samples"), ("later", "second half"), ("missing", "missing samples"))
        if kind in found["recover"]
    ]
    return table(["protocol, rate", "`recover`", "`recover` up to 1 s", *methods[2:]], lines)


def _times(rows: dict) -> str:
    names = list(next(iter(rows.values())))
    return table(["", *names], [[row, *(_number(found[name]) for name in names)] for row, found in rows.items()])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}" if value < 100 else f"{value:.0f}"


def main() -> None:
    """Write both."""
    for path, text in ((PAGE, render()), (README, readme(README.read_text(encoding="utf-8")))):
        with write_beside(path, overwrite=True) as temporary:
            temporary.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
