"""Masks of faulty road maps: the same as drawn ones, whole where the map is right, and what every fault takes away."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import shapely

from estimators.aerial.road_mask import mask_of_image
from scenarios.experiments.ortho_flight import KNOWN, overfly
from scenarios.experiments.road_accuracy import MARGINS_M, RoadAccuracy
from scenarios.experiments.road_coverage import Strips, pavement_samples, vehicle_points
from sim.aerial_placement import TrafficSpec, place_traffic
from sim.flight_path import FlightLine
from sim.roads import Road, RoadNetwork
from sim.roads.database import MapFaults, faulty_map
from sim.roads.town import town
from sim.terrain import plane

Array = np.ndarray


@pytest.fixture(scope="module")
def world() -> RoadNetwork:
    return town(np.random.default_rng(3))


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    experiment = RoadAccuracy(network="town", orientation="known")
    return pd.concat([experiment(1, run).assign(run=run) for run in range(3)])


def mean(rows: pd.DataFrame, case: str, quantity: str, t_s: float = 1.5) -> float:
    chosen = (rows["estimator"] == case) & (rows["quantity"] == quantity) & (rows["t_s"] == t_s)
    return float(rows.loc[chosen, "value"].mean())


@pytest.mark.parametrize("margin", [0.0, 1.5, 3.0])
def test_clearances_are_those_of_drawn_masks(world: RoadNetwork, margin: float) -> None:
    """Pixels of an image's mask against the distances of the places they show."""
    found, _ = faulty_map(world, np.random.default_rng(1), MapFaults())
    flown = overfly("antar", [FlightLine((-60.0, 0.0), (60.0, 0.0), 500.0, 60.0)], 1, KNOWN, 1, 0)
    ground = plane((-5000.0, -5000.0, 5000.0, 5000.0))
    drawn = mask_of_image(found, flown.camera, flown.T_wc[0], ground, 2 * margin - 3.0)
    xy = np.random.default_rng(2).uniform(-130, 130, (20000, 2))
    uv = flown.camera.project(flown.T_wc[0].inv().apply(ground.on_ground(xy)))
    inside = flown.camera.contains(uv, 2.0)
    column, row = np.rint(uv[inside]).astype(int).T
    clearance = Strips.mask(found).clearance(shapely.points(xy[inside]))[0]
    assert (drawn.mask[row, column] > 0)[clearance <= margin].any()
    # Round ends are polygons, and a pixel has 0.2 m.
    certain = np.abs(clearance - margin) > 0.35
    assert certain.mean() > 0.9
    np.testing.assert_array_equal((drawn.mask[row, column] > 0)[certain], (clearance <= margin)[certain])


def test_clearance_of_two_roads() -> None:
    along = Road.standard(np.array([[0.0, 0], [100, 0]]), 4, 2, False)
    wide = Road.standard(np.array([[0.0, 20], [100, 20]]), 3, 2, False)
    points = shapely.points(np.array([[50.0, 1], [50, 9], [50, 13], [103.75, 0], [50, 60]]))
    clearance, road = Strips([along, wide], [7.5, 10.5]).clearance(points)
    np.testing.assert_allclose(clearance, [1 - 3.75, 9 - 3.75, 20 - 13 - 5.25, 0, np.inf])
    assert road.tolist() == [0, 0, 1, 0, -1]


def test_pavement_is_sampled_evenly(world: RoadNetwork) -> None:
    samples = pavement_samples(world, np.random.default_rng(1))
    area = np.array([r.length_m * r.width_m for r in world.edges])
    np.testing.assert_allclose(np.bincount(samples.edge), area / 8, atol=1)
    clearance, _ = Strips.pavement(world).clearance(shapely.points(samples.xy))
    assert clearance.max() < 1e-9


def test_vehicles_stand_on_pavement(world: RoadNetwork) -> None:
    traffic = place_traffic(world, np.random.default_rng(1), TrafficSpec(duration_s=0.0))
    points = vehicle_points(traffic)
    middle, *corners = np.moveaxis(points, 1, 0)
    np.testing.assert_allclose(np.mean(corners, axis=0), middle, atol=1e-9)
    clearance = Strips.pavement(world).clearance(shapely.points(points.reshape(-1, 2)))[0].reshape(-1, 5)
    assert clearance[:, 0].max() < 0
    assert np.mean(clearance.max(axis=1) < 0.2) > 0.98


def test_a_right_map_holds_all(rows: pd.DataFrame) -> None:
    for quantity in ("road_pavement", "road_vehicles"):
        assert mean(rows, "exact", quantity) > 0.999
    # RAS-Q widths are wider than the pavement: verges, and medians that are none.
    assert 0.1 < mean(rows, "exact", "road_excess", 0.0) < mean(rows, "exact", "road_excess") < 0.5


def test_every_fault_takes_what_it_must(rows: pd.DataFrame) -> None:
    whole = mean(rows, "exact", "road_pavement")
    assert mean(rows, "displaced", "road_pavement") < whole
    assert mean(rows, "missing", "road_pavement") < whole
    assert mean(rows, "narrowed", "road_pavement") < whole
    assert mean(rows, "outdated", "road_pavement") == whole
    assert mean(rows, "outdated", "road_excess") > mean(rows, "exact", "road_excess")
    # Of a missing road crossings are left, which others cover; of a narrowed one the middle.
    assert mean(rows, "missing", "road_affected") < 0.3
    assert 0.5 < mean(rows, "narrowed", "road_affected") < 0.95
    assert mean(rows, "all", "road_pavement") < min(mean(rows, c, "road_pavement") for c in ("displaced", "missing"))


def test_wider_masks_hold_more_of_both(rows: pd.DataFrame) -> None:
    for quantity in ("road_pavement", "road_whole_vehicles", "road_excess"):
        values = [mean(rows, "displaced", quantity, m) for m in MARGINS_M]
        assert (np.diff(values) >= 0).all()


def test_displacements_are_those_of_the_map(rows: pd.DataFrame) -> None:
    longer = [mean(rows, "displaced", "road_beyond", v) for v in (0.0, 1.0, 3.0, 10.0)]
    assert longer[0] == 1
    assert (np.diff(longer) < 0).all()
    assert mean(rows, "displaced", "road_displacement", 0) < mean(rows, "displaced", "road_displacement_max", 0)


def test_orientation_moves_the_mask() -> None:
    known, measured = (
        RoadAccuracy(network="motorway", system="argos", height_m=1400.0, orientation=o)(1, 0)
        for o in ("known", "measured")
    )
    assert mean(known, "exact", "road_pavement", 0.0) == 1
    assert mean(measured, "exact", "road_pavement", 0.0) < 1
    assert mean(measured, "exact", "road_excess", 0.0) > mean(known, "exact", "road_excess", 0.0)


@pytest.mark.parametrize("argument", [{"height_m": 20.0}, {"displacement_m": -1.0}])
def test_wrong_arguments(argument: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(argument))):
        RoadAccuracy(**argument)  # type: ignore[arg-type]  # one of several keys
