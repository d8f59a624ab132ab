"""What of roads and vehicles a faulty road map's mask holds, over faults and margins (Kozempel 2012, 4.2.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
import shapely

from estimators.aerial.orthorectify import ground_points
from scenarios.experiments.ortho_flight import KNOWN, SPEED_MPS, Overflights, Uncertainty, overfly
from scenarios.experiments.road_coverage import PavementSamples, Strips, pavement_samples, vehicle_points
from scenarios.experiments.steps import check_range
from sim.aerial_placement import TrafficSpec, place_traffic
from sim.flight_path import FlightLine
from sim.roads import RoadNetwork
from sim.roads.database import MapErrors, MapFaults, faulty_map
from sim.roads.motorway import mixed, motorway
from sim.roads.town import town
from sim.streams import stream
from sim.terrain import plane

Array = np.ndarray
Row = tuple[str, str, float, float]
NETWORKS: dict[str, Callable[[np.random.Generator], RoadNetwork]] = {
    "town": town,
    "motorway": motorway,
    "mixed": mixed,
}
MARGINS_M = (0.0, 0.75, 1.5, 2.25, 3.0)
"""On both sides of a road's RAS-Q width; the source's is 1.5 m."""
LENGTHS_M = tuple(np.arange(0, 10.5, 0.5).tolist())
"""Displacements of which it is told how many are longer."""
FAR_M = 5.0
"""From here on a road lies beside its map, as in the source's Fig. 4.5."""
_CHECKED = 10
_CLASSES = 5
_GROUND = plane((-5000.0, -5000.0, 5000.0, 5000.0))
# Of every image: points on pavement, vehicles and pixels that are looked at.
_POINTS, _VEHICLES, _PIXELS = 600, 120, 1000
# Flight lines and images of each, so far apart.
_PLACES, _IMAGES, _APART_M = 4, 2, 60.0


@dataclass(frozen=True)
class RoadAccuracy:
    """Images over roads of a network that a faulty map is put upon, each kind of fault alone and all together.

    Rows: shares (0..1); t_s is the margin [m], or what a quantity says.
    """

    network: Literal["town", "motorway", "mixed"] = "mixed"
    """The roads of the world."""
    system: Literal["antar", "argos"] = "antar"
    """The camera system whose first head is flown."""
    height_m: float = 500.0
    """Above the ground, which is level and known."""
    orientation: Literal["known", "measured"] = "measured"
    """Whether images are oriented as they were taken, or as navigation and calibration say."""
    displacement_m: float = 1.7
    """Mean displacement of the map's points."""

    def __post_init__(self) -> None:
        check_range("height_m", self.height_m, 200, 1500)
        check_range("displacement_m", self.displacement_m, 0, 20)

    @property
    def cases(self) -> tuple[str, ...]:
        """What is wrong with the map."""
        return tuple(self.faults)

    @property
    def faults(self) -> dict[str, MapFaults]:
        """The map's faults by case, in the shares `MapFaults` has by default."""
        usual = MapFaults(self.displacement_m)
        none = MapFaults(0.0, missing=0.0, outdated=0.0, narrowed=0.0)
        return {
            "exact": none,
            "displaced": MapFaults(self.displacement_m, missing=0.0, outdated=0.0, narrowed=0.0),
            "missing": MapFaults(0.0, outdated=0.0, narrowed=0.0, missing=usual.missing),
            "outdated": MapFaults(0.0, missing=0.0, narrowed=0.0, outdated=usual.outdated),
            "narrowed": MapFaults(0.0, missing=0.0, outdated=0.0, narrowed=usual.narrowed),
            "all": usual,
        }

    def __call__(self, seed: int, run: int) -> pd.DataFrame:
        """Rows of every kind of fault.

        road_pavement, road_vehicles (their middles), road_whole_vehicles: part inside the mask, of all and by class of
        the true road; road_affected: of pavement of the roads that the fault concerns (displaced: by more than 5 m
        across); road_excess: part of the mask where no road is. Of the displaced map: road_displacement, mean, and
        _max, largest, of ten nodes; road_beyond: part of the nodes displaced by more than t_s [m]; road_off: part of
        the roads of class t_s displaced across by more than 5 m.
        """
        network = NETWORKS[self.network](stream(seed, run, "road/network"))
        traffic = place_traffic(network, stream(seed, run, "road/traffic"), TrafficSpec(duration_s=0.0))
        samples = pavement_samples(network, stream(seed, run, "road/pavement"))
        seen = _Seen(self._flown(samples, seed, run), network, samples, vehicle_points(traffic), seed, run)
        rows: list[Row] = []
        for case, faults in self.faults.items():
            found, errors = faulty_map(network, stream(seed, run, "road/map"), faults)
            affected = _affected(case, network, errors, seen.samples)
            rows += [(case, *row) for row in seen.covered(Strips.mask(found), affected)]
            if case == "displaced":
                rows += [(case, *row) for row in _displaced(network, found, errors, seed, run)]
        return pd.DataFrame(rows, columns=["estimator", "quantity", "t_s", "value"])

    def _flown(self, samples: PavementSamples, seed: int, run: int) -> Overflights:
        """Images along the roads at random places."""
        chosen = stream(seed, run, "road/places").choice(len(samples.xy), _PLACES, replace=False)
        half = (_IMAGES + 1) / 2 * _APART_M * samples.direction[chosen]
        ends = zip((samples.xy[chosen] - half).tolist(), (samples.xy[chosen] + half).tolist(), strict=True)
        lines = [FlightLine((a[0], a[1]), (b[0], b[1]), self.height_m, SPEED_MPS) for a, b in ends]
        uncertainty = Uncertainty() if self.orientation == "measured" else KNOWN
        return overfly(self.system, lines, _IMAGES, uncertainty, seed, run)


