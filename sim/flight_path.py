"""Where an aircraft flies: straight lines joined by the shortest turns of a bank angle, as positions over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

Array = np.ndarray
GRAVITY = 9.81

# One (signed curvature [1/m], length [m]) after the other; positive curvature turns left.
Arcs = list[tuple[float, float]]


@dataclass(frozen=True)
class FlightLine:
    """A straight and level line from start_m to end_m (x, y) in the world, at a height z [m] and a ground speed [m/s].

    Raises
        ValueError: a line without length, a speed that is not positive.
    """

    start_m: tuple[float, float]
    end_m: tuple[float, float]
    height_m: float
    speed_mps: float

    def __post_init__(self) -> None:
        if not self.length_m > 0:
            raise ValueError(f"FlightLine: start_m and end_m are the same point {self.start_m}")
        if not self.speed_mps > 0:
            raise ValueError(f"FlightLine.speed_mps: expected > 0, got {self.speed_mps}")

    @property
    def length_m(self) -> float:
        return float(np.hypot(*np.subtract(self.end_m, self.start_m)))

    @property
    def direction(self) -> float:
        """Angle [rad] from +x (grid east), counter-clockwise."""
        dx, dy = np.subtract(self.end_m, self.start_m)
        return float(np.arctan2(dy, dx))


def approaches(
    centre_m: tuple[float, float],
    length_m: float,
    height_m: float,
    speed_mps: float,
    headings_deg: Sequence[float] = (0.0, 90.0, 180.0, 270.0),
) -> tuple[FlightLine, ...]:
    """Lines over one place from several directions, by default the four of Kozempel 2012, 3.3 (grid headings)."""
    lines = []
    for heading in np.deg2rad(headings_deg):
        half = 0.5 * length_m * np.array([np.sin(heading), np.cos(heading)])
        (x0, y0), (x1, y1) = centre_m - half, centre_m + half
        lines.append(FlightLine((float(x0), float(y0)), (float(x1), float(y1)), height_m, speed_mps))
    return tuple(lines)


def block(first: FlightLine, spacing_m: float, count: int) -> tuple[FlightLine, ...]:
    """Parallel lines flown to and fro, each spacing_m [m] to the right of the one before as seen along the first."""
    right = spacing_m * np.array([np.sin(first.direction), -np.cos(first.direction)])
    lines = []
    for i in range(count):
        ends = [tuple((np.array(end) + i * right).tolist()) for end in (first.start_m, first.end_m)]
        start, end = ends if i % 2 == 0 else ends[::-1]
        lines.append(replace(first, start_m=start, end_m=end))
    return tuple(lines)


def turn_radius(speed_mps: float, bank: float) -> float:
    """Radius [m] of a coordinated turn, ``v² / (g tan(bank))``."""
    return speed_mps**2 / (GRAVITY * float(np.tan(bank)))


def shortest_turn(start: Array, direction: float, end: Array, end_direction: float, radius_m: float) -> Arcs:
    """The shortest way of bounded curvature between two directed points (Dubins 1957), turn - straight - turn.

    Ways of three turns, shorter only where the points are closer than four radii, are left out: an aircraft levels out.
    """
    best: Arcs = []
    for first in (1, -1):
        for second in (1, -1):
            arcs = _turn_straight_turn(start, direction, end, end_direction, radius_m, first, second)
            if arcs and (not best or sum(a[1] for a in arcs) < sum(a[1] for a in best)):
                best = arcs
    return best


def _turn_straight_turn(
    start: Array, direction: float, end: Array, end_direction: float, radius: float, first: int, second: int
) -> Arcs:
    """One of the four candidates; first, second +1 for a left turn. Empty where the circles overlap."""

    def left(a: float) -> Array:
        return np.array([-np.sin(a), np.cos(a)])

    between = (end + second * radius * left(end_direction)) - (start + first * radius * left(direction))
    distance = float(np.hypot(*between))
    if first != second and distance < 2 * radius:
        return []
    # The common tangent: parallel to the line of centres, or crossing it.
    across = 0.0 if first == second else float(np.arcsin(2 * radius / distance))
    tangent = float(np.arctan2(between[1], between[0])) + first * across
    straight = distance * float(np.cos(across))
    a, b = _turned(first * (tangent - direction)), _turned(second * (end_direction - tangent))
    return [(first / radius, a * radius), (0.0, straight), (second / radius, b * radius)]


def _turned(angle: float) -> float:
    """Angle in [0, 2π), without a full circle for what is zero but for rounding."""
    a = angle % (2 * np.pi)
    return float(a) if a < 2 * np.pi - 1e-9 else 0.0


def trace(start: Array, direction: float, arcs: Arcs, s_m: Float[Array, "n"]) -> Float[Array, "n 2"]:
    """Positions at the arc lengths s_m >= 0 along a way of arcs; the last goes on beyond its end."""
    bounds = np.concatenate([[0.0], np.cumsum([length for _, length in arcs])])
    out = np.empty((len(s_m), 2))
    owner = np.clip(np.searchsorted(bounds, s_m, side="right") - 1, 0, len(arcs) - 1)
    for i, (curvature, length) in enumerate(arcs):
        own = owner == i
        out[own] = start + _chord(direction, curvature, s_m[own] - bounds[i])
        start = start + _chord(direction, curvature, np.array([length]))[0]
        direction += curvature * length
    return out


def _chord(direction: float, curvature: float, s: Array) -> Array:
    """From the start of an arc to its points at the lengths s."""
    half = 0.5 * curvature * s
    chord = s * np.sinc(half / np.pi)
    return np.stack([chord * np.cos(direction + half), chord * np.sin(direction + half)], axis=-1)


@dataclass(frozen=True, eq=False)
class Piece:
    """A way of arcs flown from one speed [m/s] to another, linear in time, and height [m], linear along the way."""

    start: Float[Array, "2"]
    direction: float
    arcs: Arcs
    speeds: tuple[float, float]
    heights: tuple[float, float]

    @property
    def length_m(self) -> float:
        return sum(length for _, length in self.arcs)

    @property
    def duration_s(self) -> float:
        return 2 * self.length_m / sum(self.speeds)

    def at(self, t_s: Float[Array, "n"]) -> Float[Array, "n 3"]:
        """Positions at times since the piece's begin."""
        (v0, v1), (z0, z1), T = self.speeds, self.heights, self.duration_s
        s = v0 * t_s + (v1 - v0) * t_s**2 / (2 * T)
        z = z0 + (z1 - z0) * s / self.length_m
        return np.column_stack([trace(self.start, self.direction, self.arcs, s), z])


