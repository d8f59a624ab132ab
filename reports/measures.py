"""What a study measures beside the errors of windows, pooled over runs: numbers of an experiment's steps, and NIS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from reports.bootstrap import REPLICATES
from reports.metrics import metric_row
from reports.statistics import Direction
from sim.streams import stream

Array = np.ndarray


@dataclass(frozen=True)
class Measure:
    """A measured quantity: its unit, which way is better, and what it is pooled to over runs."""

    unit: str
    direction: Direction
    statistic: str
    pool: Callable[..., Any]


def _rms(v: Array, axis: int) -> Array:
    return np.asarray(np.sqrt(np.mean(v * v, axis=axis)))


_PIXELS, _NUMBERS = ("f", "b1", "b2", "cx", "cy"), ("k1", "k2", "k3", "p1", "p2")
_CORRELATED = ("f_k1", "k1_k2", "k2_k3", "cx_p2", "cy_p1")
_INTERIOR = {
    "failed": Measure("1", "lower", "mean", np.mean),
    "points": Measure("1", "higher", "mean", np.mean),
    "corner_noise": Measure("px", "lower", "rms", _rms),
    "sigma_0": Measure("1", "one", "rms", _rms),
    **{f"{p}_error": Measure("px", "lower", "rms", _rms) for p in _PIXELS},
    **{f"{p}_error": Measure("1", "lower", "rms", _rms) for p in _NUMBERS},
    **{f"{p}_sigma": Measure("px", "lower", "rms", _rms) for p in _PIXELS},
    **{f"{p}_sigma": Measure("1", "lower", "rms", _rms) for p in _NUMBERS},
    **{f"{pair}_correlation": Measure("1", "zero", "mean", np.mean) for pair in _CORRELATED},
    "image_error": Measure("px", "lower", "rms", _rms),
    "image_sigma": Measure("px", "lower", "rms", _rms),
    "image_largest": Measure("px", "lower", "median", np.median),
    "largest_turned": Measure("px", "lower", "median", np.median),
}
_BY_CLASS = tuple(f"{name}_{c}" for name in ("pavement", "vehicles") for c in range(5))
_IN_MASK = ("pavement", "vehicles", "whole_vehicles", "affected", *_BY_CLASS)
_ORTHO = ("", "_common", "_passes", "_images", "_within", "_pass", "_image", "_zone", "_predicted")
_ANGLES = ("omega", "phi", "kappa")
_BORESIGHT = {
    **{f"boresight_{a}": Measure("deg", "lower", "rms", _rms) for a in _ANGLES},
    **{f"boresight_sigma_{a}": Measure("deg", "lower", "rms", _rms) for a in _ANGLES},
    **{f"boresight_scatter_{a}": Measure("deg", "lower", "rms", _rms) for a in _ANGLES},
    **{f"boresight_image_{a}": Measure("deg", "zero", "mean", np.mean) for a in _ANGLES},
    "boresight_heading": Measure("deg", "zero", "mean", np.mean),
    "boresight_px": Measure("px", "lower", "rms", _rms),
    "boresight_image_px": Measure("px", "lower", "rms", _rms),
    "boresight_nees": Measure("1", "one", "mean", np.mean),
    "boresight_failed": Measure("1", "lower", "mean", np.mean),
    "offset_px": Measure("px", "lower", "rms", _rms),
    "offset_minimum": Measure("ms", "zero", "mean", np.mean),
    "offset_gain": Measure("1", "higher", "mean", np.mean),
    "offset_image_px": Measure("px", "lower", "rms", _rms),
    "offset_image_zero_px": Measure("px", "lower", "rms", _rms),
    "offset_error": Measure("ms", "lower", "rms", _rms),
    "offset_sigma": Measure("ms", "lower", "rms", _rms),
    "offset_inseparable": Measure("1", "lower", "mean", np.mean),
    "ties_position": Measure("m", "lower", "rms", _rms),
    "ties_height": Measure("m", "lower", "rms", _rms),
    "ties_missed": Measure("1", "lower", "mean", np.mean),
}
MEASURES = {
    "lost": Measure("1", "lower", "mean", np.mean),
    "least_variance": Measure("1", "one", "median", np.median),
    "covariance_error": Measure("1", "lower", "median", np.median),
    "state_error": Measure("1", "lower", "median", np.median),
    "gain": Measure("1", "zero", "mean", np.mean),
    "stated_variance": Measure("1", "lower", "mean", np.mean),
    "error": Measure("1", "lower", "rms", _rms),
    "nees": Measure("1", "one", "mean", np.mean),
    "nis": Measure("1", "one", "mean", np.mean),
    "nis_dof": Measure("1", "higher", "mean", np.mean),
    **_BORESIGHT,
    **_INTERIOR,
    **{f"ortho{part}": Measure("m", "lower", "rms", _rms) for part in _ORTHO},
    **{f"ortho_cell_{axis}": Measure("m", "zero", "mean", np.mean) for axis in "xy"},
    **{f"ortho_cell_{axis}": Measure("px", "zero", "mean", np.mean) for axis in "uv"},
    **{f"road_{name}": Measure("1", "higher", "mean", np.mean) for name in _IN_MASK},
    **{f"road_{name}": Measure("1", "lower", "mean", np.mean) for name in ("excess", "beyond", "off")},
    **{f"road_displacement{part}": Measure("m", "lower", "mean", np.mean) for part in ("", "_max")},
    "ortho_lost": Measure("1", "lower", "mean", np.mean),
}


def pooled_measure(name: str, values: Float[Array, "n"]) -> tuple[float, float, float]:
    """A quantity over independent runs with its 95 % interval (bootstrap over runs; NaN for a single one)."""
    pool = MEASURES[name].pool
    if len(values) < 2:
        return float(pool(values, axis=0)), np.nan, np.nan
    draws = stream(0, 0, "bootstrap/measures").integers(0, len(values), (REPLICATES, len(values)))
    low, high = np.quantile(pool(values[draws], axis=1), [0.025, 0.975], method="nearest")
    return float(pool(values, axis=0)), float(low), float(high)


def measure_rows(values: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Metrics of one point and estimator, one per quantity and time, which is the ``bin``."""
    for (quantity, t_s), part in values.groupby(["quantity", "t_s"], sort=False, observed=True):
        known = MEASURES[str(quantity)]
        value, low, high = pooled_measure(str(quantity), part["value"].to_numpy(float))
        row = metric_row(str(quantity), "all", known.statistic, value, known.unit, known.direction, len(part))
        yield row | {"runs": part["run"].nunique(), "bin": f"{t_s:g}", "ci_low": low, "ci_high": high, "entity": ""}
