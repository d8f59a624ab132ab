"""Residuals over an assumed time offset between camera and navigation (Kozempel 2012, 3.3 and Fig. 3.8)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from estimators.aerial.boresight import BoresightEstimate, ControlPoints, boresight_from_gcps
from estimators.aerial.boresight_model import Navigation
from estimators.aerial.resection import ImagePoints
from estimators.gauss_markov import sum_by
from sim.angles import Mounting
from sim.archive import freeze_fields
from sim.camera import Camera

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class TimeOffsetStudy:
    """Residuals for every assumed offset: an exposure is taken ``offsets_s`` (o,) after its time tag.

    by_image (o, m) root mean square distance of projected and clicked points of each image, NaN where it has none or
    its adjustment failed; rms_px (o,) the same over all points.
    """

    offsets_s: Float[Array, "o"]
    rms_px: Float[Array, "o"]
    by_image: Float[Array, "o m"]

    def __post_init__(self) -> None:
        freeze_fields(self)


def rms_over_time_offset(
    camera: Camera,
    points: ImagePoints,
    control: ControlPoints,
    navigation: Navigation,
    t_s: Float[Array, "m"],
    offsets_s: Float[Array, "o"],
    mounting: Mounting,
    refit: bool = False,
) -> TimeOffsetStudy:
    """Residuals with the navigation interpolated at the time tags ``t_s`` plus each offset.

    By default ``mounting`` holds for all offsets. ``refit`` adjusts the boresight anew for each, starting there: over
    one height and speed it then takes up the offset, and the curve is flat.

    Raises
        ValueError: a time outside the navigation's records.
    """
    square = np.full((len(offsets_s), len(points)), np.nan)
    for row, offset in enumerate(offsets_s):
        at = navigation.at(t_s + offset)
        used = mounting
        if refit:
            result = boresight_from_gcps(camera, points, control, at, mounting)
            if not isinstance(result, BoresightEstimate):
                continue
            used = result.common.mounting
        T_wc = (at.T_wb @ used.T_bc)[points.image]
        square[row] = np.sum((camera.project(T_wc.inv().apply(control.X_w[points.point])) - points.uv) ** 2, axis=1)
    count = np.bincount(points.image, minlength=len(t_s)).astype(float)
    count[count == 0] = np.nan
    by_image = np.sqrt(sum_by(points.image, square.T, len(t_s)).T / count)
    return TimeOffsetStudy(offsets_s, np.sqrt(np.mean(square, axis=1)), by_image)
