"""One camera on an aircraft, as it is or as it is thought to be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sim.angles import Mounting
from sim.camera import Camera


@dataclass(frozen=True, eq=False)
class FlightCamera:
    """One camera on the aircraft: interior orientation and mounting, and what it sees (mono, rgb, thermal)."""

    name: str
    band: str
    camera: Camera
    mounting: Mounting

    @staticmethod
    def from_fields(fields: Mapping[str, Any]) -> FlightCamera:
        mounting = Mounting(**fields["mounting"])
        return FlightCamera(fields["name"], fields["band"], Camera.from_fields(fields["camera"]), mounting)
