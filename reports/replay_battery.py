"""How well the cars of a label file are estimated, by distance, occlusion and manoeuvre: a study with a point per car.

Errors are those of the newest frame of every window, of all runs. Windows of one car share points and frames, so
intervals draw whole cars.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from reports.bootstrap import REPLICATES
from reports.errors import SMOOTHED
from reports.manoeuvres import MANOEUVRES, replayed
from reports.studies import StudyResult
from sim.streams import stream

Array = np.ndarray
OCCLUSIONS = {0: "0 visible", 1: "1 partly", 2: "2 largely", 3: "3 unknown", -1: "not labelled"}
_DISTANCES_M = (0, 10, 20, 30, 40, 50, 60, 80, 1000)
_LEAST_CARS = 3  # fewer drawn again and again say nothing of others
_KEYS = ["point", "estimator", "run", "frame"]


@dataclass(frozen=True)
class Measured:
    """A column of errors in a battery: what it is, its unit, and the factor to it from the error table's."""

    title: str
    unit: str
    factor: float = 1.0

    @property
    def label(self) -> str:
        return f"{self.title} [{self.unit}]"


MEASURED = {
    "along": Measured("position along", "m"),
    "across": Measured("position across", "m"),
    "speed": Measured("speed", "m/s"),
    "yaw_rate": Measured("yaw rate", "deg/s", 180 / np.pi),
}


@dataclass(frozen=True, eq=False)
class Battery:
    """Cars (by point: track, type), their frames, and the windows that end in them.

    frames: a row per point and frame; windows: a row per point, estimator, run and frame with an estimate: the errors
    of `MEASURED` (along and, horizontally, across the line of sight, to the right), tracks and wrong ones among them;
    failed: a row per window without an estimate. All have the columns distance, occlusion and manoeuvre, categories.
    """

    cars: pd.DataFrame
    frames: pd.DataFrame
    windows: pd.DataFrame
    failed: pd.DataFrame
    runs: int
    estimators: tuple[str, ...]


def battery(result: StudyResult) -> Battery:
    """The battery of a study whose points replay one car each.

    Raises
        ValueError: a point replays no label.
    """
    found = {str(point): replayed(result.scenarios[str(point)]) for point in result.points.index}
    cars = pd.DataFrame(
        [(s["track"], label.kind) for s, (label, _) in ((_motion(result, p), f) for p, f in found.items())],
        columns=["track", "type"],
        index=list(found),
    )
    frames = pd.concat([f.assign(point=p) for p, (_, f) in found.items()], ignore_index=True)
    frames = _classified(frames)
    rates = {p: result.scenarios[p]["rig"]["rate_hz"] for p in found}
    windows = _errors(_framed(result.comparison[result.comparison["entity"] != SMOOTHED], rates))
    outliers = _framed(result.outliers, rates).assign(wrong=lambda o: o["tp"] + o["fn"])
    windows = windows.merge(outliers[[*_KEYS, "tracks", "wrong"]], on=_KEYS, how="left")
    failed = _framed(result.failures[result.failures["kind"] == "window"], rates)[_KEYS]
    where = frames.drop(columns="t_s")
    windows, failed = (table.merge(where, on=["point", "frame"]) for table in (windows, failed))
    return Battery(cars, frames, windows, failed, result.runs, result.estimators)


def _motion(result: StudyResult, point: str) -> dict[str, Any]:
    return next(v["motion"] for v in result.scenarios[point]["vehicle"] if v["motion"]["kind"] == "labels")


def _classified(frames: pd.DataFrame) -> pd.DataFrame:
    """Frames with distance, occlusion and manoeuvre as ordered categories, each with those that occur."""
    names = [f"{a}-{b} m" if b < 1000 else f"> {a} m" for a, b in pairwise(_DISTANCES_M)]
    distance = pd.cut(frames["distance_m"].clip(lower=0), _DISTANCES_M, right=False, labels=names)
    occlusion = pd.Categorical(frames["occlusion"].map(OCCLUSIONS), list(OCCLUSIONS.values()), ordered=True)
    manoeuvre = pd.Categorical(frames["manoeuvre"], MANOEUVRES, ordered=True)
    return frames.assign(distance=distance, occlusion=occlusion, manoeuvre=manoeuvre)


def _framed(table: pd.DataFrame, rates: dict[str, float]) -> pd.DataFrame:
    """A table of the study with plain keys, and the number of the frame in place of its time."""
    point = table["point"].astype(str)
    frame = np.rint(table["t_s"].to_numpy(float) * point.map(rates).to_numpy(float)).astype(int)
    return table.assign(point=point, estimator=table["estimator"].astype(str), frame=frame)


