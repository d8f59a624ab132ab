"""Lanes and markings of roads: on the pavement, in driving direction, off the junctions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapely

from sim.roads import Lane, Marking, Road, RoadNetwork, lanes, markings, offset_line, section
from sim.roads.lanes import lane_borders, setbacks
from sim.roads.markings import dashes

STRAIGHT = np.array([[0.0, 0], [300, 0]])


def only(road: Road) -> RoadNetwork:
    return RoadNetwork.of([road])


def of_kind(marks: tuple[Marking, ...], kind: str) -> list[Marking]:
    return [m for m in marks if m.kind == kind]


@pytest.mark.parametrize(
    ("cls", "count", "oneway"), [(0, 3, True), (1, 2, True), (2, 4, False), (3, 2, False), (4, 1, False)]
)
def test_lanes_keep_right_and_have_the_class_width(cls: int, count: int, oneway: bool) -> None:
    road = Road.standard(STRAIGHT, cls, count, oneway, parking_m=2.0 if cls == 4 else 0.0)
    found = lanes(only(road))
    assert len(found) == count
    for lane in found:
        assert lane.width_m == pytest.approx(section(cls).lane_m)
        y = lane.line_m[0, 1]
        assert (lane.line_m[-1, 0] > lane.line_m[0, 0]) == lane.forward
        if not oneway and count > 1:
            assert (y < 0) == lane.forward
        assert abs(y) + lane.width_m / 2 <= road.width_m / 2 + 1e-9
    ahead = sorted((x for x in found if x.forward), key=lambda x: x.number)
    # Number 0 is the rightmost: y falls to the right of a road that runs east.
    assert all(a.line_m[0, 1] < b.line_m[0, 1] for a, b in pairwise(ahead))


def test_the_hard_shoulder_lies_at_the_right() -> None:
    road = Road.standard(STRAIGHT, 1, 2, True)
    borders = lane_borders(road)
    assert road.width_m == pytest.approx(11.5)
    np.testing.assert_allclose(borders, [5.0, 1.25, -2.5])


def test_narrow_roads_share_what_there_is() -> None:
    np.testing.assert_allclose(lane_borders(Road(STRAIGHT, 3, 2, False, 5.0)), [2.5, 0, -2.5])
    np.testing.assert_allclose(lane_borders(Road(STRAIGHT, 4, 2, False, 9.0, parking_m=2.0)), [2.5, 0, -2.5])


def test_offsets_are_parallel_and_keep_the_direction() -> None:
    bend = np.array([[0.0, 0], [50, 0], [80, 40], [80, 100]])
    for left in (-3.0, 0.0, 3.0):
        line = offset_line(bend, left)
        far = shapely.LineString(bend)
        for p in shapely.points(shapely.get_coordinates(shapely.segmentize(shapely.LineString(line), 1.0))):
            # A mitre stands off by 1 / cos of half the bend: at most 27 degrees here.
            assert abs(left) - 1e-9 <= far.distance(p) <= abs(left) / np.cos(np.deg2rad(27)) + 1e-9
        assert (line[-1] - line[0]) @ (bend[-1] - bend[0]) > 0
    assert len(offset_line(np.array([[0.0, 0], [5, 0], [5, 5], [0, 5], [0, 0.5]]), 4.0)) == 0


def test_a_bend_that_swallows_a_lane_leaves_it_out() -> None:
    hook = Road.standard(np.array([[0.0, 0], [3, 0], [3, 3], [0, 3], [0, 0.5]]), 2, 4, False)
    kept: tuple[Lane, ...] = lanes(only(hook))
    assert len(kept) < 4


def test_dashes_follow_the_line_with_stroke_and_gap() -> None:
    line = np.array([[0.0, 0], [50, 0], [50, 50]])
    strokes = dashes(line, 3.0, 6.0)
    assert len(strokes) == 11
    lengths = [shapely.LineString(s).length for s in strokes]
    np.testing.assert_allclose(lengths, 3.0, atol=1e-9)
    whole = shapely.LineString(line)
    starts = np.array([whole.project(shapely.Point(s[0])) for s in strokes])
    np.testing.assert_allclose(np.diff(starts), 9.0)
    assert starts[0] == pytest.approx(100 - starts[-1] - 3)
    assert dashes(np.array([[0.0, 0], [2, 0]]), 3.0, 6.0) == []


def test_strokes_lie_on_the_pavement_beside_and_between_lanes() -> None:
    for cls, count, oneway in [(0, 3, True), (2, 4, False), (3, 2, False)]:
        road = Road.standard(STRAIGHT, cls, count, oneway)
        marks = markings(only(road))
        assert len(of_kind(marks, "edge")) == 2
        assert len({round(m.line_m[0, 1], 6) for m in marks}) == count + 1
        for m in marks:
            assert abs(m.line_m[0, 1]) + m.width_m / 2 <= road.width_m / 2 + 1e-9
        assert len(of_kind(marks, "centre")) == (0 if oneway else 1 if count == 4 else 25)
    assert markings(only(Road.standard(STRAIGHT, 4, 1, False))) == ()
    street = markings(only(Road.standard(STRAIGHT, 4, 2, False)))
    assert {m.kind for m in street} == {"centre"}
    assert len(street) == 34  # 34 strokes of 3 m and 33 gaps of 6 m


def junction(angle_deg: float) -> RoadNetwork:
    d = 120 * np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    major = Road.standard(np.array([[-150.0, 0], [0, 0], [150, 0]]), 2, 4, False)
    minor = Road.standard(np.array([[0.0, 0], d / 2, d]), 3, 2, False)
    return RoadNetwork.of([major, minor])


@pytest.mark.parametrize("angle", [90.0, 60.0, 45.0, 130.0])
def test_junctions_stay_free_and_the_minor_road_stops(angle: float) -> None:
    net = junction(angle)
    marks = markings(net)
    major = shapely.LineString([(-150, 0), (150, 0)]).buffer(net.edges[0].width_m / 2, cap_style="flat")
    (stop,) = of_kind(marks, "stop")
    assert stop.edge == 2
    strokes = [shapely.LineString(m.line_m).buffer(m.width_m / 2, cap_style="flat") for m in marks if m.edge == 2]
    assert max(s.intersection(major).area for s in strokes) < 1e-6
    # Across the lane that leads in: from the middle to the right edge of the lanes, seen towards the junction.
    assert shapely.LineString(stop.line_m).length == pytest.approx(3.5)
    d = net.edges[2].line_m[-1] / np.linalg.norm(net.edges[2].line_m[-1])
    right_when_arriving = np.array([-d[1], d[0]])
    assert (stop.line_m @ right_when_arriving).min() > -1e-9


def test_setbacks_are_those_of_overlapping_strips() -> None:
    free = setbacks(junction(90.0))
    np.testing.assert_allclose(free[2], [junction(90.0).edges[0].width_m / 2, 0])
    assert free.max() <= 60
    assert (setbacks(only(Road.standard(STRAIGHT, 3, 2, False))) == 0).all()


def test_ramps_merge_into_motorways_without_stopping() -> None:
    carriageway = Road.standard(np.array([[-300.0, 0], [0, 0], [300, 0]]), 0, 3, True)
    ramp = Road.standard(np.array([[-200.0, -40], [-100, -12], [0, 0]]), 3, 1, True)
    net = RoadNetwork.of([carriageway, ramp])
    marks = markings(net)
    assert not of_kind(marks, "stop")
    free = setbacks(net)
    np.testing.assert_array_equal(free[:2], 0)
    # atan(12 / 100) at half widths of 7.25 and 2 m would be 77 m.
    assert free[2].tolist() == [0, 60]
