"""The metrics of an image front end as a report shows them: key numbers and compact tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import pandas as pd

from reports.display import Card, Cell, interval_text, number
from reports.front_end import AGES, AXES, INLIER_NAME, LAGS

_KINDS = {
    "stereo": "stereo: right where it belongs in the left image, elsewhere in the right one",
    "temporal": "temporal: leapt to another place, or left the target",
    "drift": "drift: slid over the body",
    "segmentation": "segmentation: not on the target in most of its frames",
    "all": "all",
}
_BIAS_PX = 0.02  # half of what three sigma of 0.2 px come to over 200 tracks
Key = tuple[str, str, str, str, str]


@dataclass(frozen=True)
class FrontEndSection:
    """Key numbers, and tables of (heading of the first column, headings, rows of a name and its cells)."""

    cards: tuple[Card, ...]
    tables: tuple[tuple[str, tuple[str, ...], tuple[tuple[str, tuple[Cell, ...]], ...]], ...]


def front_end_section(metrics: pd.DataFrame) -> FrontEndSection:
    """What metrics.csv says of the front end."""
    found = {(r["quantity"], r["axis"], r["statistic"], r["entity"], r["bin"]): r for _, r in metrics.iterrows()}
    tables = [
        ("axis", ("σ [px]", "stated σ [px]", "measured / stated"), tuple(_noise(found))),
        ("frames apart", ("correlation, left u, v", "correlation, disparity"), tuple(_correlation(found))),
        ("age [frames]", ("change since the first frame, RMS per coordinate [px]",), tuple(_drift(found))),
        ("label", ("share of the tracked points",), tuple(_outliers(found))),
    ]
    return FrontEndSection(tuple(_cards(found)), tuple(table for table in tables if table[2]))


def _cell(row: pd.Series | None, scale: float = 1.0) -> Cell:
    if row is None:
        return Cell("–")
    return Cell(number(scale * row["value"]), interval_text(row))


def _noise(found: Mapping[Key, pd.Series]) -> Iterator[tuple[str, tuple[Cell, ...]]]:
    for axis in AXES:
        sigma, factor = (found.get(("pixel", axis, s, "", "")) for s in ("std", "factor"))
        if sigma is not None and factor is not None:
            stated = Cell(number(sigma["value"] / factor["value"]))
            yield axis.replace("_", " "), (_cell(sigma), stated, _cell(factor))


def _correlation(found: Mapping[Key, pd.Series]) -> Iterator[tuple[str, tuple[Cell, ...]]]:
    for lag in LAGS:
        rows = [found.get(("pixel", axis, "correlation", "", f"lag {lag}")) for axis in ("left", "disparity")]
        if rows[0] is not None:
            yield str(lag), tuple(_cell(row) for row in rows)


def _drift(found: Mapping[Key, pd.Series]) -> Iterator[tuple[str, tuple[Cell, ...]]]:
    for age in AGES:
        row = found.get(("pixel", "left", "drift", "", f"age {age}"))
        if row is not None:
            yield str(age), (_cell(row),)


def _outliers(found: Mapping[Key, pd.Series]) -> Iterator[tuple[str, tuple[Cell, ...]]]:
    for kind, name in _KINDS.items():
        row = found.get(("outlier", "all", "fraction", kind, ""))
        if row is not None:
            ends = [f"{100 * row[end]:.1f}" for end in ("ci_low", "ci_high") if math.isfinite(row[end])]
            yield name, (Cell(f"{100 * row['value']:.1f} %", " … ".join(ends)),)


def _cards(found: Mapping[Key, pd.Series]) -> Iterator[Card]:
    mean, least = (found.get(("track", "all", s, INLIER_NAME, "")) for s in ("mean", "min"))
    if mean is not None and least is not None:
        yield Card("Good tracks in a frame", f"{mean['value']:.0f}", f"at least {least['value']:.0f}")
    life = found.get(("track", "life", "mean", "", ""))
    if life is not None:
        yield Card("Life of a track", f"{life['value']:.1f} frames", f"{life['n']} tracks")
    wrong = found.get(("outlier", "all", "fraction", "all", ""))
    if wrong is not None:
        yield Card("Outliers", f"{100 * wrong['value']:.1f} %", "of the tracked points")
    bias = found.get(("pixel", "disparity", "bias", "", ""))
    if bias is not None:
        good = bool(abs(bias["value"]) < _BIAS_PX)
        yield Card("Disparity bias", f"{number(bias['value'])} px", f"95 %: {interval_text(bias)}", good)
    yield from _honesty(found)
    time = found.get(("runtime", "all", "mean", "track, per frame", ""))
    if time is not None:
        yield Card("Time per frame", f"{time['value']:.0f} ms", "reading the images included")


def _honesty(found: Mapping[Key, pd.Series]) -> Iterator[Card]:
    """Whether the stated covariance is what was measured, or by what factor it is not."""
    row, factor = found.get(("pixel", "all", "nees", "", "")), found.get(("pixel", "all", "factor", "", ""))
    if row is None or factor is None:
        return
    low, high = (float(x) for x in str(row["reference"]).split(".."))
    good = low <= row["value"] <= high
    verdict = "inside" if good else f"stated σ off by {number(factor['value'])};"
    yield Card("Pixel NEES", number(row["value"]), f"{verdict} 95 % band {number(low)} … {number(high)}", good)
    median = found.get(("pixel", "all", "median_factor", "", ""))
    if median is not None:
        yield Card("Stated σ off by", number(median["value"]), "for the median point")
