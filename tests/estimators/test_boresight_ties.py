"""Boresight without control: the source's accuracy from three images, wrong matches, and what ties cannot give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.boresight_flights import ARGOS, TieConditions, TieFlight, fly_ties
from estimators.aerial.boresight import BoresightEstimate
from estimators.aerial.boresight_ties import boresight_from_ties, intersect_rays
from estimators.aerial.resection import ImagePoints
from estimators.estimate import EstimationFailed

Array = np.ndarray
CLEAN = TieConditions()
# Nearly: stated sigmas have to be positive, and the injected ones are the same.
EXACT = TieConditions(sigma_px=1e-7, outliers=0.0, sigma_rph_deg=(1e-9,) * 3, sigma_gnss_m=1e-6)


def flight(conditions: TieConditions = CLEAN, run: int = 0) -> TieFlight:
    return fly_ties(conditions, np.random.default_rng([9, run]))


def adjusted(f: TieFlight) -> BoresightEstimate:
    result = boresight_from_ties(ARGOS, f.points, f.navigation, f.nominal)
    assert isinstance(result, BoresightEstimate), result
    return result


def test_rays_of_exact_points_meet_in_them() -> None:
    f = flight(EXACT)
    X = intersect_rays(ARGOS, f.points, f.truth.camera_poses(f.navigation), len(f.X_w) + 1)
    np.testing.assert_allclose(X[:-1], f.X_w, atol=1e-4)  # 1e-7 px, 1e-9 degrees
    assert np.isnan(X[-1]).all()


def test_exact_rays_give_the_exact_boresight_from_a_degree_off() -> None:
    f = flight(EXACT)
    assert np.abs(np.rad2deg(f.nominal.boresight - f.truth.mounting.boresight)).min() == pytest.approx(1)
    result = adjusted(f)
    assert (
        np.abs(np.rad2deg(result.x - f.truth.mounting.boresight)).max() < 1e-6
    )  # GNSS to a micrometre over 440 m: 1e-7 degrees


def test_three_images_reach_the_accuracy_of_the_source() -> None:
    errors, nees, ground = [], [], []
    for run in range(20):
        f = flight(run=run)
        result = adjusted(f)
        e = result.x - f.truth.mounting.boresight
        errors.append(np.rad2deg(e))
        nees.append(e @ np.linalg.solve(result.cov, e) / 3)
        d = (result.X_w - f.X_w)[np.isfinite(result.X_w[:, 0])]
        ground.append([np.mean(d[:, 0] ** 2 + d[:, 1] ** 2), np.mean(d[:, 2] ** 2)])
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < [0.03, 0.03, 0.06])
    position, height = np.sqrt(np.mean(ground, axis=0))
    assert position < 5.0
    assert height < 1.0
    assert abs(np.mean(nees) - 1) < 2.6 * np.sqrt(2 / 60)  # 99 %


def test_wrong_matches_are_left_out() -> None:
    f = flight(TieConditions(outliers=0.25))
    result = adjusted(f)
    rejected = set(result.rejected[:, 1].tolist())
    assert set(f.wrong.tolist()) - rejected == set()
    assert len(rejected) <= len(f.wrong) + 3
    assert np.isnan(result.X_w[f.wrong]).all()
    assert 0.85 < result.sigma_0 < 1.15


def test_a_strip_of_short_base_says_how_little_it_knows() -> None:
    strip = adjusted(flight(TieConditions(exposures=((0.0, -120.0), (0.0, 0.0), (0.0, 120.0)))))
    crossed = adjusted(flight())
    sigma = np.rad2deg(np.sqrt(np.stack([np.diag(strip.cov), np.diag(crossed.cov)])))
    assert sigma[0].max() > 0.1  # rotation about the axis across the strip
    assert sigma[1].max() < 0.03


def test_too_few_points_and_no_base_are_failures() -> None:
    f = flight()
    few = f.points.select(f.points.point < 4)
    failed = boresight_from_ties(ARGOS, few, f.navigation, f.nominal)
    assert isinstance(failed, EstimationFailed)
    assert "fewer than 6 points" in failed.reason
    alone = f.points.select(f.points.image == 0)
    assert isinstance(boresight_from_ties(ARGOS, alone, f.navigation, f.nominal), EstimationFailed)
    none = ImagePoints(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), 0.5)
    assert isinstance(boresight_from_ties(ARGOS, none, f.navigation, f.nominal), EstimationFailed)


def test_points_of_opposite_directions_are_not_taken_for_wrong() -> None:
    # Most points are seen by neighbours, whose rays nearly meet whatever the boresight is.
    conditions = TieConditions(exposures=((0.0, -150.0), (0.0, -128.0), (180.0, -150.0)), outliers=0.0)
    for run in range(5):
        f = flight(conditions, run)
        p = f.points
        kept = p.image != np.where(p.point % 4 == 0, 1, 2)
        f = replace(f, points=ImagePoints(p.image[kept], p.point[kept], p.uv[kept], p.sigma_px))
        result = adjusted(f)
        e = result.x - f.truth.mounting.boresight
        assert len(result.rejected) < 0.02 * len(f.points)
        assert np.all(np.abs(np.rad2deg(e)) < [0.1, 0.1, 0.25])
        assert e @ np.linalg.solve(result.cov, e) < 16.3  # 99.9 % of three
