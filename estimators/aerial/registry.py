"""The estimators for flights, by name: each is a frozen dataclass whose constructor is its configuration.

It is called with the observations of a flight, their folder, a folder for what it makes, and a function to be called
after every image; it returns what can ``save`` itself into that folder, or `EstimationFailed`.
"""

from __future__ import annotations

from typing import Any

from estimators.aerial.flight_boresight import BoresightFromControl, BoresightFromTies
from estimators.aerial.orthorectification import Orthorectification
from estimators.aerial.road_masks import RoadMasking

FLIGHT_ESTIMATORS: dict[str, type[Any]] = {
    "boresight_from_gcps": BoresightFromControl,
    "boresight_from_ties": BoresightFromTies,
    "orthorectification": Orthorectification,
    "road_masks": RoadMasking,
}