def along(line: FlightLine, before_s: float, behind_s: float) -> Piece:
    """A flight line, begun earlier and flown on for some seconds."""
    unit = np.array([np.cos(line.direction), np.sin(line.direction)])
    start = np.array(line.start_m) - line.speed_mps * before_s * unit
    length = line.length_m + line.speed_mps * (before_s + behind_s)
    v, z = line.speed_mps, line.height_m
    return Piece(start, line.direction, [(0.0, length)], (v, v), (z, z))


def joining(one: Piece, other: Piece, bank: float, steepest: float) -> Piece:
    """The turn between two pieces, for the faster one's radius; full circles first where it climbs too steeply."""
    end = one.at(np.array([one.duration_s]))[0]
    radius = turn_radius(max(one.speeds[1], other.speeds[0]), bank)
    arcs = shortest_turn(end[:2], one.direction, other.start, other.direction, radius)
    climb_m = abs(other.heights[0] - one.heights[1])
    missing = climb_m / steepest - sum(length for _, length in arcs)
    circles = max(0, int(np.ceil(missing / (2 * np.pi * radius))))
    curvature, length = arcs[0]
    arcs[0] = (curvature, length + circles * 2 * np.pi * radius)
    return Piece(end[:2], one.direction, arcs, (one.speeds[1], other.speeds[0]), (one.heights[1], other.heights[0]))
