"""What the tables of networks are made of: rows, networks, and the numbers printed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.suite.clips import Clip
from motionrecover import corrupt
from motionrecover.refine.corruptions import elsewhere
from motionrecover.refine.normalise import LI, place

HELD_OUT = ("02", "05", "09", "16")
"""Subjects; 13, who has the skeleton of 14, is trained on as 14 is."""


@dataclass(frozen=True)
class Row:
    """What is done to a clip."""

    name: str
    missing: float = 0.0
    """Probability of a sample."""
    joints: int = 0
    """That are missing throughout."""
    sigma: float = 0.0
    """Of Gaussian noise an axis, in metres."""
    decibels: float | None = None
    """Signal-to-noise ratio, the signal being the motion about its mean pose."""
    displaced: float = 0.0
    """Probability of a sample, which is then off by up to 25 cm an axis and not marked as missing."""
    sensor: bool = False
    """Joints as another sensor defines them: the protocol `sensor` of `refine.corruptions`."""

    @property
    def noisy(self) -> bool:
        """Whether observed samples are not the truth."""
        return bool(self.sigma or self.decibels is not None or self.displaced or self.sensor)

    def corrupted(self, clip: Clip, seed: int) -> np.ndarray:
        """The clip's positions, NaN where missing."""
        rng = np.random.default_rng([seed, *self.name.encode(), *clip.name.encode()])
        data, (frames, joints) = clip.positions.copy(), clip.positions.shape[:2]
        hidden = rng.choice(joints, self.joints, replace=False)
        lost = rng.random((frames, joints)) < self.missing
        lost[:, hidden] = True
        sigma = self.sigma
        if self.decibels is not None:
            about = place(data, np.ones(joints, bool), clip.skeleton, LI, clip.fps).inward(data)
            sigma = np.sqrt(((about - about.mean(0)) ** 2).mean() * 10 ** (-self.decibels / 10))
        if self.sensor:
            data = elsewhere(data)
        data += rng.normal(scale=sigma, size=data.shape) if sigma else 0
        if self.displaced:
            data, _ = corrupt.joints(data, self.displaced, seed=rng)
        data[lost] = np.nan
        return data


@dataclass(frozen=True)
class Network:
    """A network and how it is trained."""

    model: str
    protocol: str
    preset: str = "small"
    steps: int | None = None
    heading: str | None = None


@dataclass(frozen=True)
class Table:
    """A table of a paper."""

    rows: tuple[str, ...]
    networks: tuple[str, ...]
    measures: tuple[str, ...] = ("P", "B", "J")
    beside: tuple[str, ...] = ()
    """What is shown besides networks and what every table shows."""
    printed: dict[str, dict[str, tuple[float, ...]]] | None = None
    """Row -> network -> the paper's numbers of `measures`."""


ROWS = {
    row.name: row
    for row in (
        *(Row(f"{p} % missing", missing=p / 100) for p in (10, 20, 30, 40)),
        *(Row(f"{n} joint{'s' * (n > 1)} throughout", joints=n) for n in (1, 2, 3)),
        *(Row(f"{p} % missing, {s} cm", missing=p / 100, sigma=s / 100) for p in (10, 20) for s in (1, 2, 3)),
        *(Row(f"noise of {d} dB", decibels=d) for d in (1, 20)),
        *(Row(f"{p} % missing, 15 dB", missing=p / 100, decibels=15) for p in (10, 40)),
        Row("another sensor", missing=0.05, sigma=0.015, sensor=True),
        *(Row(f"{p} % displaced", displaced=p / 100) for p in (5, 10, 15, 20, 80)),
    )
}
_MODELS = ("cnn", "ebd", "bra", "ebd-dgn", "bra-dgn")


