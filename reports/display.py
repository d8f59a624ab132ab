"""metrics.csv as people read it: key numbers and compact tables, degrees for radians, three digits."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from reports.errors import SMOOTHED

QUANTITIES = {
    "position": "Position of the points' centroid",
    "orientation": "Orientation",
    "velocity": "Velocity of the reference point",
    "speed": "Speed",
    "yaw_rate": "Yaw rate",
    "angular_rate": "Angular rate",
    "reference_point": "Position of the reference point",
    "centroid_speed": "Speed of the points' centroid, as the estimator says",
    "driving_direction": "Driving direction, as the estimator says",
    "centroid_speed_across": "Speed of the points' centroid, from window to window",
    "driving_direction_across": "Driving direction, from window to window",
    "yaw_rate_across": "Yaw rate, from window to window",
    "shape": "Shape after alignment",
}
STATISTICS = ("rms", "crb", "efficiency", "bias", "std", "p95", "max")
HEADINGS = ("RMS", "bound", "efficiency", "bias", "std", "95 %", "max")
_WITH_INTERVAL = ("rms", "efficiency", "bias")
_SHOWN = {"rad": ("°", math.degrees(1)), "rad/s": ("°/s", math.degrees(1)), "1": ("", 1.0)}
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Card:
    """One key number: what it is, its value with unit, a remark, and whether it is good, where that is known."""

    title: str
    value: str
    remark: str = ""
    good: bool | None = None


@dataclass(frozen=True)
class Cell:
    value: str
    interval: str = ""


@dataclass(frozen=True)
class Group:
    """Rows of one quantity: heading with unit, and per axis the cells of `STATISTICS`."""

    heading: str
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


def unit_of(unit: str) -> str:
    return _SHOWN.get(unit, (unit, 1.0))[0]


def number(value: float, unit: str = "1") -> str:
    """Three significant digits with a typographic minus; a dash where there is no number."""
    value = value * _SHOWN.get(unit, (unit, 1.0))[1]
    if not math.isfinite(value):
        return "–"
    exponent = math.floor(math.log10(abs(value))) if value else 0
    if exponent < -4 or exponent > 5:
        mantissa = f"{value / 10.0**exponent:.1f}".replace("-", "−")
        return f"{mantissa}·10{str(exponent).translate(SUPERSCRIPT)}"
    return f"{value:.{max(0, 2 - exponent)}f}".replace("-", "−")


def _with_unit(row: pd.Series) -> str:
    return f"{number(row['value'], row['unit'])} {unit_of(row['unit'])}".strip()


def interval_text(row: pd.Series) -> str:
    """A metric's interval; empty where there is none."""
    if not (math.isfinite(row["ci_low"]) and math.isfinite(row["ci_high"])):
        return ""
    return f"{number(row['ci_low'], row['unit'])} … {number(row['ci_high'], row['unit'])}"


def _index(metrics: pd.DataFrame, estimator: str, bins: bool = False) -> dict[tuple[str, str, str, str], pd.Series]:
    """Rows of one estimator by (quantity, axis, statistic, bin), online trajectory only."""
    rows = metrics[(metrics["estimator"] == estimator) & (metrics["entity"] != SMOOTHED)]
    rows = rows[(rows["bin"] != "") == bins]
    rows = rows[rows["quantity"] != "failure"]
    return {(r["quantity"], r["axis"], r["statistic"], r["bin"]): r for _, r in rows.iterrows()}


def cards(metrics: pd.DataFrame, estimator: str) -> list[Card]:
    """The key numbers of one estimator."""
    found = _index(metrics, estimator)
    return [*_accuracy_cards(found), *_nees_cards(found), *_outlier_cards(found), *_support_cards(found)]


def _accuracy_cards(found: Mapping[tuple[str, str, str, str], pd.Series]) -> Iterator[Card]:
    for quantity, axis, title in (("position", "z", "Depth, RMS"), ("velocity", "all", "Velocity, RMS")):
        rms, bound = (found.get((quantity, axis, s, "")) for s in ("rms", "crb"))
        if rms is None:
            continue
        remark = "" if bound is None else f"bound {_with_unit(bound)}"
        yield Card(title, _with_unit(rms), remark)
        efficiency = found.get((quantity, axis, "efficiency", ""))
        if efficiency is not None:
            interval = interval_text(efficiency)
            remark = f"95 %: {interval}" if interval else "bound / RMS"
            yield Card(f"{title.split(',')[0]}, efficiency", number(efficiency["value"]), remark)


