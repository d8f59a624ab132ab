"""Calibration flights: what is flown and clicked, what navigation says, and what experiments measure of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from scenarios.experiments.boresight_calibration import ADJUSTED, NO_POSES, BoresightCalibration
from scenarios.experiments.boresight_ties import BoresightTies
from scenarios.experiments.boresight_time_offset import ADJUSTED as WITH_OFFSET
from scenarios.experiments.boresight_time_offset import HELD, REFITTED, BoresightTimeOffset, minimum
from scenarios.experiments.calibration_flight import ANGLES, CalibrationPlan, calibration_flight
from sim.angles import boresight_angles

SOURCE: dict[str, Any] = {"position_m": 0.3, "vibration_deg": 0.08}


def over_runs(experiment: Any, runs: int) -> pd.DataFrame:
    """Rows of some runs, those of t_s 0, with the run."""
    rows = pd.concat([experiment(3, run).assign(run=run) for run in range(runs)])
    at_zero: pd.DataFrame = rows[rows["t_s"] == 0]
    return at_zero


def rms(rows: pd.DataFrame, case: str, quantity: str) -> float:
    chosen = rows[(rows["estimator"] == case) & (rows["quantity"] == quantity)]["value"].to_numpy(float)
    assert len(chosen)
    return float(np.sqrt(np.mean(chosen**2)))


def test_passes_are_flown_in_turn_and_again() -> None:
    plan = CalibrationPlan(headings_deg=(0.0, 180.0), heights_m=(500.0, 1000.0), images=14)
    lines = plan.lines()
    assert [line.height_m for line in lines] == [500, 1000, 500, 1000]
    f = calibration_flight(plan, 1, 0)
    height = f.T_wc.t[:, 2]
    np.testing.assert_allclose(f.heading_deg, np.where(height < 700, 0.0, 180.0), atol=1e-9)
    assert len(f.heading_deg) == 14
    assert np.bincount(f.points.image).tolist() == [8] * 14
    apart = np.diff(f.stamps_s)
    within = apart[apart < 10] * 5  # of a pass; ANTAR takes 5 images a second
    assert len(within) == 10
    np.testing.assert_allclose(within, np.round(within), atol=1e-6)


def test_one_heading_is_flown_at_all_heights() -> None:
    plan = CalibrationPlan(headings_deg=(90.0,), heights_m=(500.0, 800.0), images=4)
    assert [(line.height_m, round(line.direction, 9)) for line in plan.lines()] == [(500.0, 0.0), (800.0, 0.0)]


def test_without_errors_everything_fits() -> None:
    """Pose by navigation and the true mounting is that of the camera, in a world turned by the convergence."""
    plan = CalibrationPlan(position_m=1e-3, clicks_px=0.01, gcp_m=1e-3, navigation="independent", gusts=0.0)
    f = calibration_flight(plan, 1, 0)
    uv = f.camera.project(f.T_wc[f.points.image].inv().apply(f.control.X_w[f.points.point]))
    assert np.abs(uv - f.points.uv).max() < 0.1  # 4 sigma of clicks and of points of a millimetre
    T_wc = f.truth.camera_poses(f.navigation)
    np.testing.assert_allclose(T_wc.t, f.T_wc.t, atol=0.01)
    found = boresight_angles(np.swapaxes(f.navigation.T_wb.R, 1, 2) @ f.T_wc.R)
    off = np.rad2deg(found - f.truth.mounting.boresight)
    assert np.all(np.abs(off) < 5 * np.array([0.008, 0.008, 0.015]))
    assert np.all(off.std(axis=0) > 0.001)


def test_a_time_offset_is_how_long_after_its_stamp_an_image_is_taken() -> None:
    flown = [calibration_flight(CalibrationPlan(time_offset_s=dt), 1, 0) for dt in (0.0, 0.02)]
    np.testing.assert_allclose(flown[1].stamps_s + 0.02, flown[0].stamps_s)
    np.testing.assert_allclose(flown[1].T_wc.t, flown[0].T_wc.t)
    ahead = np.linalg.norm(flown[1].truth.camera_poses(flown[1].navigation).t - flown[0].T_wc.t, axis=1)
    assert np.all(ahead < 0.5)  # 5 cm of GNSS; the offset alone would be 1.2 m


def test_the_sources_conditions_give_the_sources_figures() -> None:
    rows = over_runs(BoresightCalibration(**SOURCE), 10)
    assert 4.5 < rms(rows, "per image", "boresight_px") < 6.5
    for angle in ANGLES:
        assert 0.05 < rms(rows, "per image", f"boresight_scatter_{angle}") < 0.12


def test_own_poses_make_the_covariance_honest() -> None:
    runs = 25
    rows = over_runs(BoresightCalibration(navigation="independent", ways=(ADJUSTED, NO_POSES)), runs)
    nees = rows[rows["quantity"] == "boresight_nees"].groupby("estimator")["value"].mean()
    assert abs(nees[ADJUSTED] - 1) < 2.6 * np.sqrt(2 / (3 * runs))  # 99 %
    assert nees[NO_POSES] > 2
    for angle, goal in zip(ANGLES, (0.006, 0.006, 0.02), strict=True):
        assert goal / 4 < rms(rows, ADJUSTED, f"boresight_{angle}") < goal


def test_what_is_constant_is_averaged_by_no_number_of_images() -> None:
    rows = over_runs(BoresightCalibration(images=36, ways=(ADJUSTED,)), 4)
    for angle, sigma in zip(ANGLES[:2], (0.008, 0.008), strict=True):
        assert rms(rows, ADJUSTED, f"boresight_sigma_{angle}") > np.sqrt(0.6) * sigma


def test_an_offset_at_one_height_in_calm_air_cannot_be_told_from_pitch() -> None:
    flown: dict[str, Any] = {"headings_deg": (0.0, 180.0), "images": 18, "gusts": 0.0, "time_offset_s": 0.02}
    one = over_runs(BoresightTimeOffset(**flown, offsets=5), 3)
    two = over_runs(BoresightTimeOffset(**flown, heights_m=(500.0, 1000.0), offsets=5), 8)
    assert rms(one, WITH_OFFSET, "offset_inseparable") == 1
    assert abs(rms(one, HELD, "offset_minimum")) < 3
    assert rms(two, WITH_OFFSET, "offset_inseparable") == 0
    assert rms(two, WITH_OFFSET, "offset_error") < 4
    assert rms(two, REFITTED, "offset_minimum") == pytest.approx(20, abs=4)


def test_the_lowest_point_of_a_curve() -> None:
    x = np.linspace(-4.0, 4.0, 9)
    assert minimum(x, np.sqrt(2 + (x - 0.7) ** 2)) == pytest.approx(0.7)


def test_ties_of_two_directions_give_what_a_strip_does_not() -> None:
    rows = {layout: over_runs(BoresightTies(layout=layout), 6) for layout in ("strip", "opposite", "crossing")}
    for layout in ("opposite", "crossing"):
        assert rms(rows[layout], "adjusted", "ties_position") < 1
        assert rms(rows[layout], "adjusted", "boresight_phi") < 0.03
        assert rms(rows[layout], "start values", "ties_position") > 10
    assert rms(rows["strip"], "adjusted", "boresight_phi") > 0.05
    assert rms(rows["strip"], "adjusted", "boresight_sigma_phi") > 0.1


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"headings_deg": ()}, "headings_deg: should name one pass"),
        ({"heights_m": (100.0,)}, "heights_m: should be 200 to 3000, found 100"),
        ({"images": 0}, "images: should be 1 to 200"),
        ({"gcps": 1}, "gcps: should be 2 to 100"),
        ({"ways": ()}, "ways: should name one"),
    ],
)
def test_wrong_plans_are_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        BoresightCalibration(**wrong)


def test_wrong_offsets_and_ties_are_refused() -> None:
    with pytest.raises(ValueError, match="offsets: should be odd"):
        BoresightTimeOffset(offsets=6)
    with pytest.raises(ValueError, match="wrong: should be 0 to"):
        BoresightTies(wrong=0.9)