class _Seen:
    """What all images see of pavement, vehicles and anything, and where their orientation puts it."""

    def __init__(
        self, flown: Overflights, network: RoadNetwork, samples: PavementSamples, vehicles: Array, seed: int, run: int
    ) -> None:
        rng = stream(seed, run, "road/seen")
        pavement, cars, pixels = [], [], []
        for k in range(len(flown)):
            pavement.append(_some(rng, _inside(flown, k, samples.xy), _POINTS))
            cars.append(_some(rng, _inside(flown, k, vehicles[:, 0]), _VEHICLES))
            pixels.append(rng.uniform(-0.5, np.array(flown.camera.size_px) - 0.5, (_PIXELS, 2)))
        true = Strips.pavement(network)
        ground = [_ground(flown, k, uv) for k, uv in enumerate(pixels)]
        self.no_road = true.clearance(shapely.points(np.concatenate([xy for xy, _ in ground])))[0] > 0
        self.anywhere = shapely.points(np.concatenate([stated for _, stated in ground]))
        self.samples = samples.of(np.concatenate(pavement))
        self.pavement = _stated(flown, [samples.xy[i] for i in pavement])
        self.pavement_class = _classes(network, self.samples.edge)
        self.vehicles = _stated(flown, [vehicles[i].reshape(-1, 2) for i in cars])
        self.vehicle_class = _classes(network, true.clearance(shapely.points(vehicles[np.concatenate(cars), 0]))[1])

    def covered(self, mask: Strips, affected: Array | None) -> Iterator[tuple[str, float, float]]:
        pavement = mask.clearance(self.pavement)[0]
        corners = mask.clearance(self.vehicles)[0].reshape(-1, 5)
        vehicles, whole = corners[:, 0], corners.max(axis=1)
        anywhere = mask.clearance(self.anywhere)[0]
        parts: dict[str, Array] = {"pavement": pavement, "vehicles": vehicles, "whole_vehicles": whole}
        for c in range(_CLASSES):
            parts[f"pavement_{c}"] = pavement[self.pavement_class == c]
            parts[f"vehicles_{c}"] = vehicles[self.vehicle_class == c]
        if affected is not None:
            parts["affected"] = pavement[affected]
        for margin in MARGINS_M:
            for name, clearance in parts.items():
                if len(clearance):
                    yield f"road_{name}", margin, float(np.mean(clearance <= margin))
            drawn = anywhere <= margin
            if drawn.any():
                yield "road_excess", margin, float(np.mean(self.no_road[drawn]))


