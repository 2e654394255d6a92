"""The last part of docs/reproduction.md: numbers between its markers `<!-- learned: name -->` are from the results."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

from benchmarks.markdown import filled, table
from benchmarks.studies.learned_tables import BLOCK_COUNTS, COUNTS, GUIDED, NETWORKS, SUFFIXES, TABLES, Table
from motionrecover.io import write_beside
from motionrecover.refine.models import parameter_count

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reproduction.md"
ALWAYS = ("linear", "cubic", "mean pose", "robust")


def write(results: dict) -> None:
    """Renders the page in place."""
    text = render(results, PAGE.read_text(encoding="utf-8"))
    with write_beside(PAGE, overwrite=True) as temporary:
        temporary.write_text(text, encoding="utf-8")


def render(results: dict, page: str) -> str:
    """The page with every block written anew. Raises `KeyError` for a marker without a block."""

    def body(name: str) -> str:
        return BLOCKS[name](results) if name in BLOCKS else _table(results, TABLES[name])

    return filled(page, body, "learned")


def _table(results: dict, shown: Table) -> str:
    """Methods down, rows across, a line a measure; printed numbers in bold below those measured."""
    rows = results["rows"]
    measured = {row: rows.get(row, {}) for row in shown.rows}
    names = [n for n in _methods(shown) if any(n in found for found in measured.values())]
    lines = []
    for name in names:
        for k, measure in enumerate(shown.measures):
            cells = [_cell(measured[row].get(name, {}), measure) for row in shown.rows]
            lines.append(
                [_label(name) if k == 0 else "", measure, *cells, *_mean_of_rows(shown, measured, name, measure)]
            )
        if printed := _printed(shown, name):
            for k, measure in enumerate(shown.measures):
                lines.append(["**printed**" if k == 0 else "", f"**{measure}**", *printed[k]])
    missing = [n for n in shown.networks if n not in names]
    mean = ["mean"] if "mean" in (shown.printed or {}) else []
    body = table(["", "", *shown.rows, *mean], lines)
    if missing:
        body += "\n\nNot trained: " + ", ".join(_label(n) for n in missing) + "."
    return body


def _methods(shown: Table) -> list[str]:
    names = [*ALWAYS, *shown.beside]
    for n in shown.networks:
        names += [n + suffix for suffix in SUFFIXES]
    return names


def _label(name: str) -> str:
    for network, how in NETWORKS.items():
        for suffix in SUFFIXES:
            if name == network + suffix:
                return f"`{how.model}`{', identity' if how.preset == 'identity' else ''}{suffix}"
    return f"`{name}`" if name in ("robust", "str_yang2020") else name


def _cell(found: dict, measure: str) -> str:
    if measure not in found:
        return "-"
    mean, deviation = found[measure]
    text = f"{_number(mean)} ± {_number(deviation)}"
    if measure == "P" and "missing" in found and found["missing"][0] > 0:
        text += f" ({_number(found['missing'][0])})"
    return text


def _mean_of_rows(shown: Table, measured: dict, name: str, measure: str) -> list[str]:
    """Where the paper prints the mean over its rows."""
    if "mean" not in (shown.printed or {}):
        return []
    found = [measured[row][name][measure][0] for row in shown.rows if measure in measured[row].get(name, {})]
    return [_number(sum(found) / len(found)) if len(found) == len(shown.rows) else "-"]


def _printed(shown: Table, name: str) -> list[list[str]]:
    numbers = shown.printed or {}
    if not any(name in found for found in numbers.values()):
        return []
    rows = [*shown.rows, *(["mean"] if "mean" in numbers else [])]
    return [
        [f"**{_number(numbers[row][name][k])}**" if name in numbers.get(row, {}) else "" for row in rows]
        for k in range(len(shown.measures))
    ]


def _number(value: float) -> str:
    return (
        f"{value:.0f}"
        if value >= 100
        else f"{value:.1f}"
        if value >= 9.95
        else f"{value:.2f}"
        if value >= 0.0995
        else f"{value:.3f}"
    )


def _counts(results: dict) -> str:
    lines = [
        [f"`{model}`", f"{parameter_count(model):,}", f"**{printed},000**"]
        for model, printed in (COUNTS | BLOCK_COUNTS).items()
    ]
    return table(["", "numbers learnt", "printed"], [[a, b, c.replace(",000", "k")] for a, b, c in lines])


def _bar(results: dict) -> str:
    """The networks of the recipe against the mean pose."""
    lines = []
    for row in (*TABLES["choi2"].rows, *TABLES["choi3"].rows):
        found = results["rows"].get(row, {})
        cells = [
            _cell(found.get(name, {}), "P")
            for name in ("mean pose", "bra", "bra, kept", "bra-dgn", "bra-dgn, kept", "robust")
        ]
        lines.append([row, *cells])
    return table(["P", "mean pose", "`bra`", "`bra`, kept", "`bra-dgn`", "`bra-dgn`, kept", "`robust`"], lines)


def _guided(results: dict) -> str:
    """The published model with and without a network as guide."""
    ((network, rows),) = GUIDED.items()
    names = ("robust", "str_yang2020", *(network + suffix for suffix in SUFFIXES))
    lines = [[row, *(_cell(results["rows"].get(row, {}).get(name, {}), "P") for name in names)] for row in rows]
    return table(["P", *(_label(name) for name in names)], lines)


def _trends(results: dict) -> str:
    """What holds and what does not, in sentences, of the rows that are measured."""
    choi2, choi3 = TABLES["choi2"].rows, TABLES["choi3"].rows
    iid, throughout, li3 = choi2[:4], choi2[4:], TABLES["li3"]

    def wins(name: str, other: str, rows, measure: str = "P") -> str:
        """On how many rows `name` has the smaller measure, and the larger, by more than the deviation of either."""
        both = [results["rows"].get(row, {}) for row in rows]
        both = [(found[name][measure], found[other][measure]) for found in both if name in found and other in found]
        better = sum(p + max(s, t) < q for (p, s), (q, t) in both)
        worse = sum(q + max(s, t) < p for (p, s), (q, t) in both)
        names = " against ".join(dict.fromkeys((_label(name), _label(other))))
        return f"{names}: better on {better}, worse on {worse} of {len(both)} rows" if both else ""

    def said(title: str, *found: str) -> str:
        found = tuple(each for each in found if each)
        return f"- {title}: {'; '.join(found)}." if found else ""

    pairs = [
        (f"{graph} {kind}", f"{linear} {kind}", rows)
        for kind, rows in (("40", choi2), ("20+3", choi3))
        for graph, linear in (("bra-dgn", "bra"), ("ebd-dgn", "ebd"))
    ]
    constrained = [
        (f"{model} {kind}", f"{free} {kind}", rows)
        for kind, rows in (("40", choi2), ("20+3", choi3))
        for model, free in (("bra", "ebd"), ("bra-dgn", "ebd-dgn"))
    ]
    first, last = (results["rows"].get(row, {}) for row in (iid[0], iid[-1]))
    rising = [
        f"{_label(n)} {_number(first[n]['P'][0])} and {_number(last[n]['P'][0])}"
        for n in TABLES["choi2"].networks
        if n in first and n in last
    ]
    lines = [
        said(
            "Graph blocks in place of linear layers (Choi: better on nearly every row)",
            *(wins(*pair) for pair in [*pairs, ("bra-dgn", "bra", (*choi2, *choi3))]),
        ),
        said(
            "Losses on bones and smoothness (Choi: better on nearly every row)", *(wins(*pair) for pair in constrained)
        ),
        said("Trained at 40 % missing, more errors at 10 % than at 40 % (Choi: all five networks); P at both", *rising),
        said(
            "Headings kept, against removed (Choi: worse, but for `cnn` at 10 %)",
            *(wins(*pair, iid) for pair in zip(TABLES["choi4"].networks, TABLES["choi2"].networks, strict=False)),
        ),
        said(
            "Blocks of the graph, against three (Choi: two and three alike, four and five worse)",
            *(wins(f"{n} blocks", "3 blocks", TABLES["choi5"].rows) for n in (2, 4, 5)),
        ),
        *(
            said(
                f"BRA-P's {measure} at another sensor (Li: the least)",
                *(wins("bra-p sensor", n, li3.rows, measure) for n in li3.networks[:-1]),
            )
            for measure in ("B", "S")
        ),
        said(
            "Against what knows no training, on samples missing at random",
            *(wins(n, "linear", iid) for n in TABLES["choi2"].networks),
        ),
        said(
            "The networks that start as the identity against the mean pose",
            *(
                wins(n + suffix, "mean pose", rows)
                for n in ("bra", "bra-dgn")
                for suffix, rows in (("", (*choi2, *choi3)), (", kept", choi2))
            ),
        ),
        said(
            "A network as guide of the published model",
            *(
                wins("bra-dgn guides STR", other, GUIDED["bra-dgn"])
                for other in ("str_yang2020", "bra-dgn", "bra-dgn, kept", "bra-dgn and STR in turns", "robust")
            ),
        ),
        said(
            "The default preset, on all rows",
            *(wins("robust", n, (*choi2, *choi3)) for n in ("mean pose", "bra", "bra-dgn")),
            *(wins("robust", f"{n}, kept", throughout) for n in ("bra", "bra-dgn")),
        ),
    ]
    return "\n".join(line for line in lines if line)


def _made_with(results: dict) -> str:
    steps = ", ".join(f"{name} {count:,}" for name, count in results["steps"].items())
    return f"Clips {', '.join(results['clips'])}; {results['seeds']} seeds. Steps trained: {steps or 'none'}."


BLOCKS = {"counts": _counts, "bar": _bar, "guided": _guided, "made_with": _made_with, "trends": _trends}


def steps_of(run: Path) -> int:
    """That a run has done."""
    with (run / "log.csv").open(newline="", encoding="utf-8") as file:
        done = [int(line["step"]) for line in csv.DictReader(file) if line["held_out_mm"]]
    return done[-1] if done else 0


def dumps(results: dict) -> str:
    """JSON with a list a line."""
    return re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), json.dumps(results, indent=1)) + "\n"
