"""Traffic seen from the air: vehicles that drive along lanes, queue, or are parked, and where each is at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from sim.archive import freeze_fields
from sim.overlap import overlapping
from sim.roads.paths import Paths

Array = np.ndarray

# Chord of a vehicle's axles on its path, as a part of its length: gives position and heading in bends.
_AXLES = 0.6
# Step [m] of the difference that gives the speed.
_NEAR_M = 0.01
_COLUMNS = ("size_m", "state", "path", "start_m", "speed_mps", "place_m", "place_direction")
# Of the test for collisions: time step, headway and distance kept in any case.
_STEP_S, _HEADWAY_S, _MARGIN_M = 0.2, 0.5, 0.3
STATES = ("driving", "jam", "parked")


@dataclass(frozen=True, eq=False)
class TrafficState:
    """All vehicles at one time: centre of the box, unit direction, the centre's speed; NaN, NaN, 0 for those away."""

    centre_m: Float[Array, "n 2"]
    direction: Float[Array, "n 2"]
    speed_mps: Float[Array, "n"]

    @property
    def present(self) -> Bool[Array, "n"]:
        return np.asarray(np.isfinite(self.centre_m[:, 0]))


@dataclass(frozen=True, eq=False)
class Traffic:
    """Vehicles with constant speed along paths, in the world frame (the ground's height is the terrain's).

    kind       (n) names of `sim.meshes`; size_m (n, 3) length, width, height [m].
    state      (n) index into STATES.
    path       (n) path a vehicle drives on, -1 = parked.
    start_m    (n) station of its middle at t = 0; negative where it enters later.
    speed_mps  (n) of the axles along the path.
    place_m    (n, 2), place_direction (n, 2): where parked vehicles stand, NaN for the others.
    """

    kind: tuple[str, ...]
    size_m: Float[Array, "n 3"]
    state: Int[Array, "n"]
    path: Int[Array, "n"]
    start_m: Float[Array, "n"]
    speed_mps: Float[Array, "n"]
    place_m: Float[Array, "n 2"]
    place_direction: Float[Array, "n 2"]
    paths: Paths

    def __post_init__(self) -> None:
        freeze_fields(self)

    def __len__(self) -> int:
        return len(self.kind)

    def at(self, t_s: float) -> TrafficState:
        """Positions, directions and speeds at a time [s]; a vehicle is there while its box lies on its path."""
        centre, direction, speed = self.place_m.copy(), self.place_direction.copy(), np.zeros(len(self))
        m = np.flatnonzero(self.path >= 0)
        path, half = self.path[m], self.size_m[m, 0] / 2
        s = self.start_m[m] + self.speed_mps[m] * t_s
        there = (s >= half) & (s <= self.paths.length_m[path] - half)
        m, path, s, axle = m[there], path[there], s[there], _AXLES * half[there]
        rear, front = self.paths.at(path, s - axle), self.paths.at(path, s + axle)
        chord = front - rear
        centre[m], direction[m] = (front + rear) / 2, chord / np.hypot(chord[:, 0], chord[:, 1])[:, None]
        # In a bend the middle takes a shorter way than the axles.
        ahead, behind = (
            (self.paths.at(path, s - axle + e) + self.paths.at(path, s + axle + e)) / 2 for e in (_NEAR_M, -_NEAR_M)
        )
        speed[m] = self.speed_mps[m] * np.hypot(*(ahead - behind).T) / (2 * _NEAR_M)
        return TrafficState(centre, direction, speed)

    def joined(self, other: Traffic) -> Traffic:
        """These vehicles and those of another on the same paths."""
        both = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in _COLUMNS}
        return Traffic(kind=self.kind + other.kind, paths=self.paths, **both)

    def of(self, chosen: Int[Array, "m"]) -> Traffic:
        """The chosen vehicles alone."""
        some = {name: getattr(self, name)[chosen] for name in _COLUMNS}
        return Traffic(kind=tuple(self.kind[k] for k in chosen), paths=self.paths, **some)

    def without_collisions(self, end_s: float) -> Traffic:
        """The vehicles left when of any two that come too near within [0, end_s] the later in order is taken out.

        Boxes are tested at steps, each lengthened by the way of one step, so that nothing happens unseen between two,
        by the least headway and by a margin.
        """
        alive = np.ones(len(self), bool)
        length, width = (self.size_m[:, :2] + _MARGIN_M).T
        size = np.stack([length + self.speed_mps * (_STEP_S + _HEADWAY_S), width], axis=1)
        for t in np.arange(0.0, end_s + _STEP_S, _STEP_S):
            now = self.at(float(t))
            centre = np.where(alive[:, None], now.centre_m, np.nan)
            # Two that stand need one look.
            for i, j in overlapping(centre, now.direction, size, (self.speed_mps > 0) | (t == 0)):
                if alive[i] and alive[j]:
                    alive[j] = False
        return self.of(np.flatnonzero(alive))
