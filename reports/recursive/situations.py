"""Error curves of many runs of a study over time, per situation: what filters and adjustments are compared by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from reports.consistency import DOF
from reports.errors import SMOOTHED
from reports.studies import StudyResult

Array = np.ndarray
STEADY_S = 0.6  # from then on no start matters but a poor one
_NAMES = {"straight": "constant velocity", "braking": "braking", "turning": "turning"}


def situation(scenario: Mapping[str, Any]) -> str:
    """What the target does and how many tracks are wrong."""
    name = _NAMES.get(scenario["vehicle"][0]["motion"]["kind"], scenario["vehicle"][0]["motion"]["kind"])
    share = wrong_share(scenario)
    return f"{100 * share:.0f} % wrong tracks" if share else name


def wrong_share(scenario: Mapping[str, Any]) -> float:
    """Share of the tracks that are outliers."""
    return float(sum(o["tracks"] for o in scenario["outliers"]))


def situations(result: StudyResult) -> dict[str, str]:
    """Points of a study by their situation."""
    return {situation(s): p for p, s in result.scenarios.items()}


@dataclass(frozen=True, eq=False)
class Curves:
    """Errors of one quantity (runs, times, axes) with the truth, NaN where there is no estimate; times (t,)."""

    t_s: Float[Array, "t"]
    error: Float[Array, "r t a"]
    truth: Float[Array, "r t a"]

    def since(self, t_s: float) -> Curves:
        """From a time on."""
        late = self.t_s >= t_s - 1e-9
        return Curves(self.t_s[late], self.error[:, late], self.truth[:, late])


def curves(result: StudyResult, point: str, estimator: str, quantity: str, axis: str | None = None) -> Curves:
    """Errors of an estimator's newest frames at one point, in all runs; of one axis, or all there are.

    Raises
        ValueError: there are none.
    """
    c = result.comparison
    every = c[(c["point"] == point) & (c["quantity"] == quantity) & (c["entity"] != SMOOTHED)]
    if axis is not None:
        every = every[every["axis"] == axis]
    rows = every[every["estimator"] == estimator]
    if rows.empty:
        raise ValueError(f"estimator: {estimator!r} has no errors of {quantity}")
    axes, t_s = sorted(rows["axis"].unique()), np.sort(every["t_s"].unique())
    shape = (result.runs, len(t_s), len(axes))
    at = (
        rows["run"].to_numpy(),
        np.searchsorted(t_s, rows["t_s"].to_numpy()),
        np.searchsorted(axes, rows["axis"].astype(str).to_numpy()),
    )
    error, truth = np.full(shape, np.nan), np.full(shape, np.nan)
    error[at], truth[at] = rows["error"].to_numpy(), rows["truth"].to_numpy()
    return Curves(t_s, error, truth)


def nees_of(result: StudyResult, point: str, estimator: str, quantity: str = "pose") -> Curves:
    """NEES over its degrees of freedom in the place of errors; nothing is its truth."""
    n = result.nees
    rows = n[(n["point"] == point) & (n["estimator"] == estimator) & (n["quantity"] == quantity)]
    wide = rows.pivot_table(index="run", columns="t_s", values="nees")
    values = wide.to_numpy(float)[..., None] / DOF
    return Curves(wide.columns.to_numpy(float), values, np.full(values.shape, np.nan))
