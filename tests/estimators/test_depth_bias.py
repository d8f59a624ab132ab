"""Weights and the systematic depth error they make (Siegemund 2008, 4.1.2-4.1.3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from estimators.estimate import TrajectoryEstimate
from estimators.stereo.depth_bias import averaged_covariance, observation_model
from estimators.stereo.sliding_window import SlidingWindowAdjustment
from estimators.stereo.triangulation import information, second_order_bias, triangulate

Array = np.ndarray


def test_averaged_covariance_keeps_directions_and_the_mean_of_the_axes() -> None:
    rng = np.random.default_rng(0)
    half = rng.normal(size=(7, 3, 3))
    C = half @ np.swapaxes(half, 1, 2)
    averaged = averaged_covariance(C)
    before, V = np.linalg.eigh(C)
    after = np.linalg.eigvalsh(averaged)
    np.testing.assert_allclose(after, np.broadcast_to(before.mean(axis=0), (7, 3)), rtol=1e-9)
    diagonal = np.swapaxes(V, 1, 2) @ averaged @ V
    np.testing.assert_allclose(diagonal, np.broadcast_to(np.diag(before.mean(axis=0)), (7, 3, 3)), atol=1e-9)


def test_averaging_equal_covariances_changes_nothing() -> None:
    C = np.broadcast_to(np.diag([1.0, 2, 50]), (4, 3, 3))
    np.testing.assert_allclose(averaged_covariance(C), C, rtol=1e-12)


@pytest.fixture(scope="module")
def triangulated(scene: Any) -> dict[str, Any]:
    o = scene.observe(0.2)
    l, C = triangulate(scene.rig, o.tracks.uv, o.tracks.cov)
    return {"rig": scene.rig, "l": l, "C": C, "W_uv": np.linalg.inv(o.tracks.cov)}


@pytest.mark.parametrize("second_order", [True, False])
def test_fixed_weights_do_not_move_with_the_points(triangulated: dict[str, Any], second_order: bool) -> None:
    l, C = triangulated["l"], triangulated["C"]
    for weights, expected in (("observed", C), ("averaged", averaged_covariance(C))):
        model = observation_model(**triangulated, weights=weights, second_order=second_order)
        corrected, W = model(l + 1.0)
        np.testing.assert_allclose(W @ expected, np.broadcast_to(np.eye(3), C.shape), atol=1e-7)
        bias = second_order_bias(triangulated["rig"], l, triangulated["W_uv"])
        np.testing.assert_allclose(corrected, l - bias if second_order else l)


def test_estimated_weights_are_those_at_the_current_points(triangulated: dict[str, Any]) -> None:
    rig, W_uv = triangulated["rig"], triangulated["W_uv"]
    Y = triangulated["l"] + [0.1, 0.0, 2.0]
    corrected, W = observation_model(**triangulated, weights="estimated", second_order=True)(Y)
    np.testing.assert_array_equal(W, information(rig, Y, W_uv))
    np.testing.assert_allclose(corrected, triangulated["l"] - second_order_bias(rig, Y, W_uv))


def test_where_the_points_are_lost_the_observed_place_serves(triangulated: dict[str, Any]) -> None:
    Y = triangulated["l"].copy()
    Y[0, 2], Y[1, 0] = -3.0, np.nan
    corrected, W = observation_model(**triangulated, weights="estimated", second_order=True)(Y)
    assert np.isfinite(corrected).all()
    np.testing.assert_allclose(W[:2], information(triangulated["rig"], triangulated["l"], triangulated["W_uv"])[:2])


def test_distorted_cameras_are_refused(triangulated: dict[str, Any], rigs: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="undistorted"):
        observation_model(**{**triangulated, "rig": rigs["general"]}, weights="estimated", second_order=True)


@pytest.mark.parametrize("weights", ["observed", "averaged", "estimated"])
def test_a_model_of_some_observations_says_the_same_of_them(triangulated: dict[str, Any], weights: Any) -> None:
    model = observation_model(**triangulated, weights=weights, second_order=True)
    Y, rows = triangulated["l"] + 0.1, np.arange(len(triangulated["l"])) % 3 == 0
    for part, whole in zip(model.select(rows)(Y[rows]), model(Y), strict=True):
        np.testing.assert_array_equal(part, whole[rows])


@pytest.fixture(scope="module")
def depth_error(make_scene: Callable[..., Any]) -> Callable[..., tuple[float, float]]:
    """Mean depth error [m] of the cloud in the last frame at 35 m, and its standard error, over pairs of runs.

    The runs of a pair have opposite noise: what is linear in it cancels, the bias stays.
    """
    scene = make_scene(points=40, frames=6, distance_m=36.0, speed_mps=5.0, yaw_rate=0.1)
    truth = scene.points_c()[-1, :, 2].mean()

    def depth(estimator: SlidingWindowAdjustment, sigma_px: float, seed: int) -> float:
        estimate = estimator(scene.observe(sigma_px, seed, stated_px=0.3))
        assert isinstance(estimate, TrajectoryEstimate)
        w = estimate.windows[-1]
        return float(w.T_co[-1].apply(w.X_o)[:, 2].mean())

    def measure(pairs: int, **config: Any) -> tuple[float, float]:
        estimator = SlidingWindowAdjustment(window=6, start_window=6, **config)
        errors = [(depth(estimator, 0.3, i) + depth(estimator, -0.3, i)) / 2 - truth for i in range(pairs)]
        return float(np.mean(errors)), float(np.std(errors) / np.sqrt(pairs))

    return measure


def test_who_sees_too_near_and_who_too_far(depth_error: Callable[..., tuple[float, float]]) -> None:
    """The signs and the order of Figures 4.1.4, 4.1.6 and 4.1.7.

    Triangulation puts a point at 35 m too far by Z (sigma_d/d)² = 35 * 0.18 / 73 = 0.086 m.
    """
    pairs = 6
    observed, s_o = depth_error(pairs, weights="observed", second_order=False)
    averaged, s_a = depth_error(pairs, weights="averaged", second_order=False)
    estimated, s_e = depth_error(pairs, weights="estimated", second_order=False)
    corrected, s_c = depth_error(pairs, weights="estimated", second_order=True)
    # Weights from noisy points pull about four times as much towards the camera as triangulation pushes away; on
    # both sides 4 standard errors of about 0.01 m.
    assert -6 * 0.086 < observed < -2.5 * 0.086
    assert observed + 4 * s_o < averaged < 0
    assert estimated == pytest.approx(0.086, abs=4 * s_e + 0.01)
    assert abs(corrected) < 4 * s_c
    assert max(s_o, s_a, s_e, s_c) < 0.015  # the test can tell
