"""A flight's run folder: products of its stages and the truth."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from estimators.aerial.flight_boresight import FlightBoresight
from estimators.aerial.orthorectification import OrthoImages
from estimators.aerial.road_masks import RoadMasks
from estimators.estimate import EstimationFailed
from sim.flight_camera import FlightCamera
from sim.flight_observations import FlightObservations, read_road_map
from sim.flight_truth import FlightTruth
from sim.roads import RoadNetwork


@dataclass(frozen=True, eq=False)
class FlightRun:
    """What the stages before the report left; estimates by their labels."""

    folder: Path
    name: str
    scenario: Mapping[str, Any]
    provenance: Mapping[str, Any]
    observations: FlightObservations
    truth: FlightTruth
    vehicles: pd.DataFrame
    estimates: Mapping[str, OrthoImages | FlightBoresight | RoadMasks | EstimationFailed]

    @property
    def seed(self) -> int:
        return int(self.scenario["seed"])

    @property
    def orthos(self) -> dict[str, OrthoImages]:
        """The ortho images of the estimators that gave any."""
        return {label: e for label, e in self.estimates.items() if isinstance(e, OrthoImages)}

    @property
    def boresights(self) -> dict[str, FlightBoresight]:
        """The boresights of the estimators that gave any."""
        return {label: e for label, e in self.estimates.items() if isinstance(e, FlightBoresight)}

    @property
    def masks(self) -> dict[str, RoadMasks]:
        """The road masks of the estimators that gave any."""
        return {label: e for label, e in self.estimates.items() if isinstance(e, RoadMasks)}

    @cached_property
    def road_map(self) -> RoadNetwork:
        """The roads that estimators know."""
        return read_road_map(self.folder / "observations", self.observations.georeference)

    @cached_property
    def roads(self) -> RoadNetwork:
        """The roads as they are."""
        return read_road_map(self.folder / "truth", self.observations.georeference)

    def true_camera(self, image: int) -> FlightCamera:
        head = self.observations.records[image].head
        return next(c for c in self.truth.cameras if c.name == head)


def load_flight(folder: Path, name: str) -> FlightRun:
    """Reads a flight's run folder."""
    scenario, provenance = (json.loads((folder / f).read_text("utf-8")) for f in ("scenario.json", "provenance.json"))
    labels = [e.get("label") or e["name"] for e in scenario["estimator"]]
    truth, vehicles = FlightTruth.load(folder / "truth")
    found = {label: folder / "estimates" / label for label in labels}
    return FlightRun(
        folder,
        name,
        scenario,
        provenance,
        FlightObservations.load(folder / "observations"),
        truth,
        vehicles,
        {label: _estimate(path) for label, path in found.items() if path.is_dir()},
    )


def _estimate(folder: Path) -> OrthoImages | FlightBoresight | RoadMasks | EstimationFailed:
    failure = folder / "failure.json"
    if failure.is_file():
        f = json.loads(failure.read_text(encoding="utf-8"))
        return EstimationFailed(f["reason"], tuple(f["hints"]))
    if FlightBoresight.is_in(folder):
        return FlightBoresight.load(folder)
    return RoadMasks.load(folder) if RoadMasks.is_in(folder) else OrthoImages.load(folder)
