"""Tables and figures of a replay battery, as study files name them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import pandas as pd
from matplotlib.figure import Figure

from reports.figures.battery import battery_figure
from reports.replay_battery import MEASURED, Battery, Group, battery, groups
from reports.studies import StudyResult

By = Literal["distance", "occlusion", "manoeuvre"]


def replay_battery(result: StudyResult, *, by: tuple[By, ...] = ("distance", "occlusion", "manoeuvre")) -> pd.DataFrame:
    """Median and 95 % of the absolute errors of all cars, by distance, by the label's occlusion, by manoeuvre."""
    found = battery(result)
    rows = []
    for kind in ("all", *by):
        for g in groups(found, kind):
            rows.append({"frames of": kind, "which": "" if kind == "all" else g.value, "cars": g.cars} | _columns(g))
    return pd.DataFrame(rows)


def replay_cars(result: StudyResult) -> pd.DataFrame:
    """The same of every car, with what it does."""
    found = battery(result)
    return pd.DataFrame([_car(found, g) | _columns(g) for g in groups(found, "point")])


def _car(b: Battery, g: Group) -> dict[str, Any]:
    frames = b.frames[b.frames["point"] == g.value]
    hidden = frames["occlusion"].isin(frames["occlusion"].cat.categories[1:])
    row: dict[str, Any] = {str(k): v for k, v in b.cars.loc[g.value].items()}
    row["from-to [m]"] = f"{frames['distance_m'].iloc[0]:.0f}-{frames['distance_m'].iloc[-1]:.0f}"
    row["mostly"] = frames["manoeuvre"].mode().iloc[0]
    row["occluded [%]"] = round(100 * float(hidden.mean()))
    return row


def _columns(g: Group) -> dict[str, Any]:
    row: dict[str, Any] = {"estimator": g.estimator, "frames": g.frames, "estimated [%]": round(100 * g.estimated)}
    row["windows failed"] = f"{g.failed} of {g.windows}"
    row["outliers [%]"] = 100 * g.outliers
    row["median distance [m]"] = g.distance_m
    for name, measured in MEASURED.items():
        row[measured.label] = g.errors[name].median
        row[f"95 % {measured.label}"] = g.errors[name].p95
    return row


def replay_errors(result: StudyResult, *, by: By = "distance") -> Figure:
    """Median errors with their 95 % intervals over cars, and how many frames, estimates and outliers there are."""
    return battery_figure(list(groups(battery(result), by)), by)


TABLES: dict[str, Callable[..., pd.DataFrame]] = {"replay_battery": replay_battery, "replay_cars": replay_cars}
FIGURES: dict[str, Callable[..., Figure]] = {"replay_errors": replay_errors}
