"""The time-offset study: the injected offset is where the residual is least, and a boresight fitted anew hides it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from benchmarks.boresight_flights import ANTAR, MOUNTING
from estimators.aerial.boresight import ControlPoints
from estimators.aerial.boresight_model import Navigation
from estimators.aerial.boresight_time import TimeOffsetStudy, rms_over_time_offset
from estimators.aerial.resection import ImagePoints
from sim.angles import body_rotation
from sim.pose import Pose

Array = np.ndarray
OFFSET_S, SPEED = 0.020, 60.0
OFFSETS = np.linspace(-0.06, 0.06, 25)


@dataclass(frozen=True, eq=False)
class Pass:
    """A straight flight to the east at 500 m, rolling a little; five exposures over nine points."""

    navigation: Navigation
    t_s: Array
    points: ImagePoints
    control: ControlPoints


@pytest.fixture(scope="module")
def flown() -> Pass:
    rng = np.random.default_rng(0)
    t = np.arange(0, 10, 0.005)
    rph = np.stack([0.01 * np.sin(0.5 * t), 0.01 * np.cos(0.4 * t), np.full(len(t), np.pi / 2)], axis=1)
    p = np.stack([SPEED * (t - 5), 0 * t, np.full(len(t), 500.0)], axis=1)
    velocity = np.tile([SPEED, 0.0, 0.0], (len(t), 1))
    rate = np.zeros((len(t), 3))
    sigma = np.deg2rad([0.008, 0.008, 0.015])
    navigation = Navigation(t, Pose(body_rotation(rph, 0.0), p), velocity, rate, sigma, np.full(3, 0.05))
    exposed = np.array([4.4, 4.7, 5.0, 5.3, 5.6])
    east, north = np.meshgrid([-40.0, 0, 40], [-60.0, 0, 60])
    X = np.column_stack([east.ravel(), north.ravel(), rng.uniform(0, 10, 9)])
    image, point = (a.ravel() for a in np.indices((5, 9)))
    T_wc = navigation.pose(exposed) @ MOUNTING.T_bc
    uv = ANTAR.project(T_wc[image].inv().apply(X[point])) + rng.normal(0, 0.3, (45, 2))
    return Pass(navigation, exposed - OFFSET_S, ImagePoints(image, point, uv, 0.3), ControlPoints(X, 0.02))


def study(flown: Pass, refit: bool = False) -> TimeOffsetStudy:
    return rms_over_time_offset(
        ANTAR, flown.points, flown.control, flown.navigation, flown.t_s, OFFSETS, MOUNTING, refit
    )


def test_the_residual_is_least_at_the_offset_and_grows_by_the_speed(flown: Pass) -> None:
    result = study(flown)
    assert result.offsets_s[np.argmin(result.rms_px)] == pytest.approx(OFFSET_S)
    assert result.rms_px.min() == pytest.approx(0.3 * np.sqrt(2), rel=0.2)
    away = np.abs(OFFSETS - OFFSET_S) > 0.03
    expected = np.abs(OFFSETS - OFFSET_S) * SPEED / 500 * 2500
    np.testing.assert_allclose(result.rms_px[away], expected[away], rtol=0.05)
    assert np.all(result.offsets_s[np.argmin(result.by_image, axis=0)] == pytest.approx(OFFSET_S, abs=0.0051))
    np.testing.assert_allclose(np.sqrt(np.mean(result.by_image**2, axis=1)), result.rms_px)


def test_a_boresight_fitted_anew_takes_up_the_offset(flown: Pass) -> None:
    fixed, refitted = study(flown), study(flown, refit=True)
    assert np.all(refitted.rms_px < 0.1 * fixed.rms_px.max())
    assert np.ptp(refitted.rms_px) < 0.2


def test_offsets_outside_the_records_are_refused(flown: Pass) -> None:
    with pytest.raises(ValueError, match="is outside"):
        rms_over_time_offset(ANTAR, flown.points, flown.control, flown.navigation, flown.t_s, np.array([5.0]), MOUNTING)


def test_images_without_points_have_no_residual(flown: Pass) -> None:
    few = flown.points.select(flown.points.image != 2)
    result = rms_over_time_offset(ANTAR, few, flown.control, flown.navigation, flown.t_s, OFFSETS[:2], MOUNTING)
    assert np.isnan(result.by_image[:, 2]).all()
    assert np.isfinite(np.delete(result.by_image, 2, axis=1)).all()
