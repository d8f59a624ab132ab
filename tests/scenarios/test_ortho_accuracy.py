"""Check points in ortho images: exact where all is known, and off by what linear propagation says where not."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pandas as pd
import pytest

from estimators.aerial.orthorectify import METHODS, ground_points
from scenarios.experiments.ortho_accuracy import ZONES, OrthoAccuracy, Source
from scenarios.experiments.ortho_budget import GroundShifts, anchor_heights
from scenarios.experiments.ortho_flight import KNOWN, SOURCES, Uncertainty, overfly
from scenarios.experiments.ortho_terrain import Dem, elevation_model, hills
from sim.camera import Camera
from sim.flight_path import FlightLine
from sim.pose import Pose, exp_so3
from sim.terrain import plane

Array = np.ndarray
CAMERA = Camera(
    np.array([[2500, 0, 511.5], [0, 2500, 511.5], [0, 0, 1.0]]), (1024, 1024), np.array([-0.03, 0, 0, 0, 0])
)
T_WC = Pose(np.diag([1.0, -1, -1]) @ exp_so3(np.array([0.04, -0.06, 0.5])), np.array([3.0, 8, 520]))
GROUND = plane((-900, -900, 900, 900), 12.0, (0.05, -0.08))
UV = np.array([[30.0, 40], [511, 511], [1000, 200], [600, 990]])


def rms(rows: pd.DataFrame, quantity: str) -> pd.Series:
    """By method."""
    chosen = rows[(rows["quantity"] == quantity) & (rows["t_s"] == 0)]
    squares = pd.Series(np.square(chosen["value"].to_numpy()), index=chosen["estimator"])
    return squares.groupby(level=0).mean() ** 0.5


def many(experiment: OrthoAccuracy, runs: int) -> pd.DataFrame:
    return pd.concat([experiment(1, run) for run in range(runs)])


@pytest.mark.parametrize(
    "experiment",
    [
        OrthoAccuracy(system="antar", height_m=500.0, errors="none", images=1),
        OrthoAccuracy(system="argos", height_m=1400.0, errors="none", images=1),
    ],
    ids=["antar", "argos"],
)
def test_what_is_known_exactly_lies_where_it_is(experiment: OrthoAccuracy) -> None:
    off = rms(experiment(1, 0), "ortho") / experiment.gsd_m
    # Between records of 200 Hz the stated attitude is linear.
    assert off["exact"] < 0.005
    assert off["map"] < 0.01
    assert off["forward"] == pytest.approx(np.sqrt(1 / 6), rel=0.05)  # half a pixel at most; 3 sigma of 500 points
    assert off["anchor"] > 0.5


def test_parts_make_up_the_whole_and_passes_and_images_too() -> None:
    rows = OrthoAccuracy(dem="srtm", points=100)(1, 0)
    total = rms(rows, "ortho") ** 2
    parts = [rms(rows, f"ortho_{part}") ** 2 for part in ("common", "passes", "images", "within")]
    np.testing.assert_allclose(np.sum(parts, axis=0), total)
    for quantity, count in (("ortho_pass", 3), ("ortho_image", 9)):
        each = rows[rows["quantity"] == quantity].groupby("estimator")["value"]
        assert (each.count() == count).all()
        np.testing.assert_allclose(each.apply(lambda v: np.mean(v**2))[list(total.index)], total)
    zones = rows[(rows["quantity"] == "ortho_zone") & (rows["estimator"] == "exact")]
    assert zones["t_s"].tolist() == list(ZONES)
    assert set(rows["estimator"]) == set(METHODS)


def test_one_wave_of_errors_moves_points_as_finite_differences_do() -> None:
    X = ground_points(CAMERA, T_WC, GROUND, UV)
    shifts = GroundShifts(CAMERA, T_WC, X, GROUND.normal(X[:, :2]))

    def moved(camera: Camera = CAMERA, T: Pose = T_WC, up: float = 0.0) -> Array:
        ground = plane((-900, -900, 900, 900), 12.0 + up, (0.05, -0.08))
        return np.asarray((ground_points(camera, T, ground, UV) - X)[:, :2])

    e = 1e-5
    for k, axis in enumerate(np.eye(3)):
        turned = moved(T=Pose(exp_so3(e * axis) @ T_WC.R, T_WC.t)) / e
        np.testing.assert_allclose(shifts.turned(np.eye(3))[k], turned, rtol=1e-3, atol=0.05)
        by_centre = moved(T=Pose(T_WC.R, T_WC.t + 0.01 * axis)) / 0.01
        np.testing.assert_allclose(shifts.shifted(np.tile(axis, (4, 1))), by_centre, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(shifts.raised(np.full(4, 0.1)), moved(up=0.1), rtol=1e-3, atol=1e-5)
    other = Camera(CAMERA.K * [[1.0001, 1, 1], [1, 1.0001, 1], [1, 1, 1]], CAMERA.size_px, CAMERA.distortion * 1.01)
    np.testing.assert_allclose(shifts.seen_by(other), moved(other), rtol=2e-3, atol=1e-5)


# Degrees of freedom of 25 runs: two axes, anew in each of six images or once a run.
@pytest.mark.parametrize(("source", "dof"), [("vibration", 300), ("boresight", 50), ("clicks", 5000), ("position", 25)])
def test_errors_are_as_large_as_predicted(source: Source, dof: int) -> None:
    rows = many(OrthoAccuracy(errors=source, headings_deg=(90.0,), images=6, points=60), 25)
    ratio = rms(rows, "ortho")["exact"] / rms(rows, "ortho_predicted")["exact"]
    assert abs(ratio - 1) < 3 / np.sqrt(2 * dof) + 0.01


@pytest.mark.parametrize("dem", ["srtm", "flat"])
def test_wrong_heights_cost_what_the_view_off_the_vertical_makes_of_them(dem: Dem) -> None:
    rows = many(OrthoAccuracy(errors="none", dem=dem, images=1), 3)
    found, predicted = rms(rows, "ortho"), rms(rows, "ortho_predicted")
    np.testing.assert_allclose(found, predicted, rtol=0.03)  # of second order: slopes change over a shift
    zones = rows[(rows["quantity"] == "ortho_zone") & (rows["estimator"] == "exact")].groupby("t_s")["value"].mean()
    assert zones.is_monotonic_increasing


def test_a_known_flight_is_stated_as_it_was() -> None:
    line = [FlightLine((0.0, -60.0), (0.0, 60.0), 500.0, 60.0)]
    flown = overfly("antar", line, 2, KNOWN, 1, 0)
    assert flown.stated_camera is flown.camera
    np.testing.assert_allclose(flown.stated_T_wc.t, flown.T_wc.t, atol=1e-3)  # linear between records at 200 Hz
    np.testing.assert_allclose(flown.stated_T_wc.R, flown.T_wc.R, atol=2e-6)
    assert Uncertainty().only("none") == KNOWN
    for source in SOURCES:
        alone = Uncertainty().only(source)
        assert [s for s in SOURCES if getattr(alone, s) != getattr(KNOWN, s)] == [source]


def test_elevation_models() -> None:
    true = hills(6.0, 1, 0)
    assert elevation_model(true, "exact", 1, 0) is true
    xy = np.random.default_rng(1).uniform(-990, 990, (2000, 2))
    np.testing.assert_allclose(elevation_model(true, "flat", 1, 0).height(xy), true.heights_m.mean())
    off = [elevation_model(true, "srtm", 1, run).height(xy) - true.height(xy) for run in range(30)]
    # Common to all 2.3 m: 3 sigma of 30; between nodes of 3 m bilinearly 2 m, and what 90 m do not resolve.
    assert np.std([o.mean() for o in off]) == pytest.approx(2.3, abs=0.9)
    assert 1.9 < np.mean([o.std() for o in off]) < 2.5


def test_heights_between_corners() -> None:
    corner = np.array([10.0, 20, 40, 30])
    found = anchor_heights(corner, np.array([[0.0, 0], [99, 0], [99, 49], [0, 49], [49.5, 24.5]]), (100, 50))
    np.testing.assert_allclose(found, [*corner, 25])


def test_the_largest_flight_has_ground_and_check_points_in_every_image() -> None:
    systems: tuple[Literal["antar", "argos"], ...] = ("antar", "argos")
    for system in systems:
        rows = OrthoAccuracy(system=system, height_m=1500.0, images=6, points=50, dem="flat", relief_m=50.0)(1, 0)
        images = rows[rows["quantity"] == "ortho_image"]
        assert images.groupby("estimator")["value"].count().tolist() == [18] * 4
        assert np.isfinite(images["value"]).all()


@pytest.mark.parametrize(
    ("argument", "words"), [({"height_m": 50.0}, "height_m"), ({"points": 3}, "points"), ({"headings_deg": ()}, "pass")]
)
def test_wrong_arguments(argument: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        OrthoAccuracy(**argument)  # type: ignore[arg-type]  # one of several keys