def _networks():
    recipe = {name: Network(name, "mixed", "identity") for name in ("bra", "bra-dgn")}
    small = {f"{model} 40": Network(model, "choi-missing40") for model in _MODELS}
    noisy = {f"{model} 20+3": Network(model, "choi-missing20-noise3") for model in _MODELS}
    blocks = {f"{n} blocks": Network("bra-dgn" if n == 3 else f"bra-dgn-{n}", "choi-missing10") for n in (2, 3, 4, 5)}
    turned = {f"{model} turned": Network(model, "choi-missing40", heading="kept") for model in _MODELS}
    li1 = {f"{m} mixed": Network(m, "li-mixed") for m in ("bra-p", "cnn", "cnn+constraint", "ebf", "ebf+b")}
    li3 = ("cnn", "ebd", "ebd-p", "bra-p-256", "bra", "bra-p-d", "bra-p")
    sensor = {f"{m} sensor": Network(m, "sensor") for m in li3}
    markers = {f"{m} 40": Network(f"missing-marker-{m}", "choi-missing40") for m in ("window", "lstm")}
    return small | noisy | blocks | turned | li1 | sensor | markers | recipe


SUFFIXES = ("", ", kept", " guides STR", " and STR in turns")
"""Of a network's name: alone; with observed samples kept; its answer as guide of the published model, once and three
times in turns."""

GUIDED = {"bra-dgn": ("40 % missing", "1 joint throughout", "20 % missing, 3 cm")}
"""Networks that guide, and the rows where."""

NETWORKS = _networks()
"""By name, in the order in which they are trained."""


def _printed(names: tuple[str, ...], rows: tuple[str, ...], text: str) -> dict[str, dict[str, tuple[float, ...]]]:
    """A line a row: the numbers of a network, by slashes."""
    lines = [line.split() for line in text.strip().splitlines()]
    return {
        row: {name: tuple(map(float, cell.split("/"))) for name, cell in zip(names, line, strict=True)}
        for row, line in zip(rows, lines, strict=True)
    }


def _choi(suffix: str) -> tuple[str, ...]:
    return tuple(f"{model} {suffix}" for model in _MODELS)


_MISSING = tuple(f"{p} % missing" for p in (10, 20, 30, 40))
_JOINTS = ("1 joint throughout", "2 joints throughout", "3 joints throughout")
_NOISY = tuple(f"{p} % missing, {s} cm" for p in (10, 20) for s in (1, 2, 3))
_DISPLACED = tuple(f"{p} % displaced" for p in (5, 10, 15, 20, 80))
_LI = ("noise of 1 dB", "noise of 20 dB", "10 % missing, 15 dB", "40 % missing, 15 dB")

