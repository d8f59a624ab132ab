"""Cars that cross between the camera and the target: true bodies of the world, which hide it in images and truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sim.meshes import make_vehicle, volumes_intersect
from sim.model import VehicleModel
from sim.pose import Pose
from sim.scenario import ScenarioError, Straight
from sim.streams import stream
from sim.traffic import trajectory
from sim.trajectory import Trajectory

Array = np.ndarray
_KINDS = ("hatchback", "sedan", "estate", "van")
_SPEED_MPS = (7.0, 14.0)
_WAY = (0.3, 0.75)  # where on the line of sight a car crosses it
_CLEARANCE_M = 6.0  # from the camera, which sits in a car
_TRIES = 100


@dataclass(frozen=True, eq=False)
class Driver:
    """A vehicle and its motion."""

    name: str
    model: VehicleModel
    trajectory: Trajectory


def passing_cars(
    count: int, cars: Sequence[Driver], target: int, T_wc: Pose, t_s: Float[Array, "m"], seed: int
) -> list[Driver]:
    """``count`` cars, each of which crosses the line of sight to ``cars[target]`` at right angles at its own time.

    T_wc (m,): the left camera over the frames. They touch neither each other nor the other cars nor the ego car.

    Raises
        ScenarioError: there is no room for one of them.
    """
    placed = list(cars)
    for k in range(count):
        rng = stream(seed, 0, f"world/passing/{k}")
        model = make_vehicle(str(rng.choice(_KINDS)), rng)
        times = t_s[0] + (t_s[-1] - t_s[0]) * _shares(k, count, rng)
        tries = (_crossing(cars[target], T_wc, t_s, float(when), model, rng) for when in times)
        motion = next((m for m in tries if _is_free(model, m, placed, T_wc, t_s)), None)
        if motion is None:
            raise ScenarioError(f"realism.occluders: no room for {count} cars between camera and target")
        placed.append(Driver(f"passing car {k + 1}", model, motion))
    return placed[len(cars) :]


def _shares(k: int, count: int, rng: np.random.Generator) -> Float[Array, "n"]:
    """When in the run car k may cross, as shares of it: tries around its own time first, then more and more freely."""
    freely = np.linspace(0.3, 2.0 * count, _TRIES)
    return np.clip((k + 0.5 + freely * rng.uniform(-0.5, 0.5, _TRIES)) / count, 0.03, 0.97)


def _crossing(
    target: Driver, T_wc: Pose, t_s: Array, when: float, model: VehicleModel, rng: np.random.Generator
) -> Trajectory:
    """A straight drive whose middle is on the line of sight at a time."""
    eye = np.array([np.interp(when, t_s, c) for c in T_wc.t[:, :2].T])
    seen = target.trajectory.pose(when).apply(_middle(target.model))[:2]
    heading = np.arctan2(*(seen - eye)) + rng.choice((-1, 1)) * np.pi / 2
    speed = rng.uniform(*_SPEED_MPS)
    ahead = np.array([np.sin(heading), np.cos(heading)])
    start = eye + rng.uniform(*_WAY) * (seen - eye) - ahead * (speed * when + _middle(model)[0])
    motion = Straight(
        kind="straight",
        start_m=(float(start[0]), float(start[1])),
        heading_deg=float(np.rad2deg(heading)),
        speed_mps=float(speed),
    )
    return trajectory(motion, float(t_s[-1]))


def _middle(model: VehicleModel) -> Float[Array, "3"]:
    return np.array([model.size_m[0] / 2 - model.rear_overhang_m, 0.0, model.size_m[2] / 2])


def _is_free(model: VehicleModel, motion: Trajectory, others: Sequence[Driver], T_wc: Pose, t_s: Array) -> bool:
    T_wv = motion.pose(t_s)
    distance = np.linalg.norm(T_wv.apply(_middle(model))[:, :2] - T_wc.t[:, :2], axis=1)
    if distance.min() < _CLEARANCE_M:
        return False
    return not any(volumes_intersect(model, T_wv, o.model, o.trajectory.pose(t_s)).any() for o in others)