def _nees_cards(found: Mapping[tuple[str, str, str, str], pd.Series]) -> Iterator[Card]:
    for quantity, title in (("pose", "Pose NEES"), ("velocity", "Velocity NEES")):
        row = found.get((quantity, "all", "nees", ""))
        if row is not None:
            low, high = (float(x) for x in str(row["reference"]).split(".."))
            remark = f"band {number(low)} … {number(high)}, {row['n']} windows"
            yield Card(title, number(row["value"]), remark, low <= row["value"] <= high)


def _outlier_cards(found: Mapping[tuple[str, str, str, str], pd.Series]) -> Iterator[Card]:
    """Mean numbers of tracks in a window."""
    rows = {s: found.get(("outlier", "all", s, "")) for s in ("tp", "fn", "fp", "flagged")}
    if any(row is None for row in rows.values()):
        return
    found_, missed, wrong, flagged = (f"{row['value']:.1f}" for row in rows.values() if row is not None)
    yield Card("Outliers found", found_, f"{missed} missed, tracks per window")
    yield Card("Good tracks rejected", wrong, "per window")
    if float(flagged):
        yield Card("Second body flagged", flagged, "rejected tracks per window")


def _support_cards(found: Mapping[tuple[str, str, str, str], pd.Series]) -> Iterator[Card]:
    share = found.get(("trajectory", "all", "converged", ""))
    if share is not None:
        yield Card("Frames estimated", f"{100 * share['value']:.0f} %", f"of {share['n']} with 30 visible points")
    failed = found.get(("trajectory", "all", "failed", ""))
    if failed is not None:
        yield Card("Windows failed", f"{failed['value']:.0f}", f"of {failed['n']}", bool(failed["value"] == 0))
    runtime = found.get(("runtime", "all", "median", ""))
    if runtime is not None:
        yield Card("Run time", _with_unit(runtime), "")


def error_groups(metrics: pd.DataFrame, estimator: str) -> list[Group]:
    """Tables of one estimator's errors, a group per quantity, a row per axis."""
    found = _index(metrics, estimator)
    groups = []
    for quantity, title in QUANTITIES.items():
        axes = [a for a in ("x", "y", "z", "all") if (quantity, a, "rms", "") in found]
        if not axes:
            continue
        first = found[quantity, axes[-1], "rms", ""]
        reference = f", {first['reference']}" if first["reference"] else ""
        rows = tuple((a, tuple(_cell(found.get((quantity, a, s, ""))) for s in STATISTICS)) for a in axes)
        groups.append(Group(f"{title}{reference} [{unit_of(first['unit'])}]", rows))
    return groups


def _cell(row: pd.Series | None) -> Cell:
    if row is None:
        return Cell("–")
    return Cell(number(row["value"], row["unit"]), interval_text(row) if row["statistic"] in _WITH_INTERVAL else "")


def depth_bins(metrics: pd.DataFrame, estimators: list[str]) -> list[tuple[str, list[list[str]]]]:
    """Rows (bin, per estimator [bias, rms, bound, efficiency] of the depth), nearest bin first."""
    found = {e: _index(metrics, e, bins=True) for e in estimators}
    bins = sorted({key[3] for index in found.values() for key in index}, key=lambda b: float(b.split("-")[0]))
    return [
        (
            name,
            [
                [_cell(found[e].get(("position", "z", s, name))).value for s in ("bias", "rms", "crb", "efficiency")]
                for e in estimators
            ],
        )
        for name in bins
    ]


def failures(metrics: pd.DataFrame, estimator: str) -> list[tuple[str, int]]:
    """Reasons of failed windows and how often each occurred."""
    rows = metrics[(metrics["estimator"] == estimator) & (metrics["quantity"] == "failure")]
    return [(str(r["entity"]), int(r["value"])) for _, r in rows.iterrows()]


def settings(value: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """A resolved scenario as ``key.path`` and value, the way ``--set`` takes them; what is not set stays away."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from settings(inner, f"{prefix}.{key}" if prefix else str(key))
    elif isinstance(value, list) and any(isinstance(v, (Mapping, list)) for v in value):
        for i, inner in enumerate(value):
            yield from settings(inner, f"{prefix}.{i}")
    elif value is not None:
        yield prefix, json.dumps(value, ensure_ascii=False)
