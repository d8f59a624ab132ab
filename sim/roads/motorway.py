"""Procedural motorways: two carriageways along clothoids, rest areas beside them, and the way into a town."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from sim.roads.cross_section import section
from sim.roads.lanes import offset_line
from sim.roads.network import Road, RoadNetwork, along
from sim.roads.town import town

Array = np.ndarray

_VERTEX_M = 10.0
# Between two knots the curvature is linear: a clothoid. No curve is tighter than the radius.
_KNOT_M, _RADIUS_M = 500.0, 1200.0
# Where the heading is farther off than this, the next curve leads back.
_WANDER = np.deg2rad(12.0)
# A ramp moves over by its distance within this length; a rest area's lane runs along for another.
_RAMP_M, _REST_M, _REST_OFF_M = 260.0, 160.0, 45.0
# A town begins this far from the motorway's middle, and its ramps meet its main road this far from the carriageway's.
_TOWN_OFF_M, _APEX_M = 220.0, 90.0


def motorway(
    rng: np.random.Generator,
    *,
    length_m: float = 3000.0,
    heading: float = np.pi / 2,
    centre_m: tuple[float, float] = (0.0, 0.0),
    lanes: int = 3,
    rest_areas: bool = True,
) -> RoadNetwork:
    """Two carriageways of 2 or 3 lanes (RQ 29.5, RQ 35.5) on both sides of a bent axis about ``centre_m``.

    ``heading`` [rad] is clockwise from +y. With ``rest_areas`` an exit, a lane of its own and an entry lie to the right
    of either carriageway.

    Raises
        ValueError: other lanes than 2 or 3 a direction, a length that holds no rest area or no curve.
    """
    carriageways = _carriageways(rng, length_m, heading, np.asarray(centre_m, float), lanes)
    roads = [Road.standard(line, 0 if lanes == 3 else 1, lanes, True, "motorway") for line in carriageways]
    if rest_areas:
        for k, road in enumerate(roads.copy()):
            begin = road.length_m * (0.3 + 0.1 * k)
            roads[k] = _noded(road, begin, begin + 2 * _RAMP_M + _REST_M)
            roads += _hat(roads[k], begin, _REST_M, _REST_OFF_M)
    return RoadNetwork.of(roads).joined()


def mixed(
    rng: np.random.Generator,
    *,
    size_m: tuple[float, float] = (900.0, 700.0),
    length_m: float = 3000.0,
    lanes: int = 3,
    roundabout: bool = True,
    plaza: bool = True,
) -> RoadNetwork:
    """A town about the origin and a motorway past its southern side; the near carriageway has an exit and an entry.

    The ramps meet the prolonged main road of the town. The other carriageway has none: nothing crosses the motorway.
    """
    streets = town(rng, size_m=size_m, roundabout=roundabout, plaza=plaza)
    y0 = streets.bounds_m[1]
    first, second = _carriageways(rng, length_m, np.pi / 2, np.zeros(2), lanes)
    # The heading wanders: the whole motorway is moved until its nearest point keeps the distance from the town.
    near = np.abs(second[:, 0]) < 0.8 * size_m[0]
    shift = np.array([0.0, y0 - _TOWN_OFF_M - second[near, 1].max()])
    cls = 0 if lanes == 3 else 1
    far = Road.standard(first + shift, cls, lanes, True, "motorway")
    close = Road.standard(second + shift, cls, lanes, True, "motorway")
    main = np.concatenate([e.line_m for e in streets.edges if e.road_class == 2 and e.name.startswith("B ")])
    start = main[np.argmin(main[:, 1])]
    apex = float(close.stations_m[np.argmin(np.abs(close.line_m[:, 0] - start[0]))])
    close = _noded(close, apex - _RAMP_M, apex + _RAMP_M)
    ramps = _hat(close, apex - _RAMP_M, 0.0, _APEX_M)
    top = ramps[0].line_m[-1]
    link = Road.standard(_link(start, top), 2, 4, False, "motorway link")
    return RoadNetwork.of([*streets.edges, far, close, *ramps, link]).joined()


def _link(start: Array, end: Array) -> Float[Array, "n 2"]:
    """A smooth line from the town's edge southwards, ending at the ramps from the north."""
    u = np.linspace(0, 1, max(round(float(np.hypot(*(end - start))) / _VERTEX_M), 2) + 1)[:, None]
    d = 0.6 * np.array([0.0, end[1] - start[1]])
    line = (1 + 2 * u) * (1 - u) ** 2 * start + u * (1 - u) ** 2 * d + u**2 * (3 - 2 * u) * end + u**2 * (u - 1) * d
    line[0], line[-1] = start, end
    return np.asarray(line)


