"""From the file of a flight to the flight itself: world, trajectory, exposures, navigation, and all that is wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from sim.aerial import AerialWorld
from sim.aerial.presets import PRESETS, map_world
from sim.aerial.sunlight import Sunlight
from sim.camera_systems import CameraSystem, Exposures, Head, exposures
from sim.flight import Flight, Shaking, Vibration, true_camera_pose
from sim.flight_camera import FlightCamera
from sim.flight_observations import FlightObservations
from sim.flight_plan import at_most, believed, built, flown, navigation_errors, true_head
from sim.flight_truth import FlightTruth
from sim.geodesy import Georeference
from sim.imu import navigation_solution, stamps
from sim.map_files import MapError
from sim.navigation import image_records
from sim.pose import Pose
from sim.roads import RoadNetwork
from sim.roads.database import MapFaults, faulty_map
from sim.roads.files import read_roads
from sim.scenario import ScenarioError
from sim.scenario.flight import ElevationModel, FlightScenario, Ground, Imaging
from sim.streams import stream
from sim.terrain import Bounds, ElevationGrid, relief
from sim.terrain_files import TerrainError, read_elevation

Array = np.ndarray
RUN = 0
# The traffic goes on for so long behind each line.
_BETWEEN_S = 5.0
# Heights of files reach so far beyond the roads: oblique views see far.
_AROUND_M = 1500.0
_LONGEST_ERROR = 8.0  # of the elevation model, in its shortest waves


@dataclass(frozen=True, eq=False)
class FlownFlight:
    """A flight before any image is drawn: what estimators get, and what is true.

    world_s (k,): the time of the world's traffic at each exposure. It stands still while the aircraft turns, which no
    image shows: traffic of ten minutes costs many times that of one.
    """

    world: AerialWorld
    observations: FlightObservations
    truth: FlightTruth
    road_map: RoadNetwork
    world_s: Float[Array, "k"]


def simulate_flight(spec: FlightScenario) -> FlownFlight:
    """Flies a scenario.

    Raises
        ScenarioError: a map or terrain file that cannot be used, a camera that exposes nothing.
    """
    # How long it takes hangs on where it is flown no more than on who drives below.
    line_s = flown(spec.flight, (0.0, 0.0), 0.0, spec.seed, RUN).line_s
    duration_s = float(np.sum(line_s[:, 1] - line_s[:, 0] + _BETWEEN_S))
    world, georeference = _world(spec.ground, spec.seed, duration_s)
    world = replace(world, sunlight=_sunlight(world, spec.imaging))
    x0, y0, x1, y1 = world.roads.bounds_m
    offset = spec.flight.pattern.offset_m
    middle = np.array([(x0 + x1) / 2 + offset[0], (y0 + y1) / 2 + offset[1]])
    if not world.terrain.contains(middle):
        raise ScenarioError(f"flight.pattern.offset_m: {offset} leads away from the ground {world.terrain.bounds_m}")
    at = float(middle[0]), float(middle[1])
    flight = flown(spec.flight, at, float(world.terrain.height(middle)), spec.seed, RUN)
    nominal = built(spec.flight)
    exposed = at_most(exposures(nominal, flight.line_s, spec.seed, RUN), spec.flight.frames)
    if not len(exposed):
        raise ScenarioError("flight: no camera exposes along the lines; make them longer")
    control = _control(spec, world, middle)
    world = replace(world, signals=control[:, :2])
    return _flown(spec, world, georeference, flight, nominal, exposed, control)


def _flown(
    spec: FlightScenario,
    world: AerialWorld,
    georeference: Georeference,
    flight: Flight,
    nominal: CameraSystem,
    exposed: Exposures,
    control: Array,
) -> FlownFlight:
    errors = navigation_errors(spec.navigation)
    true = [true_head(head, spec.calibration) for head in nominal.heads]
    solution, _ = navigation_solution(
        flight.trajectory,
        georeference,
        errors,
        spec.seed,
        RUN,
        rate_hz=spec.navigation.rate_hz,
        within_s=flight.line_s,
    )
    stamped = stamps(exposed.t_s, errors, spec.flight.system, spec.seed, RUN)
    known = replace(nominal, heads=tuple(believed(head, spec.calibration) for head in nominal.heads))
    try:
        records = image_records(known, exposed, stamped, solution, georeference, exposure_s=spec.imaging.exposure_s)
    except ValueError as error:
        raise ScenarioError(f"navigation.time_offset_s, jitter_s: {error}") from error
    suffix = [_suffix(known.heads[h], spec.imaging) for h in exposed.head]
    records = tuple(replace(r, file=r.file + s) for r, s in zip(records, suffix, strict=True))
    road_map, map_errors = faulty_map(
        world.roads, stream(spec.seed, RUN, "flight/road map"), MapFaults(**spec.map.model_dump())
    )
    observations = FlightObservations(
        spec.flight.system,
        georeference,
        tuple(FlightCamera(h.name, h.band, h.camera, h.mounting) for h in known.heads),
        records,
        solution,
        _elevation_model(spec.elevation, world.terrain, stream(spec.seed, RUN, "flight/elevation model")),
    )
    truth = FlightTruth(
        exposed.t_s,
        flight.trajectory.pose(exposed.t_s),
        _true_poses(spec, flight, true, exposed),
        tuple(FlightCamera(h.name, h.band, h.camera, h.mounting) for h in true),
        world.terrain,
        map_errors,
        control,
    )
    begin = np.cumsum(flight.line_s[:, 1] - flight.line_s[:, 0] + _BETWEEN_S)
    world_s = exposed.t_s - flight.line_s[exposed.line, 1] + begin[exposed.line] - _BETWEEN_S
    return FlownFlight(world, observations, truth, road_map, world_s)


def _world(ground: Ground, seed: int, duration_s: float) -> tuple[AerialWorld, Georeference]:
    if ground.preset is not None:
        place = np.array([ground.longitude_deg, ground.latitude_deg])
        length = {} if ground.length_m is None else {"length_m": ground.length_m}
        world = PRESETS[ground.preset](seed, duration_s=duration_s, **length)
        return world, Georeference.around(place, height_m=ground.height_m)
    assert ground.roads is not None
    try:
        reading = read_roads(ground.roads, height_m=ground.height_m)
        terrain = None
        if ground.terrain:
            terrain = read_elevation(
                ground.terrain,
                reading.georeference,
                _wider(reading.network.bounds_m, _AROUND_M),
                ground.terrain_spacing_m,
                undulation_m=ground.undulation_m,
                voids=ground.voids,
            ).grid
        return map_world(
            ground.roads,
            ground.buildings,
            seed,
            terrain=terrain,
            georeference=reading.georeference,
            duration_s=duration_s,
            default_height_m=ground.default_height_m,
        )
    except (MapError, TerrainError) as error:
        raise ScenarioError(f"ground: {error}") from error


def _wider(bounds: Bounds, margin_m: float) -> Bounds:
    x0, y0, x1, y1 = bounds
    return x0 - margin_m, y0 - margin_m, x1 + margin_m, y1 + margin_m


def _sunlight(world: AerialWorld, imaging: Imaging) -> Sunlight:
    given: dict[str, Any] = {
        "azimuth_deg": imaging.sun_azimuth_deg,
        "elevation_deg": imaging.sun_elevation_deg,
        "sky": imaging.sky,
        "visibility_m": imaging.visibility_m,
        "balance": imaging.balance,
    }
    return replace(world.sunlight, **{name: value for name, value in given.items() if value is not None})


def _true_poses(spec: FlightScenario, flight: Flight, heads: list[Head], exposed: Exposures) -> Pose:
    vibration = Vibration(float(np.deg2rad(spec.flight.air.vibration_deg)))
    R, t = np.empty((len(exposed), 3, 3)), np.empty((len(exposed), 3))
    for i, head in enumerate(heads):
        own = exposed.head == i
        shaking = Shaking.draw(vibration, f"{spec.flight.system}/{head.name}", spec.seed, RUN)
        T_wc = true_camera_pose(flight.trajectory, head.mounting, shaking, exposed.t_s[own])
        R[own], t[own] = T_wc.R, T_wc.t
    return Pose(R, t)


def _elevation_model(model: ElevationModel, ground: ElevationGrid, rng: np.random.Generator) -> ElevationGrid:
    """The ground at the nodes of a coarser grid, with a smooth error."""
    x0, y0, x1, y1 = ground.bounds_m
    spacing = model.spacing_m or ground.spacing_m
    if model.spacing_m is None:
        nodes = ground
    else:
        columns, rows = max(int((x1 - x0) / spacing), 1) + 1, max(int((y1 - y0) / spacing), 1) + 1
        x, y = x0 + spacing * np.arange(columns), y0 + spacing * np.arange(rows)
        nodes = ElevationGrid(ground.height(np.stack(np.meshgrid(x, y), axis=-1)), (x0, y0), spacing)
    if not model.error_m:
        return nodes
    short = max(model.error_length_m, 2 * spacing)
    longest = min(_LONGEST_ERROR * short, max(nodes.heights_m.shape) * spacing - spacing)
    error = relief(nodes.bounds_m, spacing, rng, rms_m=model.error_m, wavelengths_m=(short, longest))
    return replace(nodes, heights_m=nodes.heights_m + error.heights_m)


def _control(spec: FlightScenario, world: AerialWorld, middle: Float[Array, "2"]) -> Float[Array, "n 3"]:
    """Signals on the roads about the middle."""
    wanted = spec.control.points
    if not wanted:
        return np.zeros((0, 3))
    rng = stream(spec.seed, RUN, "flight/control")
    on_roads = np.concatenate([r.at(np.arange(2.0, r.length_m, 5.0))[0] for r in world.roads.edges])
    near = on_roads[(np.abs(on_roads - middle) < spec.control.spread_m).all(axis=1)]
    if len(near) < wanted:
        raise ScenarioError(
            f"control.points: {wanted} wanted, the roads within {spec.control.spread_m:g} m have place for {len(near)}"
        )
    return world.terrain.on_ground(near[rng.permutation(len(near))[:wanted]])


def _suffix(head: Head, imaging: Imaging) -> str:
    return ".png" if imaging.jpeg_quality is None or head.band == "thermal" else ".jpg"
