"""Everything that turns observations into an estimate. Never sees truth.

``ESTIMATORS`` is the registry; users add their own through the entry-point group ``pruefstand.estimators`` (a name and
a callable class whose constructor is its configuration).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any

from estimators.stereo.sliding_window import SlidingWindowAdjustment
from estimators.stereo.vehicle_filter import VehicleFilter

ESTIMATORS: dict[str, type[Any]] = {
    "sliding_window_adjustment": SlidingWindowAdjustment,
    "vehicle_filter": VehicleFilter,
}


@cache
def registry() -> Mapping[str, type[Any]]:
    """The built-in estimators and those of installed plug-ins; a plug-in cannot replace a built-in one."""
    plugins = {e.name: e.load() for e in entry_points(group="pruefstand.estimators")}
    return MappingProxyType(plugins | ESTIMATORS)