def _carriageways(
    rng: np.random.Generator, length_m: float, heading: float, centre: Array, lanes: int
) -> tuple[Float[Array, "n 2"], Float[Array, "m 2"]]:
    """Middle lines of the carriageway along the heading and of the opposite one, in driving direction."""
    if lanes not in (2, 3):
        raise ValueError(f"motorway: expected 2 or 3 lanes a direction, got {lanes}")
    shortest = 2 * (2 * _RAMP_M + _REST_M)
    if not length_m >= shortest:
        raise ValueError(f"motorway: expected a length_m of at least {shortest:g} m, got {length_m}")
    s = section(0 if lanes == 3 else 1)
    axis = _axis(rng, length_m, heading) + centre
    off = s.median_m / 2 + s.paved_m(lanes) / 2
    return offset_line(axis, -off), offset_line(axis, off)[::-1]


def _axis(rng: np.random.Generator, length_m: float, heading: float) -> Float[Array, "n 2"]:
    """A line of piecewise linear curvature through the origin at its middle."""
    knots = int(np.ceil(length_m / _KNOT_M)) + 1
    curvature = np.zeros(knots)
    turned = 0.0
    for k in range(1, knots):
        curvature[k] = rng.uniform(-1, 1) / _RADIUS_M
        if abs(turned) > _WANDER:
            curvature[k] = -np.sign(turned) * abs(curvature[k])
        turned += (curvature[k - 1] + curvature[k]) / 2 * _KNOT_M
    s = np.linspace(0, length_m, round(length_m / _VERTEX_M) + 1)
    kappa = np.interp(s, _KNOT_M * np.arange(knots), curvature)
    ds = s[1] - s[0]
    psi = np.concatenate([[0.0], np.cumsum((kappa[1:] + kappa[:-1]) / 2 * ds)])
    psi = heading - (psi - psi.mean())
    middle = (psi[1:] + psi[:-1]) / 2
    steps = ds * np.stack([np.sin(middle), np.cos(middle)], axis=1)
    p = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.asarray(p - p[len(p) // 2])


def _noded(road: Road, *stations: float) -> Road:
    """The road with vertices at stations, for others to meet it there."""
    at = np.concatenate([road.stations_m, stations])
    points = np.concatenate([road.line_m, road.at(np.array(stations))[0]])
    order = np.argsort(at, kind="stable")
    keep = np.concatenate([[True], np.diff(at[order]) > 1e-9])
    return replace(road, line_m=points[order][keep])


def _beside(road: Road, begin: float, end: float, right: Float[Array, "n"]) -> Float[Array, "n 2"]:
    """Points at equal stations, moved to the right of a road."""
    p, d = along(road.line_m, np.linspace(begin, end, len(right)))
    return np.asarray(p + right[:, None] * np.stack([d[:, 1], -d[:, 0]], axis=1))


def _hat(road: Road, begin: float, flat: float, off: float) -> list[Road]:
    """An exit that moves over by ``off``, a lane beside the road over ``flat`` metres, and an entry that moves back."""
    u = np.linspace(0, 1, round(_RAMP_M / _VERTEX_M) + 1)
    rise = off * u * u * (3 - 2 * u)
    out = _beside(road, begin, begin + _RAMP_M, rise)
    back = _beside(road, begin + _RAMP_M + flat, begin + 2 * _RAMP_M + flat, rise[::-1])
    if flat == 0:
        back[0] = out[-1]
    roads = [Road.standard(line, 3, 1, True, name) for line, name in ((out, "exit"), (back, "entry"))]
    if flat > 0:
        lane = _beside(road, begin + _RAMP_M, begin + _RAMP_M + flat, np.full(round(flat / _VERTEX_M) + 1, off))
        lane[0], lane[-1] = out[-1], back[0]
        roads.append(Road.standard(lane, 4, 2, True, "rest area"))
    return roads
