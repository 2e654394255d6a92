"""The table of results as text, a block a row."""

from __future__ import annotations

from benchmarks.suite.measure import UNITS


def render(results: dict) -> str:
    """All rows: mean scores, the standard error of the headline, seconds a clip, and failures with their reasons."""
    return "\n\n".join(_block(name, row, results["ours"]) for name, row in results["rows"].items())


def _block(name: str, row: dict, ours: list[str]) -> str:
    headline = row["headline"]
    note = f", {row['too_short']} too short" if row["too_short"] else ""
    lines = [f"{name} ({len(row['clips'])} clips{note}; mm, sorted by the error over {headline} samples)"]
    lines.append(
        f"  {'':22}{''.join(f'{score:>13}' for score in UNITS)}{'+-':>8}{'seconds':>9}{'runs':>6}{'failed':>8}"
    )
    entries = row["methods"].items()
    for method, summary in sorted(entries, key=lambda entry: _order(entry[1]["scores"][headline]["mean"])):
        scores = "".join(f"{_number(summary['scores'][score]['mean']):>13}" for score in UNITS)
        spread, seconds = _number(summary["scores"][headline]["error"]), _number(summary["seconds"])
        mark = "*" if method in ours else " "
        lines.append(
            f"{mark} {method:22}{scores}{spread:>8}{seconds:>9}{summary['runs']:>6}{summary['failures'] or '':>8}"
        )
        lines += [f"    {count} x {reason}" for reason, count in summary["reasons"].items()]
    return "\n".join(lines)


def _order(value: float | None) -> float:
    return float("inf") if value is None else value


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
