"""Vehicles of an instant as the renderer and the truth want them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int

from sim.archive import freeze_fields

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class VehicleStates:
    """Vehicles at one time: the point on the ground below the middle, heading [rad] clockwise from +y, speed.

    kind (n,): index into `sim.meshes.VEHICLE_KINDS`; size_m (n, 3): length, width, height; paint (n, 3) in linear
    light; number (n,): which vehicle of the world it is, the same at all times.
    """

    number: Int[Array, "n"]
    kind: Int[Array, "n"]
    xy_m: Float[Array, "n 2"]
    heading: Float[Array, "n"]
    speed_mps: Float[Array, "n"]
    size_m: Float[Array, "n 3"]
    paint: Float[Array, "n 3"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def __len__(self) -> int:
        return len(self.number)

    def of(self, chosen: Int[Array, "m"]) -> VehicleStates:
        """The chosen vehicles alone."""
        return VehicleStates(*(getattr(self, f.name)[chosen] for f in fields(self)))

    def joined(self, other: VehicleStates) -> VehicleStates:
        """These vehicles, then others."""
        return VehicleStates(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))
