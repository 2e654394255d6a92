"""The page docs/reproduction.md and the table of README.md: every number between their markers is from the results.

A block of a page lies between `<!-- name -->` and `<!-- end -->`, with a name of `BLOCKS`.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from benchmarks.markdown import filled, table
from benchmarks.studies.yang2020_figures import draw
from motionrecover.io import write_beside

ROOT = Path(__file__).resolve().parents[2]
PAGES = (ROOT / "docs" / "reproduction.md", ROOT / "README.md")

# Yang et al. 2020, in thousandths of the unit: metres in Tables II and V, inches in Table III; 5, 10, 15, 20, 80 %.
TABLE2 = {
    "05": {
        "lowrank_wang2016": (66, 70, 73, 75, 93),
        "isometry_li2017": (2, 5, 8, 11, 74),
        "str_yang2020": (2, 5, 7, 9, 64),
    },
    "09": {
        "lowrank_wang2016": (76, 79, 83, 85, 122),
        "isometry_li2017": (5, 7, 10, 14, 73),
        "str_yang2020": (4, 5, 6, 8, 63),
    },
}
TABLE3 = {
    "05_01": {
        "lowrank_wang2016": (58, 125, 185, 251, 904),
        "isometry_li2017": (30, 77, 117, 170, 743),
        "str_yang2020": (13, 33, 57, 85, 564),
    },
    "05_14": {
        "lowrank_wang2016": (77, 156, 229, 312, 1028),
        "isometry_li2017": (45, 97, 154, 215, 858),
        "str_yang2020": (17, 31, 55, 95, 582),
    },
}
TABLE5 = (2, 5, 7, 9, 44)
TABLE6 = {
    272: {"lowrank_wang2016": 1.0983, "isometry_li2017": 22.7150, "str_yang2020": 24.7055},
    584: {"lowrank_wang2016": 1.4027, "isometry_li2017": 47.5670, "str_yang2020": 60.7618},
    1100: {"lowrank_wang2016": 4.4831, "isometry_li2017": 96.0281, "str_yang2020": 148.7628},
    6784: {"lowrank_wang2016": 23.9200, "isometry_li2017": 478.3740, "str_yang2020": 586.2765},
}
NAMES = {"lowrank_wang2016": "Wang 2016", "isometry_li2017": "Li 2017", "str_yang2020": "Yang 2020"}
PEERS = {
    "nothing": "do nothing",
    "median 5": "running median, 5 frames",
    "median 15": "running median, 15 frames",
    "median 31": "running median, 31 frames",
    "oracle spline": "cubic spline through the intact samples, **named by an oracle**",
}
VARIANTS = {
    "nothing": "do nothing",
    "letter": "the letter: A = 0, ρ = 0.5 growing by 1.3 without end, coordinates as they come",
    "from data": "... but A = D",
    "centred": "... and the origin at the median sample",
    "preset": "... and ρ from the data, growth bounded: the preset",
    "preset from zero": "preset, but A = 0",
    "preset not centred": "preset, but coordinates as they come",
    "preset in float64": "preset in float64",
    "bones estimated": "preset, bone lengths estimated from the corrupted clip",
}
SPANS = {"windows of 300": "in windows of 300 frames, not 100", "whole clip": "the whole clip at once"}
READINGS = {
    "metres": "metres",
    "inches": "inches",
    "file": "units of the file",
}


def write(results: dict) -> None:
    """Renders the pages in place and draws their figures."""
    for page in PAGES:
        with write_beside(page, overwrite=True) as temporary:
            temporary.write_text(render(results, page.read_text()))
    draw(results, ROOT / "docs" / "figures")


def render(results: dict, page: str) -> str:
    """The page with every block written anew. Raises `ValueError` for a marker without a block."""

    def body(name: str) -> str:
        if name not in BLOCKS:
            raise ValueError(f"the page asks for {name!r}: the blocks are {', '.join(BLOCKS)}")
        return BLOCKS[name](results)

    return filled(page, body)


def _rates(results: dict) -> list[str]:
    return [f"{rate} %" for rate in results["table2"]["rates"]]


def _mm(values: Iterable[float]) -> list[str]:
    """Two significant figures, but no decimals from 10 on."""
    return [
        f"{value:.0f}" if value >= 9.95 else f"{value:.1f}" if value >= 0.095 else f"{value:.2f}" for value in values
    ]


def _clips(results: dict, subject: str, clean: bool = False) -> list[dict]:
    rows = [row for row in results["table2"]["clips"] if row["clip"].startswith(subject)]
    return [row for row in rows if not (clean and row["glitch"])]


def _mean(rows: list[dict], method: str, measure: str = "aje") -> np.ndarray:
    return np.mean([row[measure][method] for row in rows], 0)


def _table2(results: dict, subject: str) -> str:
    rows, clean, lines = _clips(results, subject), _clips(results, subject, clean=True), []
    for preset, name in NAMES.items():
        lines += [
            [f"**{name}, printed**", *(f"**{value}**" for value in TABLE2[subject][preset])],
            [f"`{preset}`", *_mm(_mean(rows, preset))],
            ["... clips without glitches", *_mm(_mean(clean, preset))],
        ]
        if preset == "str_yang2020":
            lines += [[f"... {label}", *_mm(_mean(rows, method))] for method, label in SPANS.items()]
    lines += [[label, *_mm(_mean(rows, peer))] for peer, label in PEERS.items()]
    return table([f"subject {subject}, {len(rows)} clips ({len(clean)} without glitches)", *_rates(results)], lines)


def _entries(results: dict) -> str:
    rows = [row["entries"] for row in _clips(results, "09")]
    lines = [["**Yang 2020, printed**", *(f"**{value}**" for value in TABLE2["09"]["str_yang2020"])]]
    lines += [[f"`{preset}`", *_mm(_mean(rows, preset))] for preset in NAMES]
    lines.append([PEERS["nothing"], *_mm(_mean(rows, "nothing"))])
    return table(["subject 09, single coordinates", *_rates(results)], lines)


def _variants(results: dict) -> str:
    study = results["variants"]
    rows, count = study["clips"], len(study["rates"])
    lines = []
    for run, label in VARIANTS.items():
        line = [label, *_mm(_mean(rows, run))]
        if run in rows[0]["energy"]:
            # Energies compare only under the same origin.
            base = "preset not centred" if run in ("letter", "from data", "preset not centred") else "preset"
            ratio = np.mean([np.divide(row["energy"][run], row["energy"][base]) for row in rows], 0)
            line += [f"{x:.3f}" for x in ratio] + [f"{np.mean([row['steps'][run] for row in rows]):.0f}"]
        else:
            line += [""] * (count + 1)
        lines.append(line)
    rates = [f"{rate} %" for rate in study["rates"]]
    return table(["", *rates, *(f"energy {rate}" for rate in rates), "steps"], lines)


def _length(results: dict) -> str:
    study = results["length"]
    lines = [
        [
            f"{row['clip']}, {row['frames']} frames, λ = {row['factor']}/√T",
            *_mm(row["aje"]),
            *(f"{ratio:.3f}" for ratio in row["energy"]),
        ]
        for row in study["rows"]
    ]
    rates = [f"{rate} %" for rate in study["rates"]]
    return table(["solved at once", *rates, *(f"energy {rate}" for rate in rates)], lines)


def _worse(results: dict) -> str:
    """Counts of clips that came back worse than they went in, and of clips where a peer is better."""
    rows = results["table2"]["clips"]

    def count(method: str, other: str) -> list[str]:
        return [str(x) for x in np.sum([np.greater(r["aje"][method], r["aje"][other]) for r in rows], 0)]

    lines = [[f"`{preset}` worse than its input", *count(preset, "nothing")] for preset in NAMES]
    lines.append(["`str_yang2020` on the whole clip worse than its input", *count("whole clip", "nothing")])
    lines += [
        [f"`str_yang2020` worse than the {PEERS[f'median {n}']}", *count("str_yang2020", f"median {n}")]
        for n in (5, 15, 31)
    ]
    lines.append(["`str_yang2020` worse than the oracle spline", *count("str_yang2020", "oracle spline")])
    return table([f"of {len(rows)} clips", *_rates(results)], lines)


def _table5(results: dict) -> str:
    (row,) = (row for row in results["table2"]["clips"] if row["clip"] == "05_01")
    lines = [["**Yang 2020, printed**", *(f"**{value}**" for value in TABLE5)]]
    lines += [
        [label, *_mm(row["aje"][method])]
        for method, label in {
            "str_yang2020": "`str_yang2020`",
            **{method: f"... {label}" for method, label in SPANS.items()},
            "median 5": PEERS["median 5"],
            "nothing": PEERS["nothing"],
        }.items()
    ]
    return table(["05_01", *_rates(results)], lines)


def _table3(results: dict) -> str:
    parts = []
    for clip, printed in TABLE3.items():
        readings = {row["reading"]: row for row in results["table3"]["rows"] if row["clip"] == clip}
        lines = []
        for preset, name in NAMES.items():
            lines.append([f"**{name}, printed**", *(f"**{value / 1000:.3f}**" for value in printed[preset])])
            lines += [
                [f"`{preset}`, {label}", *(f"{x:.3f}" for x in readings[reading]["aje"][preset])]
                for reading, label in READINGS.items()
            ]
        lines += [
            [PEERS[peer], *(f"{x:.3f}" for x in readings["metres"]["aje"][peer])] for peer in ("median 5", "nothing")
        ]
        parts.append(table([clip, *_rates(results)], lines))
    return "\n\n".join(parts)


def _table6(results: dict) -> str:
    lines = []
    for row in results["table6"]:
        seconds, printed = row["seconds"], TABLE6.get(row["frames"], {})
        ratio = row["reference"] / seconds["str_yang2020"]
        lines.append(
            [
                str(row["frames"]),
                f"**{ratio:.0f}**",
                f"{row['apart_mm']:.2f}",
                *(f"{seconds[preset] / seconds['lowrank_wang2016']:.1f}" for preset in list(NAMES)[1:]),
                *(f"{seconds[preset]:.3f}" for preset in NAMES),
                f"{row['compile']['str_yang2020']:.1f}",
                f"{row['reference']:.1f}",
                f"{row['until_done']['seconds']:.2f} ({row['until_done']['steps']})",
                *(f"{printed[preset]:.1f}" for preset in NAMES),
            ]
        )
    head = [
        "frames",
        "reference / STR",
        "Li / Wang",
        "STR / Wang",
        "Wang s",
        "Li s",
        "STR s",
        "compile s",
        "reference s",
    ]
    return table([*head, "STR until done s (steps)", "printed Wang s", "printed Li s", "printed Yang s"], lines)


def _summary(results: dict) -> str:
    """The findings in sentences."""
    few = slice(0, 4)

    def listed(values) -> str:
        return ", ".join(_mm(values))

    lines = []
    for subject in TABLE2:
        rows = _clips(results, subject)
        ours, whole = _mean(rows, "str_yang2020"), _mean(rows, "whole clip")
        printed = TABLE2[subject]["str_yang2020"]
        lines.append(
            f"Subject {subject}, 5, 10, 15, 20 %: the paper prints {', '.join(map(str, printed[few]))} mm; "
            f"`str_yang2020` leaves {listed(ours[few])}, solved whole {listed(whole[few])}. At 80 % the paper prints "
            f"{printed[4]}; measured {listed([ours[4], whole[4]])}."
        )
    rows = results["table2"]["clips"]
    for method, label in (("str_yang2020", "`str_yang2020`"), ("whole clip", "The same model on the whole clip")):
        worse = [
            f"{row['clip']} at {rate} % ({row['aje']['nothing'][k]:.1f} mm in, {row['aje'][method][k]:.1f} out)"
            for row in rows
            for k, rate in enumerate(results["table2"]["rates"])
            if row["aje"][method][k] > row["aje"]["nothing"][k]
        ]
        lines.append(f"{label} returned worse than it got: {', '.join(worse) or 'no clip at any rate'}.")
    lines.append(
        f"A running median of 5 frames leaves {listed(_mean(rows, 'median 5'))} mm at 5 to 80 % over all clips, "
        f"one of 15 frames {listed(_mean(rows, 'median 15'))}, `str_yang2020` {listed(_mean(rows, 'str_yang2020'))}; "
        f"a spline that an oracle tells which samples are intact {listed(_mean(rows, 'oracle spline'))}."
    )
    speed = [row["reference"] / row["seconds"]["str_yang2020"] for row in results["table6"]]
    lines.append(
        f"The same 40 iterations are {min(speed):.0f} to {max(speed):.0f} times as fast as plain NumPy and SciPy in "
        "the same run."
    )
    return "\n".join(f"- {line}" for line in lines)


def _made_with(results: dict) -> str:
    versions = ", ".join(f"{name} {number}" for name, number in results["versions"].items())
    return f"Measured with {versions}; seed {results['seed']}."


def _readme(results: dict) -> str:
    rows = results["table2"]["clips"]
    lines = [[PEERS["nothing"], *_mm(_mean(rows, "nothing"))]]
    lines += [[f"`{preset}`", *_mm(_mean(rows, preset))] for preset in NAMES]
    lines += [[PEERS[f"median {n}"], *_mm(_mean(rows, f"median {n}"))] for n in (5, 15)]
    lines.append([PEERS["oracle spline"], *_mm(_mean(rows, "oracle spline"))])
    return table([f"{len(rows)} clips", *_rates(results)], lines)


BLOCKS = {
    "table2_05": lambda results: _table2(results, "05"),
    "table2_09": lambda results: _table2(results, "09"),
    "entries": _entries,
    "variants": _variants,
    "length": _length,
    "worse": _worse,
    "table5": _table5,
    "table3": _table3,
    "table6": _table6,
    "summary": _summary,
    "readme": _readme,
    "made_with": _made_with,
}
