"""The committed baseline: named metrics of our methods, each with unit, direction and tolerance."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.suite.measure import UNITS

SETTINGS = ("clips", "seeds")
"""Runs that differ in one of these are on other data and cannot be compared."""
RELATIVE = 0.03
"""Share of its baseline by which an error may grow: float32 differs between machines."""
ABSOLUTE = 0.05
"""What an error may grow by besides, in mm, or in the unit of the ratio."""
SLOWER = 1.0
"""Share by which the seconds may grow: machines differ."""


def of(results: dict) -> dict:
    """The baseline that these results make."""
    return {
        "settings": {name: results["settings"][name] for name in SETTINGS},
        "metrics": {
            name: {
                "value": value,
                "unit": unit,
                "direction": "closer to 1" if name.endswith("acceleration") else "lower",
                "tolerance": _tolerance(name, value),
            }
            for name, (value, unit) in measured(results).items()
        },
    }


def measured(results: dict) -> dict[str, tuple[float, str]]:
    """Value and unit of each metric, `row: method: score`, of our methods."""
    found = {}
    for row, entry in results["rows"].items():
        for method in results["ours"]:
            if (summary := entry["methods"].get(method)) is None:
                continue
            name = f"{row}: {method}"
            found[f"{name}: failures"] = (summary["failures"], "runs")
            if summary["seconds"] is not None:
                found[f"{name}: seconds"] = (summary["seconds"], "s")
            for score, unit in UNITS.items():
                if (value := summary["scores"][score]["mean"]) is not None:
                    found[f"{name}: {score}"] = (value, unit)
    return found


def regressions(results: dict, baseline: dict) -> list[str]:
    """A sentence for each metric that is worse than the baseline allows, or gone from a row and method that ran.

    Raises `ValueError` where the settings differ.
    """
    asked = {name: results["settings"][name] for name in SETTINGS}
    if asked != baseline["settings"]:
        raise ValueError(f"received results with {asked}: the baseline has {baseline['settings']}, run those")
    found, worse = measured(results), []
    for name, metric in baseline["metrics"].items():
        row, method, _ = name.split(": ")
        if method not in results["rows"].get(row, {"methods": {}})["methods"]:
            continue
        if name not in found:
            worse.append(f"{name} was {metric['value']} {metric['unit']} and has no value now")
            continue
        value = found[name][0]
        if _loss(value, metric["direction"]) > _loss(metric["value"], metric["direction"]) + metric["tolerance"]:
            worse.append(f"{name} is {value} {metric['unit']}, was {metric['value']} +- {metric['tolerance']:.3g}")
    return worse


def compared(results: dict, baseline: dict) -> int:
    """How many metrics of the baseline the results have."""
    return len(baseline["metrics"].keys() & measured(results).keys())


def _loss(value: float, direction: str) -> float:
    losses = {"lower": value, "higher": -value, "closer to 1": abs(value - 1)}
    return losses[direction]


def _tolerance(name: str, value: float) -> float:
    if name.endswith("failures"):
        return 0
    share = SLOWER if name.endswith("seconds") else RELATIVE
    return round(share * value + ABSOLUTE, 4)


def sentences(worse: Sequence[str]) -> str:
    """The report of a check."""
    return "\n".join(f"worse: {sentence}" for sentence in worse) if worse else "nothing is worse than the baseline"