def _some(rng: np.random.Generator, chosen: Array, count: int) -> Array:
    return np.sort(rng.permutation(chosen)[:count])


def _classes(network: RoadNetwork, edge: Array) -> Array:
    """Of roads by index; -1 where there is none."""
    classes = np.array([*(r.road_class for r in network.edges), -1])
    return np.asarray(classes[edge])


def _pixels(flown: Overflights, image: int, xy: Array) -> Array:
    return np.asarray(flown.camera.project(flown.T_wc[image].inv().apply(_GROUND.on_ground(xy))))


def _inside(flown: Overflights, image: int, xy: Array) -> Array:
    return np.flatnonzero(flown.camera.contains(_pixels(flown, image, xy)))


def _ground(flown: Overflights, image: int, uv: Array) -> tuple[Array, Array]:
    """Where pixels are, and where the stated orientation puts them."""
    true = ground_points(flown.camera, flown.T_wc[image], _GROUND, uv)
    stated = ground_points(flown.stated_camera, flown.stated_T_wc[image], _GROUND, uv)
    return true[:, :2], stated[:, :2]


def _stated(flown: Overflights, places: list[Array]) -> Array:
    """Places that every image sees, as its orientation has them: shapely's points."""
    return np.asarray(
        shapely.points(np.concatenate([_ground(flown, k, _pixels(flown, k, xy))[1] for k, xy in enumerate(places)]))
    )


def _displacement(network: RoadNetwork, errors: MapErrors) -> Array:
    """Mean displacement of every true edge (k, 2); NaN where the map has none."""
    out = np.full((len(network.edges), 2), np.nan)
    known = errors.source >= 0
    out[errors.source[known]] = errors.displacement_m[known]
    return out


def _across(direction: Array, displacement: Array) -> Array:
    """Component [m] across a road."""
    return np.asarray(np.abs(direction[:, 0] * displacement[:, 1] - direction[:, 1] * displacement[:, 0]))


def _affected(case: str, network: RoadNetwork, errors: MapErrors, samples: PavementSamples) -> Array | None:
    """Which samples lie on roads that the fault concerns; None where it concerns no road of the world."""
    if case == "displaced":
        return _across(samples.direction, _displacement(network, errors)[samples.edge]) > FAR_M
    if case == "missing":
        return np.isin(samples.edge, errors.missing)
    if case == "narrowed":
        return np.isin(samples.edge, errors.source[errors.narrowed])
    return None


def _displaced(
    network: RoadNetwork, found: RoadNetwork, errors: MapErrors, seed: int, run: int
) -> Iterator[tuple[str, float, float]]:
    """Displacements of nodes and of roads, of a map that has all roads in their order."""
    length = np.hypot(*(found.nodes_m - network.nodes_m).T)
    ten = length[stream(seed, run, "road/checked").permutation(len(length))[:_CHECKED]]
    yield "road_displacement", 0, float(ten.mean())
    yield "road_displacement_max", 0, float(ten.max())
    for beyond in LENGTHS_M:
        yield "road_beyond", beyond, float(np.mean(length > beyond))
    points = network.sample(5.0)
    off = _across(points.direction, _displacement(network, errors)[points.edge]) > FAR_M
    classes = _classes(network, points.edge)
    for c in np.unique(classes).tolist():
        yield "road_off", c, float(np.mean(off[classes == c]))
