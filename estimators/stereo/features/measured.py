"""Tracks of a whole sequence with the covariance that the images themselves show.

The structure of each patch gives the shape of a point's covariance. Its size is calibrated on what no truth is needed
for: the right point's deviation from the epipolar line is an error of matching; and second differences of places and
disparities over three frames, less what all tracks share, are errors of tracking and matching. What stays for several
frames shows in neither: a patch strays along an edge, on a surface that turns or mirrors, or lies across a step in
depth. It is stated as a drift, measured against the truth of rendered cars.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from estimators.stereo.features.stereo_match import Match
from estimators.stereo.features.templates import Live
from estimators.stereo.triangulation import triangulate
from sim.camera import StereoRig
from sim.observations import Tracks

Array = np.ndarray
_FLOOR_PX = 0.02  # no registration is better, whatever its residuals say
_ASKEW_PX = 0.05  # what of a match's error stays from frame to frame: rendered cars, against truth
_MAD = 1.4826
_ENOUGH = 30  # deviations that a calibration needs
_RANGE = (0.5, 5.0)  # of the calibration factors


@dataclass(frozen=True, eq=False)
class Rows:
    """Observations of one frame: track (n,), left and right (n, 2), covariance [px²] of left against the template's
    place (n, 2, 2), of the template's place (n, 2, 2), and of matching (n, 2, 2)."""

    frame: int
    track: Int[Array, "n"]
    left: Float[Array, "n 2"]
    right: Float[Array, "n 2"]
    cov_left: Float[Array, "n 2 2"]
    cov_anchor: Float[Array, "n 2 2"]
    cov_match: Float[Array, "n 2 2"]

    @staticmethod
    def of(frame: int, live: Live, match: Match) -> Rows:
        k = match.found
        return Rows(frame, live.track[k], live.uv[k], match.uv[k], live.cov[k], live.anchored[k], match.cov[k])


def measured_tracks(rig: StereoRig, rows: Sequence[Rows], drift_px: float) -> Tracks:
    """All observations in order, with their covariance.

    The error of a left point, its drift included, is common to the right one, which is matched to it:
    Cov(left, right) = Cov(left).
    """
    frame = np.concatenate([np.full(len(r.track), r.frame) for r in rows] or [np.empty(0, int)])
    names = ("track", "left", "right", "cov_left", "cov_anchor", "cov_match")
    shapes = ((0,), (0, 2), (0, 2), (0, 2, 2), (0, 2, 2), (0, 2, 2))
    empty = {n: np.empty(s, int if n == "track" else float) for n, s in zip(names, shapes, strict=True)}
    track, left, right, C_left, C_anchor, C_match = (
        np.concatenate([empty[n], *(getattr(r, n) for r in rows)]) for n in names
    )
    order = np.lexsort((track, frame))
    frame, track, left, right = frame[order].astype(int), track[order].astype(int), left[order], right[order]
    floor = _FLOOR_PX**2 * np.eye(2)
    C_match = C_match[order] + floor
    C_left = C_left[order] + floor
    along = _roughness(frame, track, right - left, C_match)
    scale = np.sqrt([max(along[0], 1.0), max(along[1], _across(rig, left, right, C_match))])
    C_match = C_match * np.outer(scale, scale) + _ASKEW_PX**2 * np.eye(2)
    C_left = C_left * _roughness(frame, track, left, C_left).mean() + C_anchor[order] + drift_px**2 * np.eye(2)
    cov = np.empty((len(frame), 4, 4))
    cov[:, :2, :2] = cov[:, :2, 2:] = cov[:, 2:, :2] = C_left
    cov[:, 2:, 2:] = C_left + C_match
    return Tracks(frame, track, left, right, cov)


def _factor(deviation: Array, sigma: Array) -> float:
    """Square of how much larger deviations are than their sigma, by their median, so that outliers do not count."""
    if len(deviation) < _ENOUGH:
        return 1.0
    return float(np.clip(_MAD * np.median(np.abs(deviation / sigma)), *_RANGE) ** 2)


def _across(rig: StereoRig, left: Array, right: Array, C_match: Array) -> float:
    """From the deviations across the epipolar line, about vertical."""
    both = np.concatenate([left, right], axis=1)
    point, _ = triangulate(rig, both, np.broadcast_to(np.eye(4), (len(both), 4, 4)))
    known = np.isfinite(point).all(axis=1)
    off = both[known] - rig.project(point[known])
    return _factor(off[:, 3] - off[:, 1], np.sqrt(C_match[known, 1, 1]))


def _roughness(frame: Array, track: Array, place: Array, C: Array) -> Float[Array, "2"]:
    """Factors of both coordinates, from second differences over three frames less their median of the frame."""
    order = np.lexsort((frame, track))
    f, t, uv, C = frame[order], track[order], place[order], C[order]
    triple: Bool[Array, "n"] = (t[2:] == t[:-2]) & (f[2:] == f[:-2] + 2)
    second = (uv[2:] - 2 * uv[1:-1] + uv[:-2])[triple]
    variance = np.einsum("nii->ni", C[2:] + 4 * C[1:-1] + C[:-2])[triple]
    at = f[1:-1][triple]
    for k in np.unique(at):
        second[at == k] -= np.median(second[at == k], axis=0)
    return np.array([_factor(second[:, i], np.sqrt(variance[:, i])) for i in (0, 1)])
