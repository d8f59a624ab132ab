"""Which metrics the regression check compares, and the smallest difference of each that matters."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from reports.errors import SMOOTHED
from reports.metrics import Pooled, as_table, pooled_rows

METRIC = ["quantity", "axis", "statistic"]
Metric = tuple[str, str, str]


@dataclass(frozen=True)
class Matters:
    """The smallest difference that matters: the larger of a share of the value and an absolute one, in SI units.

    For a bias the share is one of the RMS of the same quantity and axis. ``certain`` metrics count what must not happen
    at all: every difference matters, whatever chance may say.
    """

    relative: float = 0.0
    absolute: float = 0.0
    certain: bool = False


# A share of 2 % of an RMS or 10 % of it as a bias is what a change of method is worth; the absolute ones are far below
# what the rig can see. NEES: 5 %, at least of its expectation. Outliers: tracks per window.
CHECKED: dict[Metric, Matters] = {
    ("position", "x", "rms"): Matters(0.02, 1e-3),
    ("position", "z", "rms"): Matters(0.02, 1e-3),
    ("position", "z", "bias"): Matters(0.10, 1e-3),
    ("orientation", "all", "rms"): Matters(0.02, 1e-4),
    ("velocity", "all", "rms"): Matters(0.02, 5e-3),
    ("speed", "all", "rms"): Matters(0.02, 5e-3),
    ("speed", "all", "bias"): Matters(0.10, 5e-3),
    ("yaw_rate", "all", "rms"): Matters(0.02, 2e-4),
    ("yaw_rate", "all", "bias"): Matters(0.10, 2e-4),
    ("shape", "all", "rms"): Matters(0.02, 1e-3),
    ("pose", "all", "nees"): Matters(0.05, 0.05),
    ("velocity", "all", "nees"): Matters(0.05, 0.05),
    ("outlier", "all", "fp"): Matters(0.02, 0.1),
    ("outlier", "all", "fn"): Matters(0.02, 0.1),
    ("trajectory", "all", "converged"): Matters(0.0, 1e-3, certain=True),
    ("trajectory", "all", "failed"): Matters(0.0, 1e-3, certain=True),
}


def run_values(p: Pooled) -> pd.DataFrame:
    """The checked metrics of one estimator in one run: quantity, axis, statistic, unit, direction, value.

    A metric that could not be measured has no row; but no outlier found where there is none counts as 0 of each.
    """
    table = as_table(pooled_rows(p))
    plain = table[(table["bin"] == "") & (table["entity"] != SMOOTHED)]
    rows = plain[pd.MultiIndex.from_frame(plain[METRIC]).isin(list(CHECKED))]
    rows = rows[[*METRIC, "unit", "direction", "value"]]
    if len(p.outliers) and not (rows["quantity"] == "outlier").any():
        none = {"quantity": "outlier", "axis": "all", "unit": "1", "direction": "lower", "value": 0.0}
        rows = pd.concat([rows, pd.DataFrame([none | {"statistic": s} for s in ("fp", "fn")])])
    return rows.reset_index(drop=True)
