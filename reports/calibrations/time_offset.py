"""Residuals over an assumed time offset of a calibration's images (Kozempel 2012, Fig. 3.8)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from estimators.aerial.boresight_model import Navigation
from estimators.aerial.boresight_result import BoresightResult
from estimators.aerial.boresight_time import TimeOffsetStudy, rms_over_time_offset
from estimators.aerial.resection import ImagePoints
from reports.calibrations.run import CalibrationRun
from sim.pose import Pose, exp_so3

Array = np.ndarray
_REACH_S = 0.05
_STEPS, _REFITTED = 41, 9
ALL, REFIT = "all images", "all images, boresight adjusted anew"
COLUMNS = ["image", "offset_ms", "rms_px"]


def time_offset_table(run: CalibrationRun, label: str) -> pd.DataFrame:
    """Root mean square residual of every image, and of all, over the time offset; empty where no motion is known.

    The boresight is that of the result, or, for comparison, adjusted anew for every offset.
    """
    o, r = run.observations, run.results[label]
    points, t_s, images = _moving(run, r)
    if not len(t_s):
        return pd.DataFrame(columns=COLUMNS)
    reach = min(_REACH_S, 0.45 * float(np.min(np.diff(t_s), initial=np.inf)))
    dense, mounting = _around(o.navigation, images, reach), r.common.mounting

    def study(steps: int, refit: bool) -> TimeOffsetStudy:
        offsets = np.linspace(-0.999 * reach, 0.999 * reach, steps)
        return rms_over_time_offset(o.camera, points, o.control, dense, t_s, offsets, mounting, refit)

    held, refitted = study(_STEPS, False), study(_REFITTED, True)
    parts = [_part(o.images[i], held.offsets_s, held.by_image[:, k]) for k, i in enumerate(images)]
    parts += [_part(ALL, held.offsets_s, held.rms_px), _part(REFIT, refitted.offsets_s, refitted.rms_px)]
    return pd.concat(parts, ignore_index=True)


@dataclass(frozen=True)
class Least:
    """Where the residuals are least: of all images, and of the images each by itself (least and greatest of them)."""

    offset_ms: float
    rms_px: float
    offsets_ms: tuple[float, float]
    by_image_px: tuple[float, float]


def least(table: pd.DataFrame) -> Least:
    """The minima of the curves with the boresight held."""
    held = table[table["image"] != REFIT]
    lowest = held.loc[held.groupby("image")["rms_px"].idxmin()].set_index("image")
    one = lowest.drop(index=ALL)
    return Least(
        *lowest.loc[ALL, ["offset_ms", "rms_px"]].astype(float),
        *((float(one[column].min()), float(one[column].max())) for column in ("offset_ms", "rms_px")),
    )


def _part(image: str, offsets_s: Array, rms_px: Array) -> pd.DataFrame:
    return pd.DataFrame(dict(zip(COLUMNS, [image, 1e3 * offsets_s, rms_px], strict=True)))


def _moving(run: CalibrationRun, r: BoresightResult) -> tuple[ImagePoints, Array, Array]:
    """Clicks that took part, in the images whose motion is known; their times and indices."""
    o = run.observations
    used = o.points.select(r.used & o.knows_motion[o.points.image])
    images, row = np.unique(used.image, return_inverse=True)
    return ImagePoints(row, used.point, used.uv, used.sigma_px), o.navigation.t_s[images], images


def _around(n: Navigation, images: Array, reach_s: float) -> Navigation:
    """Two records about every image, carried on with its velocity and rate."""
    dt = np.array([-reach_s, reach_s])
    t_s = (n.t_s[images, None] + dt).ravel()
    R = n.T_wb.R[images, None] @ exp_so3(dt[:, None] * n.rate_b[images, None])
    t = n.T_wb.t[images, None] + dt[:, None] * n.velocity_w[images, None]
    T_wb = Pose(R.reshape(-1, 3, 3), t.reshape(-1, 3))
    motion = np.repeat(n.velocity_w[images], 2, axis=0), np.repeat(n.rate_b[images], 2, axis=0)
    return Navigation(t_s, T_wb, *motion, n.sigma_rph, n.sigma_position_m, n.constant_share)