CHOI2 = """
6.817/2.759/1.183 1.594/0.704/0.279 1.115/0.494/0.113 1.063/0.457/0.090 0.898/0.361/0.083
2.494/1.077/0.316 1.294/0.560/0.249 0.956/0.414/0.108 0.846/0.381/0.107 0.708/0.294/0.083
1.665/0.781/0.116 1.176/0.501/0.244 0.900/0.384/0.106 0.777/0.351/0.120 0.653/0.272/0.083
1.503/0.729/0.106 1.161/0.492/0.238 0.905/0.381/0.105 0.780/0.347/0.133 0.653/0.273/0.083
12.672/5.444/0.673 2.466/1.025/0.200 1.923/0.849/0.142 2.012/0.782/0.067 1.850/0.701/0.090
8.099/3.557/0.366 2.802/1.137/0.209 2.340/1.002/0.150 2.308/0.914/0.070 2.148/0.834/0.090
6.453/2.959/0.220 3.251/1.266/0.218 2.844/1.167/0.160 2.677/1.054/0.072 2.525/0.975/0.090
"""
CHOI3 = """
2.038/0.910/0.151 1.421/0.568/0.232 1.352/0.542/0.176 1.328/0.575/0.090 1.275/0.488/0.093
2.033/0.902/0.166 1.413/0.555/0.230 1.325/0.512/0.166 1.191/0.475/0.096 1.151/0.413/0.090
2.163/0.934/0.190 1.480/0.559/0.239 1.385/0.515/0.165 1.229/0.448/0.113 0.825/0.382/0.087
1.736/0.823/0.106 1.341/0.524/0.234 1.283/0.489/0.162 1.159/0.467/0.100 1.148/0.420/0.091
1.703/0.802/0.103 1.356/0.518/0.235 1.282/0.484/0.157 1.117/0.414/0.108 1.083/0.372/0.090
1.780/0.810/0.101 1.436/0.526/0.244 1.352/0.486/0.158 1.219/0.415/0.128 1.146/0.359/0.087
"""
CHOI4 = """
4.226/1.794/0.082 2.269/0.891/0.363 1.711/0.693/0.222 1.961/0.721/0.179 1.426/0.530/0.069
3.217/1.372/0.076 1.933/0.762/0.353 1.491/0.605/0.190 1.430/0.556/0.203 1.038/0.415/0.078
2.589/1.115/0.076 1.770/0.694/0.342 1.418/0.568/0.173 1.248/0.498/0.222 0.976/0.395/0.090
2.428/1.086/0.079 1.758/0.697/0.335 1.429/0.556/0.164 1.228/0.490/0.239 1.028/0.417/0.103
"""
STR5 = """
32.9 0.2
33.0 0.5
32.6 0.7
32.5 0.9
33.1 4.4
"""
LI1 = """
1.9124/0.9975/0.6353 3.2249/2.3558/1.9458 7.7710/0.9116/1.2716 1.3062/2.2425/2.2666 1.2803/2.0974/2.1317
"""
_BLOCKS = tuple(f"{n} blocks" for n in (2, 3, 4, 5))
_RECIPE = ("bra", "bra-dgn")
_LI1 = ("bra-p mixed", "cnn mixed", "cnn+constraint mixed", "ebf mixed", "ebf+b mixed")
_LI3 = tuple(f"{m} sensor" for m in ("cnn", "ebd", "ebd-p", "bra-p-256", "bra", "bra-p-d", "bra-p"))

TABLES = {
    "choi2": Table(_MISSING + _JOINTS, _choi("40") + _RECIPE, printed=_printed(_choi("40"), _MISSING + _JOINTS, CHOI2)),
    "choi3": Table(_NOISY, _choi("20+3") + _RECIPE, printed=_printed(_choi("20+3"), _NOISY, CHOI3)),
    "choi4": Table(_MISSING, _choi("turned"), printed=_printed(_choi("turned"), _MISSING, CHOI4)),
    "choi5": Table(
        _MISSING[:1],
        _BLOCKS,
        printed=_printed(
            _BLOCKS, _MISSING[:1], "0.664/0.250/0.264 0.658/0.262/0.253 0.767/0.274/0.263 0.755/0.276/0.265"
        ),
    ),
    # The paper prints means over the four corruptions.
    "li1": Table(
        _LI,
        _LI1,
        ("R", "B", "S"),
        printed=_printed(_LI1, ("mean",), LI1),
    ),
    "li3": Table(
        ("another sensor",),
        _LI3,
        ("R", "B", "S"),
        printed=_printed(
            _LI3,
            ("another sensor",),
            "124.4595/1.1795/1.6054 21.9174/1.5766/1.2125 21.9753/0.7297/0.7631 25.6083/0.7237/0.5378 "
            "19.7190/0.6204/0.4717 20.2954/0.5733/0.4540 21.7332/0.4826/0.3984",
        ),
    ),
    # Of clip 05_01, whose person neither was trained on.
    "str5": Table(
        _DISPLACED,
        ("window 40", "lstm 40"),
        ("P",),
        ("str_yang2020",),
        _printed(("lstm 40", "str_yang2020"), _DISPLACED, STR5),
    ),
}  # fmt: skip
COUNTS = {"cnn": 807, "ebd": 3502, "bra": 3502, "ebd-dgn": 3451, "bra-dgn": 3451}
"""Choi et al. 2024, Table 6: thousands of numbers learnt."""
BLOCK_COUNTS = {"bra-dgn-2": 3446, "bra-dgn": 3451, "bra-dgn-4": 3458, "bra-dgn-5": 3463}
"""... and Table 5."""
