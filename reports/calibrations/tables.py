"""Tables of a calibration: angles with their standard deviations, residuals of every click, what was left out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from estimators.aerial.boresight_result import BoresightResult
from reports.calibrations.run import CalibrationRun
from sim.angles import roll_pitch_heading, rotation_map_from_navigation

Array = np.ndarray
ANGLES = ("omega", "phi", "kappa")
BORESIGHT_COLUMNS = ["estimator", "image", "name", "value", "sigma", "unit", "reference", "error"]
RESIDUAL_COLUMNS = [
    *("estimator", "image", "point", "u_px", "v_px", "du_px", "dv_px", "du_adjusted_px", "dv_adjusted_px", "rejected"),
]
# Of a normal distribution, the standard deviation over the median absolute deviation.
_MAD = 1.4826
# An image this many standard deviations from the median of all is worth a look, if there are enough to have a median.
_STRIKING, _FEWEST = 6.0, 5


def in_shown_units(name: str) -> tuple[float, str]:
    """Factor and unit in which an unknown is written: degrees, milliseconds, metres."""
    if name in ANGLES:
        return float(np.rad2deg(1)), "deg"
    return (1e3, "ms") if name == "time_offset" else (1.0, "m")


def errors_deg(angles_deg: Float[Array, "*b 3"], reference_deg: Float[Array, "3"]) -> Float[Array, "*b 3"]:
    """Differences of angles, in [-180, 180)."""
    return np.asarray(np.remainder(angles_deg - reference_deg + 180, 360) - 180)


def boresight_table(run: CalibrationRun) -> pd.DataFrame:
    """Every unknown of every estimator, and the angles of every image (``image`` empty: of all).

    Angles are written near those of the first estimator, beyond 180 degrees where needed.
    """
    rows = [row for label, r in run.results.items() for row in _unknowns(label, r)]
    rows += [row for label, r in run.results.items() for row in _images(run, label, r)]
    table = pd.DataFrame(rows, columns=BORESIGHT_COLUMNS)
    for axis, name in enumerate(ANGLES if rows else ()):
        own = table["name"] == name
        first = float(table.loc[own, "value"].iloc[0])
        table.loc[own, "value"] = _near(table.loc[own, "value"].to_numpy(float), first)
        if run.reference_deg is not None:
            table.loc[own, "reference"] = _near(run.reference_deg[axis], first)
    angles = table["name"].isin(ANGLES)
    table.loc[angles, "error"] = table.loc[angles, "value"] - table.loc[angles, "reference"]
    return table.astype(dict.fromkeys(("value", "sigma", "reference", "error"), float))


def _near(angle_deg: Any, other_deg: float) -> Any:
    """The same angle within half a turn of another."""
    return angle_deg + 360 * np.round((other_deg - angle_deg) / 360)


def _unknowns(label: str, r: BoresightResult) -> Iterator[dict[str, Any]]:
    for name, x, sigma in zip(r.names, r.x, r.sigma, strict=True):
        factor, unit = in_shown_units(name)
        row = {"estimator": label, "image": "", "name": name, "unit": unit}
        yield row | {"value": x * factor, "sigma": sigma * factor}


def _images(run: CalibrationRun, label: str, r: BoresightResult) -> Iterator[dict[str, Any]]:
    angles, sigma = np.rad2deg(r.by_image), np.rad2deg(r.sigma_by_image)
    for image in np.flatnonzero(np.isfinite(angles).all(axis=1)):
        for i, name in enumerate(ANGLES):
            row = {"estimator": label, "image": run.observations.images[image], "name": name, "unit": "deg"}
            yield row | {"value": angles[image, i], "sigma": sigma[image, i]}


def residual_table(run: CalibrationRun) -> pd.DataFrame:
    """Every click: (du, dv) where navigation and the result put its point, minus the click; the same by the pose that
    was adjusted to the image; and whether it was taken for wrong."""
    o, p = run.observations, run.observations.points
    parts = []
    for label, r in run.results.items():
        columns = [np.array(o.images)[p.image], np.array(o.names)[p.point], *p.uv.T, *r.predicted.T, *r.adjusted.T]
        parts.append(pd.DataFrame(dict(zip(RESIDUAL_COLUMNS, [label, *columns, r.rejected], strict=True))))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=RESIDUAL_COLUMNS)


def excluded_table(run: CalibrationRun) -> pd.DataFrame:
    """What was left out and why, by whom: of the files (``estimator`` empty), of an estimator's images and clicks."""
    o, p = run.observations, run.observations.points
    rows = [("", *_split(line)) for line in o.excluded]
    for label, r in run.results.items():
        rows += [(label, *_split(line)) for line in r.left_out]
        for k in np.flatnonzero(r.rejected):
            size = np.hypot(*r.adjusted[k])
            reason = f"taken for a wrong click, {size:.1f} px off"
            rows.append((label, f"{o.names[p.point[k]]} in {o.images[p.image[k]]}", reason))
    return pd.DataFrame(rows, columns=["estimator", "what", "reason"])


def _split(line: str) -> tuple[str, str]:
    what, _, reason = line.partition(": ")
    return what, reason


def headings_deg(run: CalibrationRun) -> Float[Array, "m"]:
    """Grid bearing of every image's heading, in [0, 360)."""
    R_nb = np.swapaxes(rotation_map_from_navigation(0.0), -1, -2) @ run.observations.navigation.T_wb.R
    return np.asarray(np.rad2deg(roll_pitch_heading(R_nb)[:, 2]) % 360)


def striking_images(run: CalibrationRun) -> list[tuple[str, str, float]]:
    """Images whose angle is far from the median of all, by the scatter of all and by its own standard deviation.

    Image, angle, and the difference [deg]: their record of navigation may be another image's.
    """
    found = []
    for r in run.results.values():
        angles, sigma = np.rad2deg(r.by_image), np.rad2deg(r.sigma_by_image)
        if np.count_nonzero(np.isfinite(angles[:, 0])) < _FEWEST:
            continue
        first = angles[np.isfinite(angles[:, 0])][0]
        off = errors_deg(angles, first)
        off = off - np.nanmedian(off, axis=0)
        spread = _MAD * np.nanmedian(np.abs(off), axis=0)
        far = np.abs(off) > _STRIKING * np.maximum(spread, sigma)
        found += [(run.observations.images[i], ANGLES[a], float(off[i, a])) for i, a in np.argwhere(far).tolist()]
    return list(dict.fromkeys(found))
