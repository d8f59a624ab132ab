"""Tie points of rendered ground, seen from three sides: where they are, and the boresight they give."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from benchmarks.boresight_flights import TieConditions, TieFlight, fly_ties
from estimators.aerial.boresight import BoresightEstimate
from estimators.aerial.boresight_model import Common
from estimators.aerial.boresight_ties import boresight_from_ties
from estimators.aerial.resection import ImagePoints
from estimators.aerial.tie_points import match_ties
from estimators.estimate import EstimationFailed
from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray
CAMERA = Camera.simple((832, 556), 1155.0)  # a sixth of ARGOS
CELL_M, CELLS = 0.8, 1800


@dataclass(frozen=True, eq=False)
class Seen:
    flight: TieFlight
    T_wc: Pose
    nominal_T_wc: Pose
    images: list[Array]


def texture(rng: np.random.Generator) -> Array:
    total = np.zeros((CELLS, CELLS), np.float32)
    for size, weight in ((1.2, 1.0), (3.0, 1.5), (8.0, 2.0), (30.0, 3.0)):
        layer = cv2.GaussianBlur(rng.normal(0, 1, total.shape).astype(np.float32), (0, 0), size)
        total += weight * layer / layer.std()
    return np.clip(128 + 18 * total, 0, 255).astype(np.uint8)


def picture(ground: Array, T_wc: Pose) -> Array:
    """The level ground as the camera sees it."""
    w, h = CAMERA.size_px
    uv = np.stack(np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float)), axis=-1)
    X = on_ground(T_wc, uv)
    column, row = X[..., 0] / CELL_M + CELLS / 2, CELLS / 2 - X[..., 1] / CELL_M
    return np.asarray(cv2.remap(ground, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR))


def on_ground(T_wc: Pose, uv: Array) -> Array:
    xy = CAMERA.normalise(uv)
    ray = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1) @ T_wc.R.T
    return np.asarray(T_wc.t - ray * (T_wc.t[2] / ray[..., 2:]))


@pytest.fixture(scope="module")
def seen() -> Seen:
    f = fly_ties(TieConditions(outliers=0.0), np.random.default_rng(3))
    T_wc = f.truth.camera_poses(f.navigation)
    ground = texture(np.random.default_rng(0))
    nominal = Common(f.nominal).camera_poses(f.navigation)
    return Seen(f, T_wc, nominal, [picture(ground, T_wc[i]) for i in range(3)])


@pytest.fixture(scope="module")
def matched(seen: Seen) -> ImagePoints:
    points = match_ties(seen.images, CAMERA, seen.nominal_T_wc, 20.0, 0.15)
    assert isinstance(points, ImagePoints), points
    return points


def test_ties_are_the_same_points_of_the_ground(seen: Seen, matched: ImagePoints) -> None:
    assert np.all(np.bincount(matched.image) > [100, 100, 200])
    first = np.full((matched.point.max() + 1, 2), np.nan)
    first[matched.point[matched.image == 2]] = matched.uv[matched.image == 2]  # the one in the middle
    for i in (0, 1):
        mine = matched.image == i
        X = on_ground(seen.T_wc[2], first[matched.point[mine]])
        e = CAMERA.project(seen.T_wc[i].inv().apply(X)) - matched.uv[mine]
        assert np.abs(np.median(e, axis=0)).max() < 0.03
        assert np.mean(np.linalg.norm(e, axis=1) < 0.3) > 0.95


def test_ties_give_the_boresight_from_a_degree_off(seen: Seen, matched: ImagePoints) -> None:
    f = seen.flight
    result = boresight_from_ties(CAMERA, matched, f.navigation, f.nominal)
    assert isinstance(result, BoresightEstimate)
    assert np.all(np.abs(np.rad2deg(result.x - f.truth.mounting.boresight)) < [0.03, 0.03, 0.06])
    assert result.sigma_0 < 1.5


def test_images_without_texture_or_overlap_are_failures(seen: Seen) -> None:
    grey = [np.full_like(seen.images[0], 90)] * 3
    failed = match_ties(grey, CAMERA, seen.nominal_T_wc, 0.0)
    assert isinstance(failed, EstimationFailed)
    assert "no corners" in failed.reason
    away = Pose(seen.T_wc.R, seen.T_wc.t + np.array([[0, 0, 0], [5e3, 0, 0], [0, 5e3, 0.0]]))
    failed = match_ties(seen.images, CAMERA, away, 0.0)
    assert isinstance(failed, EstimationFailed)
    assert "no points in common" in failed.reason


def test_images_that_do_not_fit_are_refused(seen: Seen) -> None:
    with pytest.raises(ValueError, match="as many as poses, 3, got 2"):
        match_ties(seen.images[:2], CAMERA, seen.nominal_T_wc, 0.0)
    with pytest.raises(ValueError, match="as the camera's, got"):
        match_ties([seen.images[0][:100], *seen.images[1:]], CAMERA, seen.nominal_T_wc, 0.0)
