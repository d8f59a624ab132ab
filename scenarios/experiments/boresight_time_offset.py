"""RMS of control points over an assumed time offset, and what an adjustment can say of the offset itself.

Kozempel 2012, 3.3, Fig. 3.8: offsets were tried, none made the residuals significantly smaller; nor did one of each
image's own for the fixed boresight.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from estimators.aerial.boresight import BoresightEstimate, boresight_from_gcps
from estimators.aerial.boresight_time import TimeOffsetStudy, rms_over_time_offset
from estimators.estimate import EstimationFailed
from scenarios.experiments.calibration_flight import ANGLES, CalibrationFlight, CalibrationPlan, calibration_flight

Array = np.ndarray
Row = tuple[str, str, float, float]
HELD, REFITTED, ADJUSTED = "boresight held", "boresight fitted anew", "offset adjusted"
_PAIR = {"pitch", "time_offset"}


@dataclass(frozen=True)
class BoresightTimeOffset(CalibrationPlan):
    """Residuals over an assumed time offset, and the offset as an unknown of the adjustment."""

    reach_ms: float = 40.0
    """Assumed offsets go from its negative to itself."""
    offsets: int = 21
    """How many are assumed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.reach_ms <= 500:
            raise ValueError(f"reach_ms: should be 1 to 500, found {self.reach_ms}")
        if not (5 <= self.offsets <= 1001 and self.offsets % 2):
            raise ValueError(f"offsets: should be odd, 5 to 1001, found {self.offsets}")

    @property
    def cases(self) -> tuple[str, ...]:
        """The boresight found without an offset and held, fitted anew for every offset, and with it as an unknown."""
        return HELD, REFITTED, ADJUSTED

    def __call__(self, seed: int, run: int) -> pd.DataFrame:
        """Rows of the curves (t_s: the assumed offset [ms]) and of the adjustment (t_s 0).

        offset_px: RMS distance of control points; offset_minimum: where the curve is lowest [ms], no row where that is
        at its end; offset_gain: by how much it is lower there than at 0, as a part. With the boresight
        held also for every image (t_s its number from 1 on): offset_image_zero_px with no offset and offset_image_px
        with the best of its own. Of the adjustment: offset_error and offset_sigma [ms], offset_inseparable, and
        boresight_<angle>, boresight_sigma_<angle> [deg].
        """
        f = calibration_flight(self, seed, run)
        first = boresight_from_gcps(f.camera, f.points, f.control, f.navigation, f.nominal)
        rows: list[Row] = []
        if isinstance(first, BoresightEstimate):
            for case in (HELD, REFITTED):
                rows += self._curve(case, f, first)
        else:
            rows += [(case, "boresight_failed", 0.0, 1.0) for case in (HELD, REFITTED)]
        rows += _adjusted(f)
        return pd.DataFrame(rows, columns=["estimator", "quantity", "t_s", "value"])

    def _curve(self, case: str, f: CalibrationFlight, first: BoresightEstimate) -> Iterator[Row]:
        ms = np.linspace(-self.reach_ms, self.reach_ms, self.offsets)
        mounting = first.common.mounting
        found = rms_over_time_offset(
            f.camera, f.points, f.control, f.recorded, f.stamps_s, ms / 1e3, mounting, refit=case == REFITTED
        )
        yield case, "boresight_failed", 0.0, 0.0
        yield from ((case, "offset_px", t, float(v)) for t, v in zip(ms.tolist(), found.rms_px, strict=True))
        low = int(np.argmin(found.rms_px))
        if 0 < low < self.offsets - 1:
            yield case, "offset_minimum", 0.0, minimum(ms, found.rms_px)
        yield case, "offset_gain", 0.0, float(1 - found.rms_px[low] / found.rms_px[self.offsets // 2])
        if case == HELD:
            yield from self._images(found)

    def _images(self, found: TimeOffsetStudy) -> Iterator[Row]:
        best, zero = np.min(found.by_image, axis=0), found.by_image[self.offsets // 2]
        for i in np.flatnonzero(np.isfinite(zero)).tolist():
            yield HELD, "offset_image_px", i + 1, float(best[i])
            yield HELD, "offset_image_zero_px", i + 1, float(zero[i])


def minimum(x: Array, y: Array) -> float:
    """Where a curve is lowest, by the parabola through the squares of its lowest value and that one's neighbours.

    Residuals are linear in the offset, so their squares are a parabola.
    """
    i = int(np.argmin(y))
    a, b, c = y[i - 1 : i + 2] ** 2
    return float(x[i] + (x[i] - x[i - 1]) * (a - c) / (2 * (a - 2 * b + c)))


def _adjusted(f: CalibrationFlight) -> Iterator[Row]:
    found = boresight_from_gcps(f.camera, f.points, f.control, f.navigation, f.nominal, ["time_offset"])
    yield ADJUSTED, "boresight_failed", 0.0, float(isinstance(found, EstimationFailed))
    if isinstance(found, EstimationFailed):
        return
    said = any(set(group.names) >= _PAIR for group in found.inseparable)
    sigma = np.sqrt(np.diag(found.cov))
    yield ADJUSTED, "offset_inseparable", 0.0, float(said)
    yield ADJUSTED, "offset_error", 0.0, float(1e3 * (found.x[3] - f.truth.time_offset_s))
    yield ADJUSTED, "offset_sigma", 0.0, float(1e3 * sigma[3])
    for i, angle in enumerate(ANGLES):
        yield ADJUSTED, f"boresight_{angle}", 0.0, float(np.rad2deg(found.x[i] - f.truth.mounting.boresight[i]))
        yield ADJUSTED, f"boresight_sigma_{angle}", 0.0, float(np.rad2deg(sigma[i]))
