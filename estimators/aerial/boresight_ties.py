"""Boresight without ground control, from points matched in at least two of three or more overlapping images.

Kozempel 2012, 3.4: with the right boresight the rays of one point meet, with a wrong one they pass each other; the
angles are adjusted until the rays come closest. Here distances are weighted in the images (bundle adjustment), every
image keeps its own pose parameters, and points whose rays do not meet are left out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from estimators.aerial.boresight import BoresightEstimate, estimate
from estimators.aerial.boresight_adjustment import Adjusted, Block, Values, adjust
from estimators.aerial.boresight_model import Common, Extra, Navigation, unknowns
from estimators.aerial.resection import ImagePoints
from estimators.estimate import EstimationFailed
from estimators.gauss_markov import sum_by
from sim.angles import Mounting
from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray
# A point is left out from the start if its rays miss by this many times the middle of all.
_GROSS = 6.0
# Chance that a good point is called an outlier in the end.
_SIGNIFICANCE = 0.001
_ROUNDS = 8
# Fewer points that the same images show are judged with all others.
_LEAST_GROUP = 10
_LEAST_POINTS = 6


def intersect_rays(camera: Camera, points: ImagePoints, T_wc: Pose, n: int) -> Float[Array, "n 3"]:
    """World points nearest to their rays: ``(sum P) X = sum P c``, ``P = I - d d'``; NaN where these do not fix one."""
    xy = camera.normalise(points.uv)
    d = np.einsum("kij,kj->ki", T_wc.R[points.image], np.column_stack([xy, np.ones(len(xy))]))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    P = np.eye(3) - d[:, :, None] * d[:, None, :]
    centre = np.mean(T_wc.t, axis=0)
    N = sum_by(points.point, P, n)
    b = sum_by(points.point, np.einsum("kij,kj->ki", P, T_wc.t[points.image] - centre), n)
    fixed = np.linalg.eigvalsh(N)[:, 0] > 1e-8
    X = np.full((n, 3), np.nan)
    X[fixed] = np.linalg.solve(N[fixed], b[fixed, :, None])[:, :, 0] + centre
    return X


def boresight_from_ties(
    camera: Camera,
    points: ImagePoints,
    navigation: Navigation,
    nominal: Mounting,
    extra: Iterable[Extra] = (),
) -> BoresightEstimate | EstimationFailed:
    """Boresight from tie points; the ``point`` indices name what the same point is in several images.

    ``nominal`` starts the adjustment and may be degrees off. Points are weighted down by how badly their rays meet, on
    a scale that follows the middle of those in the same images, and those that fail the test with the stated sigma are
    left out in the end.
    """
    if not len(points):
        return EstimationFailed("no points", ("Match points.",))
    columns, names = unknowns(extra)
    common = Common(nominal)
    T_wc = common.camera_poses(navigation)
    n = int(points.point.max()) + 1
    X = intersect_rays(camera, points, T_wc, n)
    miss = _misses(camera, points, T_wc, X)
    good = _well_measured(points, miss, n)
    if len(np.unique(points.point[good])) < _LEAST_POINTS:
        return EstimationFailed(
            f"fewer than {_LEAST_POINTS} points are measured in two images or more", ("Match more points.",)
        )
    block, X, rows = _block(camera, points, good, X, navigation, columns)
    solved = _reweighted(block, Values(T_wc, X, common))
    if isinstance(solved, EstimationFailed):
        return solved
    keep = _passed(block, solved)
    block, X, rows = _block(camera, points, rows[keep], _spread(solved.values.X, rows, points, n), navigation, columns)
    solved = adjust(block, replace(solved.values, X=X))
    if isinstance(solved, EstimationFailed):
        return solved
    rejected = np.delete(np.stack([points.image, points.point], axis=1), rows, axis=0)
    return estimate(block, solved, solved.values.X, _spread(solved.values.X, rows, points, n), rejected, names)


