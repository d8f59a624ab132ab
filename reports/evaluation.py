"""All that is known of one run of one estimator, as tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from estimators.estimate import EstimationFailed, TrajectoryEstimate
from reports.consistency import NEES_COLUMNS, nees_table
from reports.errors import compare_windows, comparison_table
from reports.windows import true_outliers
from sim.observations import Tracks
from sim.truth import Truth

OUTLIER_COLUMNS = ["tp", "fp", "fn", "flagged"]
_WINDOW_COLUMNS = ["t_s", "tracks", *OUTLIER_COLUMNS]
VISIBLE_POINTS = 30  # a frame with fewer visible points need not be estimated


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Comparison and NEES tables of one run, and what they cannot hold.

    wanted: frames in which enough of the target is visible, estimated: those of them with an estimate; windows tried
    and failed; overlap: frames of the longest window; over_ground: what speed and yaw rate refer to; runtime_s NaN
    where nothing was estimated; outliers: tracks of every window, used or rejected, at the time of its newest frame,
    true, false and missed outliers among them (t_s, tracks, tp, fp, fn), and how many of the rejected ones were flagged
    as another rigid body.
    """

    scenario: str
    seed: int
    run: int
    estimator: str
    comparison: pd.DataFrame
    nees: pd.DataFrame
    wanted: int
    estimated: int
    windows: int
    failed: int
    overlap: int
    over_ground: bool
    runtime_s: float
    outliers: pd.DataFrame


def evaluate(
    truth: Truth,
    tracks: Tracks,
    estimate: TrajectoryEstimate | EstimationFailed,
    *,
    scenario: str,
    seed: int,
    run: int,
    estimator: str,
) -> Evaluation:
    """Holds one estimate against the truth."""
    names: dict[str, Any] = {"scenario": scenario, "seed": seed, "run": run, "estimator": estimator}
    comparisons = compare_windows(truth, tracks, estimate) if isinstance(estimate, TrajectoryEstimate) else []
    comparison = comparison_table(truth, tracks, estimate, **names, comparisons=comparisons)
    wanted = truth.visible_points >= VISIBLE_POINTS
    frames: list[int] = []
    nees = pd.DataFrame(columns=NEES_COLUMNS)
    windows, overlap, over_ground, runtime_s = 1, 1, False, np.nan
    outliers = pd.DataFrame(columns=_WINDOW_COLUMNS)
    if isinstance(estimate, TrajectoryEstimate):
        nees = nees_table(truth, estimate, comparisons, **names)
        frames = [int(w.frames[-1]) for w in estimate.windows]
        windows = len(estimate.windows) + len(estimate.failures)
        overlap = max((len(w.frames) for w in estimate.windows), default=1)
        outliers = _outlier_counts(truth, tracks, estimate)
        over_ground, runtime_s = estimate.T_wc is not None, estimate.runtime_s
    return Evaluation(
        scenario,
        seed,
        run,
        estimator,
        comparison,
        nees,
        wanted=int(wanted.sum()),
        estimated=int(wanted[frames].sum()),
        windows=windows,
        failed=int((comparison["quantity"] == "failure").sum()),
        overlap=overlap,
        over_ground=over_ground,
        runtime_s=runtime_s,
        outliers=outliers,
    )


def _outlier_counts(truth: Truth, tracks: Tracks, estimate: TrajectoryEstimate) -> pd.DataFrame:
    """Tracks of every window, true, false and missed outliers among them, and those flagged as another rigid body, at
    the time of its newest frame.
    """
    rows = []
    for window in estimate.windows:
        wrong = true_outliers(truth, tracks, window)
        hit = int(np.isin(window.rejected, wrong).sum())
        rows.append(
            (
                float(truth.t_s[window.frames[-1]]),
                len(window.track) + len(window.rejected),
                hit,
                len(window.rejected) - hit,
                len(wrong) - hit,
                len(window.second_group),
            )
        )
    return pd.DataFrame(rows, columns=_WINDOW_COLUMNS)
