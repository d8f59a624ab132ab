"""Road networks: nodes where roads meet, cutting to 400 m, clipping, sampling, RAS-Q widths."""

from __future__ import annotations

import numpy as np
import pytest

from sim.roads import SECTIONS, Road, RoadNetwork, map_width_m, section


def road(*points: tuple[float, float], cls: int = 4, lanes: int = 2, oneway: bool = False, name: str = "") -> Road:
    return Road.standard(np.array(points, float), cls, lanes, oneway, name)


def cross() -> RoadNetwork:
    return RoadNetwork.of(
        [road((-100, 0), (0, 0), (100, 0), cls=3, name="east"), road((0, -80), (0, 0), (0, 90), name="north")]
    )


def test_parts_of_every_section_add_up_to_its_name() -> None:
    for s in SECTIONS:
        sides = 2 if s.divided else 1
        total = sides * (s.paved_m(s.lanes) + (2 * s.verge_m if not s.divided else 0)) + s.median_m
        if s.divided:
            # The verge lies outside only; the median is the carriageways' inner side.
            total += 2 * s.verge_m
        assert total == pytest.approx(s.total_m)
        assert float(s.name.removeprefix("RQ ")) == s.total_m
        assert 2.75 <= s.lane_m <= 3.75


def test_map_widths_are_the_sources() -> None:
    assert [map_width_m(k) for k in range(5)] == [38.5, 32.5, 23.0, 13.5, 10.5]
    assert [map_width_m(k, carriageway=True) for k in range(5)] == [19.0, 16.0, 12.0, 13.5, 10.5]
    assert map_width_m(4, margin_m=0.0) == 7.5
    with pytest.raises(ValueError, match=r"expected 0 \(motorway\) to 4"):
        section(5)


def test_roads_are_cut_where_they_share_a_vertex() -> None:
    net = cross()
    assert len(net.edges) == 4
    assert len(net.nodes_m) == 5
    assert sorted(net.degree) == [1, 1, 1, 1, 4]
    assert net.length_m == pytest.approx(370)
    assert net.bounds_m == (-100, -80, 100, 90)
    assert [e.name for e in net.edges] == ["east", "east", "north", "north"]


def test_an_end_on_a_vertex_cuts_and_a_crossing_without_one_does_not() -> None:
    tee = RoadNetwork.of([road((-100, 0), (0, 0), (100, 0)), road((0, 0), (0, 50))])
    assert (len(tee.edges), sorted(tee.degree)) == (3, [1, 1, 1, 3])
    bridge = RoadNetwork.of([road((-100, 0), (100, 0)), road((0, -50), (0, 50))])
    assert (len(bridge.edges), sorted(bridge.degree)) == (2, [1, 1, 1, 1])


def test_rings_and_nearly_equal_ends_meet() -> None:
    ring = RoadNetwork.of([road((0, 0), (10, 0), (10, 10), (0, 0), oneway=True)])
    assert len(ring.edges) == 1
    assert ring.ends.tolist() == [[0, 0]]
    near = RoadNetwork.of([road((0, 0), (10, 0)), road((10.002, 0.001), (20, 0))])
    assert sorted(near.degree) == [1, 1, 2]
    np.testing.assert_array_equal(near.edges[1].line_m[0], near.edges[0].line_m[-1])
    assert RoadNetwork.of([road((0, 0), (0.004, 0), (10, 0))]).length_m == pytest.approx(10, abs=0.01)


@pytest.mark.parametrize("length", [399.0, 400.0, 400.5, 1234.5])
def test_edges_are_cut_in_equal_parts_of_at_most_400_m(length: float) -> None:
    bent = road((0, 0), (0.3 * length, 0), (0.3 * length, 0.7 * length), name="long", cls=1, oneway=True)
    cut = RoadNetwork.of([bent]).cut()
    lengths = [e.length_m for e in cut.edges]
    assert len(lengths) == int(np.ceil(length / 400))
    np.testing.assert_allclose(lengths, length / len(lengths), rtol=1e-9)
    joined = np.concatenate([e.line_m for e in cut.edges])
    assert any(np.allclose(p, bent.line_m[1]) for p in joined)
    assert all((e.name, e.oneway, e.width_m) == ("long", True, bent.width_m) for e in cut.edges)
    assert (np.asarray(cut.ends[1:, 0]) == cut.ends[:-1, 1]).all()


def test_clipping_keeps_what_lies_inside() -> None:
    net = RoadNetwork.of([road((-100, 0), (0, 0), (10, 30), (20, 0), (100, 0)), road((200, 0), (300, 0))])
    inside = net.clip((-50, -10, 50, 20))
    # The tip of the bend lies outside, so two pieces are left of one road and none of the other.
    assert len(inside.edges) == 2
    # Of each side of the bend, (10, 30) long, 20 of 30 in y.
    assert inside.length_m == pytest.approx(50 + 30 + 2 * np.hypot(10, 30) * 20 / 30)
    x0, y0, x1, y1 = inside.bounds_m
    assert (x0, y0, x1, y1) == pytest.approx((-50, 0, 50, 20))
    assert not net.clip((1000, 1000, 1001, 1001)).edges


def test_samples_lie_on_the_line_at_equal_steps() -> None:
    net = cross()
    s = net.sample(7.0)
    for k, edge in enumerate(net.edges):
        mine = s.edge == k
        steps = np.diff(s.station_m[mine])
        assert steps.max() <= 7.0
        np.testing.assert_allclose(steps, edge.length_m / mine.sum(), rtol=1e-9)
        along = s.xy_m[mine] - edge.line_m[0]
        np.testing.assert_allclose(np.sum(along * s.direction[mine], axis=1), s.station_m[mine], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(s.direction, axis=1), 1)
    assert not len(RoadNetwork.of([]).sample(1.0).xy_m)


def test_pieces_of_one_road_are_joined_and_others_are_not() -> None:
    def pieces(oneway: bool, *names: str) -> RoadNetwork:
        xs = [(0, 0), (10, 1), (20, 0), (30, 2)]
        lines = [xs[:2], xs[2:0:-1], xs[2:]]
        roads = [road(*p, name=n, oneway=oneway) for p, n in zip(lines, names, strict=True)]
        return RoadNetwork.of(roads).joined()

    assert len(pieces(False, "a", "a", "a").edges) == 1
    assert len(pieces(False, "a", "b", "a").edges) == 3
    # The middle piece is driven the other way.
    assert len(pieces(True, "a", "a", "a").edges) == 3
    tee = RoadNetwork.of([road((0, 0), (10, 0), name="x"), road((10, 0), (20, 0), name="x"), road((10, 0), (10, 5))])
    assert len(tee.joined().edges) == 3
    assert tee.joined().length_m == pytest.approx(25)


def test_wrong_roads_are_refused() -> None:
    with pytest.raises(ValueError, match="two points"):
        road((0, 0), (0, 0))
    with pytest.raises(ValueError, match="finite line"):
        road((0, 0), (np.nan, 1))
    with pytest.raises(ValueError, match="too narrow for 3 lanes"):
        Road(np.array([[0.0, 0], [1, 0]]), 4, 3, False, 6.0)
    with pytest.raises(ValueError, match="at least 1 lane"):
        road((0, 0), (1, 0), lanes=0)
    with pytest.raises(ValueError, match="longest_m"):
        cross().cut(0.0)
    with pytest.raises(ValueError, match="no roads"):
        _ = RoadNetwork.of([]).bounds_m