def _misses(camera: Camera, points: ImagePoints, T_wc: Pose, X: Array) -> Array:
    """Squared distance [px²] of every measured point from the projection of its intersection; infinite where none."""
    uv = camera.project(T_wc[points.image].inv().apply(X[points.point]))
    return np.asarray(np.nan_to_num(np.sum((uv - points.uv) ** 2, axis=1), nan=np.inf))


def _well_measured(points: ImagePoints, miss: Array, n: int) -> Array:
    """Rows of points in two images or more whose rays do not miss grossly."""
    worst = np.zeros(n)
    np.maximum.at(worst, points.point, miss)
    count = np.bincount(points.point, minlength=n)
    possible = (count >= 2) & np.isfinite(worst)
    limit = _GROSS**2 * np.maximum(_typical(points, worst, possible), points.sigma_px**2)
    return np.asarray(np.flatnonzero((possible & (worst <= limit))[points.point]))


def _typical(points: ImagePoints, value: Array, among: Array) -> Array:
    """For every point (n,) the median of those that the same images show.

    Rays from neighbours on one line nearly meet whatever the boresight is, those from opposite directions do not: one
    median of all would take the latter, which tell most, for wrong.
    """
    seen_by = np.zeros((len(value), int(points.image.max()) + 1), bool)
    seen_by[points.point, points.image] = True
    _, group = np.unique(seen_by, axis=0, return_inverse=True)
    typical = np.full(len(value), np.median(value[among]) if np.any(among) else 0.0)
    for g in range(int(group.max()) + 1):
        own = (group == g) & among
        if np.count_nonzero(own) >= _LEAST_GROUP:
            typical[group == g] = np.median(value[own])
    return typical


def _block(
    camera: Camera, points: ImagePoints, rows: Array, X: Array, navigation: Navigation, columns: list[int]
) -> tuple[Block, Array, Array]:
    """The adjustment of some rows, its points numbered anew, and their coordinates."""
    names, point = np.unique(points.point[rows], return_inverse=True)
    chosen = ImagePoints(points.image[rows], point, points.uv[rows], points.sigma_px)
    unknown = np.full(len(names), np.inf)
    return Block(camera, chosen, X[names], unknown, np.ones(len(rows)), navigation, columns), X[names], rows


def _spread(X: Array, rows: Array, points: ImagePoints, n: int) -> Array:
    """Coordinates of the points of some rows in the order of all points, NaN for the others."""
    all_points = np.full((n, 3), np.nan)
    all_points[np.unique(points.point[rows])] = X
    return all_points


def _statistics(block: Block, residuals: Array) -> tuple[Array, Array]:
    """v'v / sigma² of every point and its degrees of freedom."""
    n = len(block.X_w)
    square = np.bincount(block.points.point, np.sum((residuals / block.points.sigma_px) ** 2, axis=1), n)
    return square, 2.0 * np.bincount(block.points.point, minlength=n) - 3


def _reweighted(block: Block, values: Values) -> Adjusted | EstimationFailed:
    """Weights 1 / (1 + T / s²)² (Geman and McClure), T per degree of freedom, s² four times what is typical of it."""
    solved: Adjusted | EstimationFailed = adjust(block, values)
    for _ in range(_ROUNDS):
        if isinstance(solved, EstimationFailed):
            return solved
        square, dof = _statistics(block, solved.residuals)
        T = square / dof
        typical = _typical(block.points, T, np.ones(len(T), bool))
        weight = (1 + T / (4 * np.maximum(1.0, typical))) ** -2
        solved = adjust(replace(block, weights=weight[block.points.point]), solved.values)
    return solved


def _passed(block: Block, solved: Adjusted) -> Array:
    """Measured points of which all pass the test; the stated sigma is not trusted beyond what the middle shows."""
    square, dof = _statistics(block, solved.residuals)
    factor = max(1.0, float(np.median(square / chi2.median(dof))))
    return np.asarray((square <= factor * chi2.isf(_SIGNIFICANCE, dof))[block.points.point])
