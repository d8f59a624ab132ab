"""Ways through a network: continuous, without kinks, over lanes that follow each other."""

from __future__ import annotations

import numpy as np
import pytest

from sim.roads import Road, RoadNetwork, lanes
from sim.roads.paths import paths
from sim.roads.town import town


def cross() -> RoadNetwork:
    return RoadNetwork.of(
        [
            Road.standard(np.array([[-100.0, 0], [0, 0], [100, 0]]), 3, 2, False),
            Road.standard(np.array([[0.0, -100], [0, 0], [0, 100]]), 3, 2, False),
        ]
    )


def test_traffic_goes_straight_on_across_a_junction() -> None:
    net = cross()
    all_lanes = lanes(net)
    ways = paths(net, all_lanes, 500.0)
    assert len(ways.length_m) == 8
    for k, lane in enumerate(all_lanes):
        begin, end = ways.at(np.array([k, k]), np.array([0.0, ways.length_m[k]]))
        inwards = np.hypot(*lane.line_m[-1]) < 10
        assert (ways.after[k] >= 0) == inwards
        assert ways.length_m[k] == pytest.approx(200 if inwards else ways.lane_m[k], abs=0.01)
        # Straight: the whole way keeps its distance of half a lane from the axis.
        d = (end - begin) / np.hypot(*(end - begin))
        assert abs(begin[0] * d[1] - begin[1] * d[0]) == pytest.approx(1.75)


def test_a_way_turns_where_nothing_goes_straight_on() -> None:
    tee = RoadNetwork.of(
        [
            Road.standard(np.array([[-100.0, 0], [0, 0], [100, 0]]), 3, 2, False),
            Road.standard(np.array([[0.0, -80], [0, 0]]), 4, 1, True),
        ]
    )
    ways = paths(tee, lanes(tee), 500.0)
    (k,) = [k for k, lane in enumerate(lanes(tee)) if lane.edge == 2]
    end = ways.at(np.array([k]), np.array([ways.length_m[k]]))[0]
    assert abs(end[0]) == pytest.approx(100)
    # Traffic keeps to the right: above the axis to the west, below to the east.
    assert np.sign(end[1]) == -np.sign(end[0])


@pytest.mark.parametrize("seed", range(3))
def test_ways_are_continuous_and_without_kinks(seed: int) -> None:
    net = town(np.random.default_rng(seed))
    all_lanes = lanes(net)
    ways = paths(net, all_lanes, 300.0)
    assert (ways.length_m >= ways.lane_m - 1e-9).all()
    for k, lane in enumerate(all_lanes):
        line = ways.vertices_m[ways.first[k] : ways.first[k + 1]]
        steps = np.diff(line, axis=0)
        heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        # Vertices lie 1 m apart in the curves: less than 90 degrees from one to the next, for cars can follow.
        assert np.abs(np.diff(heading)).max(initial=0.0) < np.pi / 2
        if ways.after[k] >= 0:
            here, there = all_lanes[k], all_lanes[ways.after[k]]
            node = net.ends[here.edge][1 if here.forward else 0]
            assert net.ends[there.edge][0 if there.forward else 1] == node
        assert np.hypot(*(line[0] - lane.line_m[0])) < 70


def test_longest_bounds_the_way_behind_the_lane() -> None:
    net = town(np.random.default_rng(0))
    all_lanes = lanes(net)
    short = paths(net, all_lanes, 0.0)
    np.testing.assert_allclose(short.length_m, short.lane_m)
    far = paths(net, all_lanes, 400.0)
    grown = far.length_m - far.lane_m
    assert grown[far.after >= 0].min() > 0
    assert np.median(grown) >= 400
    assert len(paths(RoadNetwork.of([]), [], 10.0).length_m) == 0
