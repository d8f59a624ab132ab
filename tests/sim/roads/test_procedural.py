"""Procedural networks: simple lines that meet at nodes only, the stated classes, deterministic in the seed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sim.roads import RoadNetwork, lanes, markings
from sim.roads.motorway import mixed, motorway
from sim.roads.town import town

Maker = Callable[..., RoadNetwork]


def touches(network: RoadNetwork) -> list[str]:
    """Where edges cross themselves, or meet another away from a common node."""
    lines = [shapely.LineString(e.line_m) for e in network.edges]
    found = [f"edge {k} crosses itself" for k, line in enumerate(lines) if not line.is_simple]
    for i, j in shapely.STRtree(lines).query(lines, predicate="intersects").T:
        if i < j:
            common = network.nodes_m[np.intersect1d(network.ends[i], network.ends[j])]
            for p in shapely.get_coordinates(lines[i].intersection(lines[j])):
                if not len(common) or np.hypot(*(common - p).T).min() > 1e-6:
                    found.append(f"edges {i} and {j} meet at {p}")
    return found


@pytest.mark.parametrize("make", [town, motorway, mixed])
@pytest.mark.parametrize("seed", range(15))
def test_roads_meet_at_nodes_only(make: Maker, seed: int) -> None:
    network = make(np.random.default_rng(seed))
    assert touches(network) == []
    assert min(e.length_m for e in network.edges) > 4


def test_touches_finds_a_crossing() -> None:
    net = town(np.random.default_rng(0))
    x0, y0, x1, y1 = net.bounds_m
    diagonal = net.edges[0].standard(np.array([[x0, y0], [x1, y1]]), 4, 1, False)
    assert len(touches(RoadNetwork.of([*net.edges, diagonal]))) > 5


@pytest.mark.parametrize("make", [town, motorway, mixed])
def test_the_seed_decides(make: Maker) -> None:
    a, b, c = (make(np.random.default_rng(s)) for s in (5, 5, 6))
    assert len(a.edges) == len(b.edges)
    assert all(np.array_equal(e.line_m, f.line_m) for e, f in zip(a.edges, b.edges, strict=True))
    assert a.bounds_m != c.bounds_m


def components(network: RoadNetwork) -> int:
    a, b = network.ends.T
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(len(network.nodes_m),) * 2)
    return int(connected_components(graph)[0])


@pytest.mark.parametrize("seed", range(5))
def test_a_town_is_one_network_without_dead_ends(seed: int) -> None:
    net = town(np.random.default_rng(seed), size_m=(1000.0, 800.0), block_m=100.0, centre_m=(300.0, -200.0))
    assert components(net) == 1
    assert net.degree.min() >= 2
    x0, y0, x1, y1 = net.bounds_m
    assert (x0 + x1) / 2 == pytest.approx(300, abs=60)
    assert (y0 + y1) / 2 == pytest.approx(-200, abs=60)
    assert {e.road_class for e in net.edges} == {2, 3, 4}
    assert {e.lanes for e in net.edges if e.road_class == 2} == {4}
    assert all((e.parking_m > 0) == (e.road_class == 4) for e in net.edges)


def test_a_roundabout_is_driven_to_the_left_and_a_plaza_is_open() -> None:
    net = town(np.random.default_rng(1))
    ring = [e for e in net.edges if e.name == "roundabout"]
    assert len(ring) == 4
    points = np.concatenate([e.line_m[:-1] for e in ring])
    middle = points.mean(axis=0)
    for e in ring:
        assert e.oneway
        a, b = e.line_m[0] - middle, e.line_m[1] - middle
        assert a[0] * b[1] - a[1] * b[0] > 0
        np.testing.assert_allclose(np.hypot(*(e.line_m - middle).T), 20, atol=1.5)
    blocks = shapely.get_parts(shapely.polygonize([shapely.LineString(e.line_m) for e in net.edges]))
    closed = town(np.random.default_rng(1), plaza=False, roundabout=False)
    others = shapely.get_parts(shapely.polygonize([shapely.LineString(e.line_m) for e in closed.edges]))
    # Two by two blocks are one.
    assert max(b.area for b in blocks) > 3 * np.median([b.area for b in others])
    assert not [e for e in closed.edges if e.name == "roundabout"]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("count", [2, 3])
def test_carriageways_lie_apart_by_the_section_and_bend_gently(seed: int, count: int) -> None:
    net = motorway(np.random.default_rng(seed), lanes=count, length_m=4000.0, heading=0.5, rest_areas=False)
    there, back = net.edges
    assert there.road_class == back.road_class == (0 if count == 3 else 1)
    apart = [shapely.LineString(back.line_m).distance(shapely.Point(p)) for p in there.line_m[20:-20]]
    # Pavement and median (3.5 m).
    np.testing.assert_allclose(apart, there.width_m + 3.5, atol=0.05)
    d = there.line_m[-1] - there.line_m[0]
    assert d @ (back.line_m[-1] - back.line_m[0]) < 0
    assert abs(np.arctan2(d[0], d[1]) - 0.5) < np.deg2rad(20)
    # The opposite carriageway lies to the left.
    left = back.line_m[-1] - there.line_m[0]
    assert d[0] * left[1] - d[1] * left[0] > 0
    steps = np.diff(there.line_m, axis=0)
    turn = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    curvature = turn / np.hypot(*steps.T)[1:]
    assert np.abs(curvature).max() < 1 / 1150
    assert np.abs(curvature).max() > 1 / 8000
    # Clothoids: no jump of the curvature beyond a step's share of a ramp from -R to R.
    assert np.abs(np.diff(curvature)).max() < 3 * (2 / 1200) * 10 / 500


def test_rest_areas_leave_and_join_each_carriageway_at_the_right() -> None:
    net = motorway(np.random.default_rng(2))
    names = [e.name for e in net.edges]
    assert {n: names.count(n) for n in set(names)} == {"motorway": 6, "exit": 2, "entry": 2, "rest area": 2}
    for k, e in enumerate(net.edges):
        if e.name != "exit":
            continue
        start = net.ends[k, 0]
        onto = [f for f, pair in zip(net.edges, net.ends, strict=True) if f.name == "motorway" and pair[0] == start]
        assert len(onto) == 1
        d, far = onto[0].line_m[1] - onto[0].line_m[0], e.line_m[-1] - e.line_m[0]
        assert d[0] * far[1] - d[1] * far[0] < 0
        assert e.oneway
    assert components(net) == 2
    assert len(markings(net)) > 500
    assert len(lanes(net)) == 6 * 3 + 4 + 4


@pytest.mark.parametrize("seed", [0, 30, 38])
def test_the_town_reaches_the_motorway_over_ramps(seed: int) -> None:
    net = mixed(np.random.default_rng(seed))
    # The far carriageway stands alone.
    assert components(net) == 2
    names = {e.name for e in net.edges}
    assert {"exit", "entry", "motorway", "motorway link"} <= names


def test_impossible_sizes_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="at least 4 streets"):
        town(rng, size_m=(200.0, 900.0))
    with pytest.raises(ValueError, match="2 or 3 lanes"):
        motorway(rng, lanes=5)
    with pytest.raises(ValueError, match="length_m of at least 1360"):
        motorway(rng, length_m=500.0)
