"""Tables and figures of a study over rigs, as study files name them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from reports.figures.rig import accuracy_over_distance, depth_chart, fit_quality
from reports.rig_design import QUANTITIES, Rig, fit, rig_table
from reports.studies import StudyResult


def rig_accuracy(
    result: StudyResult,
    *,
    rigs: tuple[tuple[float, float], ...] = ((0.15, 1000.0), (0.3, 1000.0), (0.3, 2000.0), (0.9, 2000.0)),
    sigma_px: float = 0.2,
    tracks: int = 120,
    window: int = 10,
    distances_m: tuple[float, float] = (10.0, 90.0),
) -> Figure:
    """Accuracy over distance, achieved and bound, of some rigs (baseline [m], focal length [px])."""
    scene = Rig(*rigs[0], sigma_px, np.geomspace(*distances_m, 200), tracks, window)
    return accuracy_over_distance({name: fit(result, name) for name in QUANTITIES}, scene, rigs)


def rig_chart(
    result: StudyResult,
    *,
    focal_px: float = 1000.0,
    sigma_px: float = 0.2,
    tracks: int = 120,
    window: int = 10,
    distances_m: tuple[float, float] = (10.0, 90.0),
    baselines_m: tuple[float, float] = (0.15, 0.9),
) -> Figure:
    """Lines of equal accuracy in depth over distance and baseline."""
    scene = Rig(baselines_m[0], focal_px, sigma_px, np.geomspace(*distances_m, 120), tracks, window)
    return depth_chart(fit(result, "depth"), scene, np.geomspace(*baselines_m, 100))


def rig_fit(result: StudyResult) -> Figure:
    """How well the formulas say what the study found."""
    return fit_quality({name: fit(result, name) for name in QUANTITIES})


TABLES: dict[str, Callable[..., pd.DataFrame]] = {"rig_design": rig_table}
FIGURES: dict[str, Callable[..., Figure]] = {
    "rig_accuracy": rig_accuracy,
    "rig_chart": rig_chart,
    "rig_fit": rig_fit,
}
