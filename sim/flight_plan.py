"""From the keys of a flight to its parts: lines, camera system, errors of calibration and navigation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from sim.angles import Mounting
from sim.camera import Camera
from sim.camera_systems import CameraSystem, Exposures, Head, antar, argos
from sim.flight import Flight, Gusts, fly
from sim.flight_path import FlightLine, approaches, block
from sim.imu import ChannelErrors, NavigationErrors, pos_av_410
from sim.scenario.flight import Approaches, Block, Calibration, FlightPlan, NavigationSystem

Array = np.ndarray


def flown(plan: FlightPlan, middle: tuple[float, float], ground_m: float, seed: int, run: int) -> Flight:
    """The aircraft's way along the plan's lines about a place [m] of a ground height [m]."""
    gusts = Gusts(tuple(np.deg2rad(plan.air.gusts_deg).tolist()))
    heights = [h + ground_m for h in plan.height_m]
    level = _lines(plan, middle, heights[0])
    lines = [replace(line, height_m=heights[i % len(heights)]) for i, line in enumerate(level)]
    return fly(lines, seed, run, bank=np.deg2rad(plan.bank_deg), gusts=gusts, wind_mps=plan.air.wind_mps)


def _lines(plan: FlightPlan, middle: tuple[float, float], height_m: float) -> Iterable[FlightLine]:
    pattern, speed = plan.pattern, plan.speed_mps
    if isinstance(pattern, Approaches):
        # Every direction at every height.
        headings = [h for h in pattern.headings_deg for _ in plan.height_m]
        return approaches(middle, pattern.length_m, height_m, speed, headings)
    (first,) = approaches(middle, pattern.length_m, height_m, speed, (pattern.heading_deg,))
    if isinstance(pattern, Block):
        half = 0.5 * (pattern.lines - 1) * pattern.spacing_m
        left = half * np.array([-np.sin(first.direction), np.cos(first.direction)])
        start, end = (tuple((np.array(p) + left).tolist()) for p in (first.start_m, first.end_m))
        return block(replace(first, start_m=start, end_m=end), pattern.spacing_m, pattern.lines)
    return (first,)


def built(plan: FlightPlan) -> CameraSystem:
    """The heads that fly, as nominally built and mounted, without lens distortion."""
    if plan.system == "antar":
        system = antar(plan.mount_deg)
    else:
        system = argos(1 if plan.heads == ("nadir",) else 3, plan.mount_deg)
    return replace(system, heads=tuple(h for h in system.heads if h.name in plan.heads))


def believed(head: Head, calibration: Calibration) -> Head:
    """A head as the estimators know it."""
    nominal = calibration.nominal_distortion
    distortion = calibration.distortion if nominal is None else nominal
    return replace(head, camera=Camera(head.camera.K, head.camera.size_px, np.array(distortion, float)))


def true_head(head: Head, calibration: Calibration) -> Head:
    """A head as it is."""
    c = calibration
    K = head.camera.K * np.array([[1 + c.focal_error, 1, 1], [1, 1 + c.focal_error, 1], [1, 1, 1]])
    K = K + np.array([[0, 0, c.principal_error_px[0]], [0, 0, c.principal_error_px[1]], [0, 0, 0]])
    mounting = Mounting(
        head.mounting.boresight + np.deg2rad(c.boresight_error_deg), head.mounting.lever_b + np.array(c.lever_error_m)
    )
    return replace(head, camera=Camera(K, head.camera.size_px, np.array(c.distortion, float)), mounting=mounting)


def at_most(exposed: Exposures, most: int | None) -> Exposures:
    """No more than so many exposures of each camera."""
    if most is None:
        return exposed
    rank = np.array([np.count_nonzero(exposed.head[:i] == h) for i, h in enumerate(exposed.head)], int)
    kept = rank < most
    return Exposures(exposed.t_s[kept], exposed.head[kept], exposed.line[kept], exposed.burst[kept])


def navigation_errors(system: NavigationSystem) -> NavigationErrors:
    """What is wrong with the navigation solution and its stamps."""
    lever = system.antenna_lever_error_m
    timing: dict[str, Any] = {
        "time_offset_s": system.time_offset_s,
        "jitter_s": system.jitter_s,
        "antenna_lever_b": lever,
    }
    if system.errors == "none":
        return NavigationErrors(**timing)
    table = pos_av_410(system.position_m)
    return replace(table, attitude=_scaled(table.attitude, system.attitude_factor), **timing)


def _scaled(errors: ChannelErrors, factor: float) -> ChannelErrors:
    parts: dict[str, Any] = {
        n: tuple(factor * v for v in getattr(errors, n)) for n in ("white", "bias", "drift", "walk")
    }
    return replace(errors, **parts)
