"""Traffic on road networks: no two vehicles ever touch, lanes and speeds as stated, jams, queues, parked cars."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from sim.aerial_placement import DRIVING, JAM, PARKED, ParkingLot, TrafficSpec, place_traffic
from sim.aerial_traffic import Traffic
from sim.overlap import overlapping
from sim.roads import RoadNetwork, lanes
from sim.roads.motorway import motorway
from sim.roads.town import town

LOT = ParkingLot((900.0, 0.0), 0.4, 60.0, 32.0)


@pytest.fixture(scope="module")
def streets() -> RoadNetwork:
    return town(np.random.default_rng(2), size_m=(600.0, 500.0))


@pytest.fixture(scope="module")
def city(streets: RoadNetwork) -> Traffic:
    return place_traffic(streets, np.random.default_rng(1), TrafficSpec(duration_s=20.0, lots=(LOT,)))


@pytest.fixture(scope="module")
def road() -> RoadNetwork:
    return motorway(np.random.default_rng(1), length_m=1500.0)


@pytest.fixture(scope="module")
def flow(road: RoadNetwork) -> Traffic:
    return place_traffic(road, np.random.default_rng(1), TrafficSpec(duration_s=20.0, lorries=0.3))


@pytest.fixture(scope="module")
def jam(road: RoadNetwork) -> Traffic:
    jammed = frozenset(k for k, e in enumerate(road.edges) if e.name == "motorway" and e.line_m[-1, 0] > e.line_m[0, 0])
    return place_traffic(road, np.random.default_rng(1), TrafficSpec(duration_s=20.0, jammed=jammed))


@pytest.mark.parametrize("name", ["city", "flow", "jam"])
def test_no_two_vehicles_ever_touch(name: str, request: pytest.FixtureRequest) -> None:
    traffic: Traffic = request.getfixturevalue(name)
    assert len(traffic) > 50
    for t in np.arange(0, 20, 0.07):
        now = traffic.at(float(t))
        assert not len(overlapping(now.centre_m, now.direction, traffic.size_m[:, :2]))


@pytest.mark.parametrize("name", ["city", "flow", "jam"])
def test_vehicles_move_as_their_speed_says_and_stay_on_the_road(name: str, request: pytest.FixtureRequest) -> None:
    traffic: Traffic = request.getfixturevalue(name)
    network: RoadNetwork = request.getfixturevalue("streets" if name == "city" else "road")
    pavement = shapely.union_all([shapely.LineString(e.line_m).buffer(e.width_m / 2 + 0.3) for e in network.edges])
    shapely.prepare(pavement)
    before, a, after = (traffic.at(8.0 + dt) for dt in (-0.001, 0.0, 0.001))
    both = before.present & after.present & (traffic.path >= 0)
    step = (after.centre_m - before.centre_m)[both] / 0.002
    speed = np.hypot(*step.T)
    # Paths are polylines: where an axle passes a vertex, the speed jumps with the direction.
    np.testing.assert_allclose(speed, a.speed_mps[both], rtol=0.02, atol=1e-9)
    # Rounding of stations of up to 1e6 m over a step of 1 cm.
    assert (a.speed_mps[both] <= traffic.speed_mps[both] * (1 + 1e-6)).all()
    assert np.median(a.speed_mps[both] - traffic.speed_mps[both]) > -0.01
    fast = speed > 0.1
    along = np.sum(step[fast] * a.direction[both][fast], axis=1) / speed[fast]
    assert along.min() > np.cos(np.deg2rad(15))
    np.testing.assert_allclose(np.hypot(*a.direction[a.present].T), 1)
    on_road = a.present & (a.centre_m[:, 0] < 800)
    assert shapely.contains_xy(pavement, a.centre_m[on_road]).all()


def test_lanes_have_their_speeds_and_lorries_keep_right(flow: Traffic, road: RoadNetwork) -> None:
    all_lanes = lanes(road)
    number = np.array([all_lanes[k].number for k in flow.path])
    cls = np.array([road.edges[all_lanes[k].edge].road_class for k in flow.path])
    heavy = np.isin(flow.kind, ["lorry", "bus"])
    assert heavy.sum() > 5
    assert (number[heavy & (cls == 0)] == 0).all()
    means = [flow.speed_mps[(number == n) & (cls == 0) & ~heavy].mean() for n in range(3)]
    # Each driver's own speed has 6 %: 3 sigma of some twenty.
    np.testing.assert_allclose(means, [27, 33, 38], rtol=0.05)
    assert (flow.state == DRIVING).all()
    # As many come as go.
    there = [int(flow.at(t).present.sum()) for t in (0.0, 10.0, 20.0)]
    assert max(there) < 1.6 * min(there)


def test_a_jam_fills_its_carriageway(jam: Traffic, flow: Traffic) -> None:
    stuck = jam.state == JAM
    assert stuck.sum() > 5 * (flow.state == DRIVING).sum() / 2
    assert jam.speed_mps[stuck].max() <= 3.0
    assert jam.speed_mps[stuck].min() >= 0.3
    moving = jam.at(0.0)
    first = jam.path[stuck][0]
    line = np.sort(jam.start_m[stuck & (jam.path == first)])
    assert np.diff(line).max() < 25
    assert (moving.direction[stuck, 0] > 0).all()


def test_parked_cars_stand_at_the_kerb_and_in_the_lot(city: Traffic, streets: RoadNetwork) -> None:
    parked = np.flatnonzero(city.state == PARKED)
    now, later = city.at(0.0), city.at(15.0)
    np.testing.assert_array_equal(now.centre_m[parked], later.centre_m[parked])
    assert not now.speed_mps[parked].any()
    in_lot = parked[now.centre_m[parked, 0] > 800]
    along = np.array([np.sin(LOT.heading), np.cos(LOT.heading)])
    off = now.centre_m[in_lot] - LOT.centre_m
    assert np.abs(off @ along).max() < LOT.length_m / 2
    assert np.abs(off @ [-along[1], along[0]]).max() < LOT.width_m / 2
    # Two modules of two rows of 24 bays, 60 % of them taken: 3 sigma.
    assert len(in_lot) == pytest.approx(0.6 * 96, abs=15)
    assert np.abs(now.direction[in_lot] @ along).max() < 0.1
    kerb = np.setdiff1d(parked, in_lot)
    samples = streets.sample(1.0)
    gap = np.hypot(*(now.centre_m[kerb][:, None] - samples.xy_m).transpose(2, 0, 1))
    nearest = gap.argmin(axis=1)
    assert {streets.edges[k].road_class for k in samples.edge[nearest]} == {4}
    turn = np.abs(np.sum(samples.direction[nearest] * now.direction[kerb], axis=1))
    assert turn.min() > 0.95


def test_the_seed_decides(streets: RoadNetwork) -> None:
    spec = TrafficSpec(duration_s=3.0)
    a, b, c = (place_traffic(streets, np.random.default_rng(s), spec) for s in (1, 1, 2))
    assert a.kind == b.kind
    np.testing.assert_array_equal(a.at(2.0).centre_m, b.at(2.0).centre_m)
    assert a.kind != c.kind


def test_nothing_is_placed_where_nothing_is_asked_for(streets: RoadNetwork) -> None:
    empty = place_traffic(streets, np.random.default_rng(0), TrafficSpec(density=0.0, queues=0.0, parked=0.0))
    assert len(empty) == 0
    assert empty.at(0.0).centre_m.shape == (0, 2)


def test_wrong_specs_are_refused(streets: RoadNetwork) -> None:
    with pytest.raises(ValueError, match=r"TrafficSpec.parked: expected a part in 0..1, got 2"):
        TrafficSpec(parked=2.0)
    with pytest.raises(ValueError, match="duration_s >= 0"):
        TrafficSpec(duration_s=-1.0)
    with pytest.raises(ValueError, match="edge 9999 is none of the network's"):
        place_traffic(streets, np.random.default_rng(0), TrafficSpec(jammed=frozenset({9999})))
