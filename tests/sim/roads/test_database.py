"""The faulty road map: displaced as stated, smoothly and together; missing, outdated and narrowed roads labelled."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from sim.roads import RoadNetwork
from sim.roads.database import DisplacementField, MapFaults, faulty_map
from sim.roads.motorway import mixed
from sim.roads.town import town


@pytest.fixture(scope="module")
def world() -> RoadNetwork:
    return mixed(np.random.default_rng(4))


@pytest.fixture(scope="module")
def lengths() -> np.ndarray:
    """Displacements at 20 points far apart (ten correlation lengths) in 500 maps: independent draws."""
    grid = 1500.0 * np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    fields = [DisplacementField(np.random.default_rng(s), MapFaults()) for s in range(500)]
    return np.concatenate([np.hypot(*f(grid).T) for f in fields])


def test_displacements_have_the_stated_distribution(lengths: np.ndarray) -> None:
    # The length has a standard deviation of 1.5 m: 3 sigma of 10000 draws.
    assert lengths.mean() == pytest.approx(1.7, abs=0.045)
    assert np.median(lengths) == pytest.approx(1.27, abs=0.05)
    assert np.quantile(lengths, 0.95) == pytest.approx(4.6, abs=0.25)
    # 3 sigma of a part of 2.2 % in 10000.
    assert np.mean(lengths > 6) == pytest.approx(0.022, abs=0.0045)


def test_displacement_is_smooth_and_scales() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-2000, 2000, (3000, 2))
    step = np.array([1.0, 0.0])
    field = DisplacementField(np.random.default_rng(7), MapFaults())
    strain = np.hypot(*(field(xy + step) - field(xy)).T)
    # The scale of 1.7 m over 150 m is 0.011; the tail multiplies it.
    assert 0.005 < np.sqrt(np.mean(strain**2)) < 0.03
    assert strain.max() < 0.2
    double = DisplacementField(np.random.default_rng(7), MapFaults(displacement_m=3.4))
    np.testing.assert_allclose(double(xy), 2 * field(xy), rtol=1e-12)
    longer = DisplacementField(np.random.default_rng(7), MapFaults(correlation_m=1500.0))
    np.testing.assert_allclose(longer(10 * xy), field(xy), atol=1e-6)


def test_roads_move_together_and_by_what_the_truth_says(world: RoadNetwork) -> None:
    faults = MapFaults(missing=0.0, outdated=0.0, narrowed=0.0)
    found, errors = faulty_map(world, np.random.default_rng(1), faults)
    assert len(found.edges) == len(world.edges)
    np.testing.assert_array_equal(found.degree, world.degree)
    np.testing.assert_array_equal(errors.source, np.arange(len(world.edges)))
    off = []
    for k, edge in enumerate(found.edges):
        true = world.edges[k]
        assert (edge.road_class, edge.lanes, edge.width_m, edge.name) == (
            true.road_class, true.lanes, true.width_m, true.name,
        )  # fmt: skip
        dense = shapely.get_coordinates(shapely.segmentize(shapely.LineString(true.line_m), 20.0))
        np.testing.assert_allclose((edge.line_m - dense).mean(axis=0), errors.displacement_m[k], atol=1e-9)
        off.append(np.hypot(*(edge.line_m - dense).T).mean())
    # One map of a town holds some fifty independent places.
    assert 1.0 < np.mean(off) < 2.6
    # Bent, not broken: along the line the displacement changes by a few per cent of the way.
    assert found.length_m == pytest.approx(world.length_m, rel=0.02)


def test_missing_outdated_and_narrowed_roads_are_labelled(world: RoadNetwork) -> None:
    faults = MapFaults(missing=0.1, outdated=0.06, narrowed=0.5)
    found, errors = faulty_map(world, np.random.default_rng(2), faults)
    n = len(world.edges)
    assert len(errors.missing) == round(0.1 * n)
    new = errors.source < 0
    assert new.sum() == round(0.06 * n)
    assert len(found.edges) == n - len(errors.missing) + new.sum()
    np.testing.assert_array_equal(np.sort(np.concatenate([errors.missing, errors.source[~new]])), np.arange(n))
    for k in np.flatnonzero(~new):
        true, edge = world.edges[errors.source[k]], found.edges[k]
        if errors.narrowed[k]:
            assert true.width_m > edge.map_width_m == 10.5
            assert edge.width_m < true.width_m
        else:
            assert (edge.road_class, edge.width_m) == (true.road_class, true.width_m)
    wide = [e for e in world.edges if e.width_m > 10.5]
    gone = sum(world.edges[k].width_m > 10.5 for k in errors.missing)
    assert round(0.5 * len(wide)) - gone <= errors.narrowed.sum() <= round(0.5 * len(wide))
    # Who leaves the map leaves it from the graph, too.
    assert found.degree.min() >= 1


def test_outdated_roads_lead_where_the_world_has_none(world: RoadNetwork) -> None:
    found, errors = faulty_map(world, np.random.default_rng(3), MapFaults(displacement_m=0.0, outdated=0.1))
    pavement = shapely.union_all([shapely.LineString(e.line_m).buffer(e.width_m / 2) for e in world.edges])
    for k in np.flatnonzero(errors.source < 0):
        line = shapely.LineString(found.edges[k].line_m)
        assert 55 < line.length < 210
        assert line.intersection(pavement).length < 0.35 * line.length
        # It starts at a node of the world.
        assert np.hypot(*(world.nodes_m - found.edges[k].line_m[0]).T).min() < 1e-9


def test_the_seed_decides_and_the_world_stays(world: RoadNetwork) -> None:
    before = world.edges[0].line_m.copy()
    a, b, c = (faulty_map(world, np.random.default_rng(s))[0] for s in (5, 5, 6))
    assert all(np.array_equal(e.line_m, f.line_m) for e, f in zip(a.edges, b.edges, strict=True))
    assert not np.array_equal(a.edges[0].line_m, c.edges[0].line_m)
    np.testing.assert_array_equal(world.edges[0].line_m, before)


def test_no_faults_leave_the_network_as_it_is() -> None:
    net = town(np.random.default_rng(1))
    same, errors = faulty_map(net, np.random.default_rng(1), MapFaults(0.0, 150.0, 0.0, 0.0, 0.0))
    assert same.length_m == pytest.approx(net.length_m, rel=1e-12)
    assert not errors.narrowed.any()
    assert not np.any(errors.displacement_m)


def test_wrong_faults_are_refused() -> None:
    with pytest.raises(ValueError, match=r"MapFaults.missing: expected a part in 0..1, got 1.5"):
        MapFaults(missing=1.5)
    with pytest.raises(ValueError, match="displacement_m >= 0"):
        MapFaults(displacement_m=-1.0)