def _errors(rows: pd.DataFrame) -> pd.DataFrame:
    """One row per window with the errors of `MEASURED`."""
    name = rows["quantity"].astype(str) + " " + rows["axis"].astype(str)
    wide = rows.assign(name=name).pivot_table(index=_KEYS, columns="name", values=["error", "truth"], observed=True)
    if wide.empty:
        return pd.DataFrame(columns=[*_KEYS, *MEASURED]).astype({"run": int, "frame": int})
    e, p = (wide[kind][[f"position {a}" for a in "xyz"]].to_numpy(float) for kind in ("error", "truth"))
    columns = {
        "along": np.einsum("ni,ni->n", e, p) / np.linalg.norm(p, axis=1),
        "across": (e[:, 0] * p[:, 2] - e[:, 2] * p[:, 0]) / np.hypot(p[:, 0], p[:, 2]),
        "speed": wide["error"]["speed all"].to_numpy(float),
        "yaw_rate": wide["error"]["yaw_rate all"].to_numpy(float),
    }
    return pd.DataFrame({k: MEASURED[k].factor * v for k, v in columns.items()}, index=wide.index).reset_index()


@dataclass(frozen=True)
class Group:
    """Some frames of a battery with one estimator: cars and frames there are, shares of frames with an estimate and of
    outliers among the tracks; windows tried, and those that failed; median distance of the frames."""

    by: str
    value: str
    estimator: str
    cars: int
    frames: int
    estimated: float
    windows: int
    failed: int
    outliers: float
    distance_m: float
    errors: dict[str, Spread]


@dataclass(frozen=True)
class Spread:
    """Of absolute errors: median, its 95 % interval over cars (NaN for fewer than three), and their 95 % quantile."""

    median: float
    low: float
    high: float
    p95: float


def spread(errors: Float[Array, "n"], car: Array) -> Spread:
    """Spread of the absolute values of errors, each of a car."""
    known = np.isfinite(errors)
    values, which = np.abs(errors[known]), np.unique(car[known], return_inverse=True)[1]
    if not len(values):
        return Spread(np.nan, np.nan, np.nan, np.nan)
    low, high = _median_interval(values, which)
    return Spread(float(np.median(values)), low, high, float(np.quantile(values, 0.95)))


def _median_interval(values: Float[Array, "n"], which: Array) -> tuple[float, float]:
    """Bootstrap interval of the median: cars are drawn, each with all its values."""
    cars = int(which.max()) + 1
    if cars < _LEAST_CARS:
        return np.nan, np.nan
    drawn = stream(0, 0, "bootstrap/cars").multinomial(cars, np.full(cars, 1 / cars), REPLICATES)
    order = np.argsort(values)
    below = np.cumsum(drawn[:, which[order]], axis=1)
    medians = values[order][(2 * below >= below[:, -1:]).argmax(axis=1)]
    low, high = np.quantile(medians, [0.025, 0.975])
    return float(low), float(high)


def groups(b: Battery, by: str) -> Iterator[Group]:
    """All frames together ("all"), or by "distance", "occlusion", "manoeuvre" or "point", for every estimator."""
    values = ["all"] if by == "all" else [v for v in _values(b, by) if (b.frames[by] == v).any()]
    for value in values:
        for estimator in b.estimators:
            of = (b.windows["estimator"] == estimator, b.failed["estimator"] == estimator)
            frames, windows, failed = b.frames, b.windows[of[0]], b.failed[of[1]]
            if by != "all":
                frames, windows, failed = (t[t[by] == value] for t in (frames, windows, failed))
            yield _group(b, (by, value, estimator), frames, windows, failed)


def _values(b: Battery, by: str) -> list[str]:
    return list(b.cars.index) if by == "point" else list(b.frames[by].cat.categories)


def _group(
    b: Battery, names: tuple[str, str, str], frames: pd.DataFrame, windows: pd.DataFrame, failed: pd.DataFrame
) -> Group:
    tracks = float(windows["tracks"].sum())
    return Group(
        *names,
        cars=frames["point"].nunique(),
        frames=len(frames) * b.runs,
        estimated=len(windows) / (len(frames) * b.runs),
        windows=len(windows) + len(failed),
        failed=len(failed),
        outliers=float(windows["wrong"].sum()) / tracks if tracks else np.nan,
        distance_m=float(frames["distance_m"].median()),
        errors={name: spread(windows[name].to_numpy(float), windows["point"].to_numpy()) for name in MEASURED},
    )
