"""Boresight from control points in three ways: tables over the conditions, beside Fig. 3.7 and Table 3.1."""

from __future__ import annotations

import pandas as pd

from reports.consistency import band
from reports.studies import StudyResult

ANGLES = ("omega", "phi", "kappa")
LETTERS = {"omega": "ω", "phi": "φ", "kappa": "κ"}
PER_IMAGE, ADJUSTED, NO_POSES = "per image", "one adjustment", "without own poses"
SOURCE_SCATTER_DEG = (0.05, 0.12)
SOURCE_PX = (5.0, 6.0)
PIXEL_M = 0.2
"""On the ground, from 500 m: "5-6 Pixel ... 1,0 bis 1,2 Meter"."""
GOAL_DEG = {"omega": 0.006, "phi": 0.006, "kappa": 0.02}
"""What this bench asks of a calibration in clean conditions."""
NAVIGATION = {"independent": "errors new in every image", "pos_av_410": "errors mostly constant"}
_LEVEL = 0.95


def pooled(result: StudyResult, case: str, column: str = "value") -> pd.DataFrame:
    """Measures of one case over the runs, a row per point: settings of the point, then a column per quantity."""
    m = result.metrics
    rows = m[(m["estimator"] == case) & (m["bin"] == "0")]
    values = rows.pivot_table(index="point", columns="quantity", values=column, observed=True, dropna=False)
    return result.points.join(values.rename(columns=str))


def nees_band(result: StudyResult) -> tuple[float, float]:
    """95 % band of the mean NEES of three angles over the runs."""
    return band(len(ANGLES), result.runs, _LEVEL)


def conditions(result: StudyResult) -> pd.Series:
    """What every point's calibration was flown with, in words."""
    return result.points.apply(_condition, axis=1)


def _condition(point: pd.Series) -> str:
    vibration = f", vibration {point['vibration_deg']:g}°" if point["vibration_deg"] else ""
    return f"{NAVIGATION[point['navigation']]}, GNSS {100 * point['position_m']:g} cm{vibration}"


def as_source(result: StudyResult) -> str:
    """The point with the greatest vibration and GNSS error, by which the source's residuals are explained."""
    return str(result.points.sort_values(["vibration_deg", "position_m"]).index[-1])


def ways_table(result: StudyResult) -> pd.DataFrame:
    """Every condition and way: true and stated errors of the angles, NEES, residual, scatter of single images."""
    low, high = nees_band(result)
    rows = []
    ways = {case: pooled(result, case) for case in result.estimators}
    for point, flown in conditions(result).items():
        for case, table in ways.items():
            v = table.T[str(point)]
            row: dict[str, object] = {"conditions": flown, "way": case}
            row |= {f"{LETTERS[a]}, RMS [°]": v[f"boresight_{a}"] for a in ANGLES}
            row |= {f"{LETTERS[a]}, stated [°]": v[f"boresight_sigma_{a}"] for a in ANGLES}
            row |= {"NEES": v["boresight_nees"], "NEES band": f"{low:.2f} … {high:.2f}"}
            row |= {"residual [px]": v["boresight_px"]}
            row |= {f"scatter of {LETTERS[a]} [°]": v.get(f"boresight_scatter_{a}") for a in ANGLES}
            rows.append(row | {"failed [%]": 100 * v["boresight_failed"]})
    return pd.DataFrame(rows)
