"""Placing vehicles on a road network: free flow, jams, queues at stop lines, and parked along streets and in lots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sim.aerial_traffic import STATES, Traffic
from sim.meshes.shapes import SHAPES
from sim.roads.lanes import Lane, lanes, setbacks
from sim.roads.network import Road, RoadNetwork
from sim.roads.paths import Paths, paths

Array = np.ndarray

DRIVING, JAM, PARKED = range(len(STATES))

# Kinds of cars and their parts of all cars; lorries and buses have a part of their own.
_CARS = (("sedan", 0.34), ("hatchback", 0.32), ("estate", 0.24), ("van", 0.10))
_HEAVY = (("lorry", 0.85), ("bus", 0.15))
# Free speed [m/s] by class; on motorways by lane from the right, where lorries stay. Each driver's own: 6 %.
_MOTORWAY_MPS, _SPEED_MPS = (27.0, 33.0, 38.0), (30.0, 30.0, 14.5, 13.0, 9.0)
_LORRY_MPS, _SCATTER = 23.0, 0.06
# Mean headway [s] by class, of which so much is kept from bumper to bumper; gaps standing in a queue [m].
_HEADWAY_S, _LEAST_S, _GAP_M = (4.0, 4.5, 7.0, 12.0, 40.0), 1.0, (1.5, 4.0)
_JAM_MPS, _JAM_HEADWAY_S = (0.3, 3.0), 0.8
# Length of a parking place along the kerb, and how exactly drivers keep to it (across, along, heading).
_PLACE_M, _PARKING_SIGMA = 6.2, (0.08, 0.25, 0.012)
_CORNER_M = 5.0
# How often drivers are tried instead of those left out.
_ROUNDS = 3
_BAY_M, _AISLE_M = (2.5, 5.0), 6.0


@dataclass(frozen=True)
class ParkingLot:
    """A rectangle [m] of parking bays: rows along its length, two rows to an aisle.

    ``heading`` [rad] of the length, clockwise from +y.
    """

    centre_m: tuple[float, float]
    heading: float
    length_m: float
    width_m: float


@dataclass(frozen=True)
class TrafficSpec:
    """How much traffic there is.

    duration_s  vehicles keep apart, and enter at the network's edges, from t = 0 until then.
    density     factor of the number of driving vehicles (1: mean headways from 4 s on a motorway's lane to 40 s in a
                local street).
    lorries     part of lorries and buses among driving vehicles; on motorways they keep to the right lane.
    jammed      edges of the network whose lanes are full, at 0.3 to 3 m/s.
    queues      part of the lanes leading to a junction with two to six vehicles standing in front of it.
    parked      occupied part of parking places along streets and in lots.

    Raises
        ValueError: a part outside 0..1, a negative duration or density.
    """

    duration_s: float = 60.0
    density: float = 1.0
    lorries: float = 0.1
    jammed: frozenset[int] = frozenset()
    queues: float = 0.15
    parked: float = 0.6
    lots: tuple[ParkingLot, ...] = field(default=())

    def __post_init__(self) -> None:
        for name in ("lorries", "queues", "parked"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"TrafficSpec.{name}: expected a part in 0..1, got {getattr(self, name)}")
        if not (self.duration_s >= 0 and self.density >= 0):
            raise ValueError(
                f"TrafficSpec: expected duration_s >= 0 and density >= 0, got {self.duration_s} and {self.density}"
            )


def place_traffic(network: RoadNetwork, rng: np.random.Generator, spec: TrafficSpec | None = None) -> Traffic:
    """Vehicles of a network that never touch each other within the duration.

    Drivers keep their speed and way, right of way is not modelled: whoever would meet a parked, standing or earlier
    placed vehicle is left out, and others are tried instead. Where no lane follows, vehicles leave.

    Raises
        ValueError: a jammed edge that the network does not have.
    """
    spec = spec or TrafficSpec()
    unknown = sorted(k for k in spec.jammed if not 0 <= k < len(network.edges))
    if unknown:
        raise ValueError(f"TrafficSpec.jammed: edge {unknown[0]} is none of the network's {len(network.edges)}")
    all_lanes = lanes(network)
    ways = paths(network, all_lanes, max(_MOTORWAY_MPS) * (1 + 3 * _SCATTER) * spec.duration_s)
    placing = _Placing(network, rng, spec, ways)
    for lot in spec.lots:
        placing.park_in(lot)
    for road, (begin, end) in zip(network.edges, setbacks(network), strict=True):
        placing.park_along(road, begin + _CORNER_M, road.length_m - end - _CORNER_M)
    tails = [placing.stand(k, lane) for k, lane in enumerate(all_lanes)]
    traffic = placing.traffic().without_collisions(spec.duration_s)
    wanted = 0
    for _ in range(_ROUNDS):
        more = placing.free_flow(all_lanes, tails)
        wanted = wanted or len(more)
        kept = traffic.joined(more).without_collisions(spec.duration_s)
        new = np.arange(len(traffic), len(kept))
        short = wanted - int(np.count_nonzero(traffic.state == DRIVING))
        traffic = kept.of(np.concatenate([np.arange(len(traffic)), np.sort(rng.permutation(new)[: max(short, 0)])]))
    return traffic


@dataclass
class _Placing:
    """The vehicles of one network, collected kind by kind of placement; earlier ones have priority."""

    network: RoadNetwork
    rng: np.random.Generator
    spec: TrafficSpec
    ways: Paths
    rows: list[tuple[str, int, int, float, float, Array, Array]] = field(default_factory=list)

    def moving(self, kind: str, state: int, path: int, start: float, speed: float) -> None:
        self.rows.append((kind, state, path, start, speed, np.full(2, np.nan), np.full(2, np.nan)))

    def parked(self, place: Array, direction: Array) -> None:
        self.rows.append((self.kind(0.0), PARKED, -1, 0.0, 0.0, place, direction / np.hypot(*direction)))

    def traffic(self) -> Traffic:
        kind, state, path, start, speed, place, direction = zip(*self.rows, strict=True) if self.rows else [()] * 7
        return Traffic(
            tuple(kind),
            np.reshape([SHAPES[k].size_m for k in kind], (-1, 3)).astype(float),
            np.array(state, int),
            np.array(path, int),
            np.array(start, float),
            np.array(speed, float),
            np.reshape(place, (-1, 2)).astype(float),
            np.reshape(direction, (-1, 2)).astype(float),
            self.ways,
        )

    def free_flow(self, all_lanes: Sequence[Lane], tails: Sequence[float]) -> Traffic:
        """Drivers on all lanes that are not jammed."""
        self.rows.clear()
        for k, lane in enumerate(all_lanes):
            if lane.edge not in self.spec.jammed:
                self.drive(k, lane, tails[k], enters=k not in self.ways.after)
        return self.traffic()

    def kind(self, heavy: float) -> str:
        names, parts = zip(*(_HEAVY if self.rng.random() < heavy else _CARS), strict=True)
        return str(names[self.rng.choice(len(names), p=parts)])

    def park_along(self, road: Road, begin: float, end: float) -> None:
        count = int((end - begin) // _PLACE_M)
        if road.parking_m <= 0 or count < 1:
            return
        stations = begin + (end - begin - count * _PLACE_M) / 2 + _PLACE_M * (np.arange(count) + 0.5)
        for side in (-1, 1):
            # In driving direction of the kerb's side; in a oneway street all the same way.
            ahead = 1 if road.oneway or side < 0 else -1
            offset = side * (road.width_m - road.parking_m) / 2
            for s in stations[self.rng.random(count) < self.spec.parked]:
                across, along, turn = self.rng.normal(0, _PARKING_SIGMA)
                p, d = road.at(np.array(s + along))
                left = np.array([-d[1], d[0]])
                self.parked(p + (offset + across) * left, ahead * (d + turn * left))

    def park_in(self, lot: ParkingLot) -> None:
        along = np.array([np.sin(lot.heading), np.cos(lot.heading)])
        left = np.array([-along[1], along[0]])
        width, depth = _BAY_M
        module = 2 * depth + _AISLE_M
        rows = (np.arange(int(lot.width_m // module)) + 0.5) * module - lot.width_m / 2
        places = (np.arange(int(lot.length_m // width)) + 0.5) * width - lot.length_m / 2
        for v in np.add.outer(rows, [-(_AISLE_M + depth) / 2, (_AISLE_M + depth) / 2]).ravel():
            for u in places[self.rng.random(len(places)) < self.spec.parked]:
                across, inwards, turn = self.rng.normal(0, _PARKING_SIGMA)
                nose = left * (1 if self.rng.random() < 0.5 else -1)
                place = np.array(lot.centre_m) + (u + across) * along + (v + 0.5 * inwards) * left
                self.parked(place, nose + turn * along)

    def stand(self, k: int, lane: Lane) -> float:
        """Fills a jammed lane, or lets some wait at its end; returns the station of the last one's tail."""
        rng, length = self.rng, float(self.ways.lane_m[k])
        node = self.network.ends[lane.edge][1 if lane.forward else 0]
        if lane.edge in self.spec.jammed:
            count, speed = int(length), rng.uniform(*_JAM_MPS)
        elif (
            self.network.degree[node] >= 3
            and self.network.edges[lane.edge].road_class >= 2
            and rng.random() < self.spec.queues
        ):
            count, speed = int(rng.integers(2, 7)), 0.0
        else:
            return length
        front = length - 1.0
        for _ in range(count):
            kind = self.kind(self.spec.lorries if lane.number == 0 else 0.0)
            size = SHAPES[kind].size_m[0]
            if front < size:
                break
            self.moving(kind, JAM, k, front - size / 2, speed)
            front -= size + rng.uniform(*_GAP_M) + _JAM_HEADWAY_S * speed
        return front

    def drive(self, k: int, lane: Lane, end: float, enters: bool) -> None:
        """Free flow on a lane, from its end backwards, and those that are still to come where the network begins."""
        cls, duration = self.network.edges[lane.edge].road_class, self.spec.duration_s
        if self.spec.density == 0:
            return
        wait = max(_HEADWAY_S[cls] / self.spec.density - _LEAST_S, 0.2 * _LEAST_S)
        front, speed_ahead = end, 0.0
        while True:
            kind = self.kind(self.spec.lorries if cls > 1 or lane.number == 0 else 0.0)
            size, speed = SHAPES[kind].size_m[0], self.speed(cls, lane, kind)
            # Who is faster must not catch up within the duration.
            closing = max(speed - speed_ahead, 0.0) * duration if speed_ahead else 0.0
            start = front - self.rng.exponential(wait) * speed - closing - size / 2
            if start + speed * duration * enters < size / 2:
                return
            self.moving(kind, DRIVING, k, start, speed)
            front, speed_ahead = start - size / 2 - _LEAST_S * speed, speed

    def speed(self, cls: int, lane: Lane, kind: str) -> float:
        if cls > 1:
            typical = _SPEED_MPS[cls]
        elif kind in dict(_HEAVY):
            typical = _LORRY_MPS
        else:
            typical = _MOTORWAY_MPS[min(lane.number, len(_MOTORWAY_MPS) - 1)]
        return float(typical * (1 + _SCATTER * np.clip(self.rng.normal(), -3, 3)))
