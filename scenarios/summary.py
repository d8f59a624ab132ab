"""The few numbers a run shows on the terminal."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.table import Table

_ROWS = (
    ("position", "z", "bias"),
    ("position", "z", "rms"),
    ("position", "z", "crb"),
    ("position", "z", "efficiency"),
    ("velocity", "all", "rms"),
    ("yaw_rate", "all", "rms"),
)
_OF_FLIGHTS = (
    *(("ortho", "all", statistic) for statistic in ("made", "failed", "bias", "rms", "max")),
    ("road", "all", "completeness"),
    *(("road_mask", "all", statistic) for statistic in ("completeness", "correctness")),
)
_OF_RECORDINGS = tuple(
    (quantity, "all", "median")
    for quantity in (
        *("track", "outlier", "sigma_0", "distance_sigma", "rotation_sigma", "speed_sigma"),
        *("rotation_error", "translation_error", "scale", "distance_ratio", "speed_difference"),
    )
)
_OF_CALIBRATIONS = (
    *(("boresight", axis, what) for axis in ("omega", "phi", "kappa") for what in ("estimate", "sigma", "bias")),
    *(("lever_arm", axis, what) for axis in ("forward", "right", "down") for what in ("estimate", "sigma")),
    *(("time_offset", "all", what) for what in ("estimate", "sigma")),
    *(("gnss_offset", axis, what) for axis in ("east", "north", "up") for what in ("estimate", "sigma")),
    *(("residual", "all", "rms"), ("sigma_0", "all", "median"), ("outlier", "all", "rejected")),
)
_BY_QUANTITY = {"position": _ROWS, "ortho": _OF_FLIGHTS, "boresight": _OF_CALIBRATIONS}


def show(console: Console, folder: Path) -> None:
    """Prints the headline metrics of a run folder, one column per estimator."""
    metrics = pd.read_csv(folder / "metrics.csv", keep_default_na=False)
    plain = metrics[(metrics["bin"] == "") & (metrics["entity"] != "smoothed") & (metrics["estimator"] != "")]
    labels = list(dict.fromkeys(plain["estimator"]))
    table = Table(box=None, pad_edge=False, show_edge=False)
    table.add_column("")
    for label in labels:
        table.add_column(label, justify="right", overflow="fold")
    measured = set(plain["quantity"])
    known = next((rows for name, rows in _BY_QUANTITY.items() if name in measured), _OF_RECORDINGS)
    rows = [row for row in known if row[0] in measured]
    for quantity, axis, statistic in rows:
        cells = []
        for label in labels:
            hit = plain[
                (plain["estimator"] == label)
                & (plain["quantity"] == quantity)
                & (plain["axis"] == axis)
                & (plain["statistic"] == statistic)
            ]
            cells.append(_cell(hit))
        if set(cells) == {"-"}:
            continue
        name = f"{quantity} {axis}" if axis != "all" else quantity
        table.add_row(f"{name.replace('_', ' ')} {statistic}", *cells)
    console.print(table, highlight=False)


def _cell(rows: pd.DataFrame) -> str:
    if rows.empty:
        return "-"
    unit = rows["unit"].iloc[0]
    digits = ".4f" if rows["quantity"].iloc[0] == "boresight" else ".3g"
    return f"{float(rows['value'].iloc[0]):{digits}}{'' if unit == '1' else f' {unit}'}"
