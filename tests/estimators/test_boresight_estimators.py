"""The estimators of a calibration: honest standard deviations, images that take no part, nothing changed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.boresight_flights import ANTAR, MOUNTING, Conditions, Flight, fly
from estimators.aerial.boresight_estimators import CALIBRATION_ESTIMATORS, ImageByImage, OneAdjustment
from estimators.aerial.boresight_observations import BoresightObservations
from estimators.aerial.boresight_result import BoresightResult
from estimators.estimate import EstimationFailed
from sim.geodesy import Georeference
from sim.pose import Pose, exp_so3
from sim.streams import stream

Array = np.ndarray


def observed(flight: Flight) -> BoresightObservations:
    m = len(flight.navigation)
    return BoresightObservations(
        Georeference(32632),
        ANTAR,
        tuple(f"{i}.jpg" for i in range(m)),
        tuple(f"P{k}" for k in range(len(flight.control.X_w))),
        flight.points,
        flight.control,
        flight.navigation,
        np.ones(m, bool),
        flight.nominal,
        (),
    )


def flown(conditions: Conditions, run: int = 0) -> BoresightObservations:
    return observed(fly(conditions, stream(5, run, "test/boresight_estimators")))


def estimated(estimator: ImageByImage | OneAdjustment, o: BoresightObservations) -> BoresightResult:
    result = estimator(o)
    assert isinstance(result, BoresightResult)
    return result


@pytest.mark.parametrize(
    ("conditions", "fixed_position"),
    [
        (Conditions(sigma_gnss_m=0.3), True),
        (Conditions(sigma_px=2.0, sigma_gcp_m=0.2), True),
        (Conditions(sigma_px=0.5, sigma_gcp_m=0.1), True),
        (Conditions(sigma_gnss_m=0.3), False),
    ],
    ids=["positions", "clicks", "control points", "free positions"],
)
def test_standard_deviations_of_single_images_are_honest(conditions: Conditions, fixed_position: bool) -> None:
    """Squared errors over stated variances of 16 flights of 25 images: one on average."""
    squares = []
    for run in range(16):
        r = estimated(ImageByImage(fixed_position), flown(replace(conditions, images=25), run))
        good = np.isfinite(r.by_image).all(axis=1)
        assert good.mean() > 0.9
        squares.append(((r.by_image - MOUNTING.boresight) / r.sigma_by_image)[good] ** 2)
    ratio = np.concatenate(squares).mean(axis=0)
    # Of 400 independent squares 0.25 were 3.5 sigma; images share points, and rejected clicks take away little.
    assert (np.abs(ratio - 1) < 0.25).all(), ratio


@pytest.mark.parametrize("name", sorted(CALIBRATION_ESTIMATORS))
def test_covariance_of_the_result_is_honest(name: str) -> None:
    """NEES of 60 flights inside its 99.9 % band; scatter over nine images makes a wider one than chi-square."""
    runs, conditions = 60, Conditions(vibration_deg=0.05, images=12)
    errors, sigmas = [], []
    for run in range(runs):
        r = estimated(CALIBRATION_ESTIMATORS[name](), flown(conditions, run))
        errors.append(r.x[:3] - MOUNTING.boresight)
        sigmas.append(r.sigma[:3])
    ratio = float(np.mean(np.square(errors)) / np.mean(np.square(sigmas)))
    low, high = (float(chi2.ppf(q, 3 * runs)) / (3 * runs) for q in (0.0005, 0.9995))
    assert low < ratio < high


def test_a_constant_share_of_the_errors_is_not_averaged() -> None:
    o = flown(Conditions(images=40))
    shared = replace(o, navigation=replace(o.navigation, constant_share=0.5))
    plain, wide = (estimated(ImageByImage(), each).sigma for each in (o, shared))
    roll, pitch, heading = o.navigation.sigma_rph
    # The boresight angles turn about the axes of pitch, roll and heading, but for their 2 degrees.
    assert np.sqrt(wide**2 - plain**2) == pytest.approx(np.sqrt(0.5) * np.array([pitch, roll, heading]), rel=0.01)


def test_of_one_image() -> None:
    o = flown(Conditions(images=1))
    r = estimated(ImageByImage(), o)
    assert r.sigma == pytest.approx(r.sigma_by_image[0])
    adjusted = estimated(OneAdjustment(), o)
    assert adjusted.sigma == pytest.approx(r.sigma, rel=0.1)


def test_an_image_that_sees_no_point_is_left_out_of_the_adjustment() -> None:
    o = flown(Conditions(is_exact=True))
    R = o.navigation.T_wb.R.copy()
    R[4] = R[4] @ exp_so3(np.deg2rad([100.0, 0, 0]))
    turned = replace(o, navigation=replace(o.navigation, T_wb=Pose(R, o.navigation.T_wb.t)))
    for estimator in (ImageByImage(), OneAdjustment()):
        r = estimated(estimator, turned)
        assert r.left_out == ("4.jpg: points fall behind the camera",)
        assert np.abs(r.x[:3] - MOUNTING.boresight).max() < 1e-9
        assert np.isnan(r.adjusted[o.points.image == 4]).all()
        assert not r.used[o.points.image == 4].any()
        assert r.rms_px < 1e-6


def test_nothing_to_resect_is_a_failure() -> None:
    o = flown(Conditions(gcps=1))
    for estimator in (ImageByImage(), OneAdjustment()):
        result = estimator(o)
        assert isinstance(result, EstimationFailed)
        assert "no image could be resected" in result.reason


def test_a_result_is_the_same_after_saving(tmp_path: Path) -> None:
    o = flown(Conditions(images=18, lines=((0.0, 500.0), (180.0, 500.0))))
    o.save(tmp_path / "o")
    again = BoresightObservations.load(tmp_path / "o")
    result = estimated(OneAdjustment(("time_offset",)), again)
    assert result.inseparable
    result.save(tmp_path / "e")
    loaded = BoresightResult.load(tmp_path / "e")
    direct = estimated(OneAdjustment(("time_offset",)), o)
    for name in ("x", "cov", "predicted", "adjusted", "rejected"):
        assert np.array_equal(getattr(loaded, name), getattr(direct, name), equal_nan=True)
    assert loaded.names == direct.names == ("omega", "phi", "kappa", "time_offset")
    assert loaded.inseparable == direct.inseparable
    assert np.array_equal(loaded.common.values(), direct.common.values())
