"""The registry of tables and figures a study file may name, and what they are made by."""

from __future__ import annotations

from collections.abc import Callable

import pandas as pd
from matplotlib.figure import Figure

from reports import battery_outputs, kozempel, recursive, rig_outputs, siegemund
from reports.studies import heat_map, lines, measures, metrics

TABLES: dict[str, Callable[..., pd.DataFrame]] = {
    "metrics": metrics,
    "measures": measures,
    **siegemund.TABLES,
    **recursive.TABLES,
    **kozempel.TABLES,
    **rig_outputs.TABLES,
    **battery_outputs.TABLES,
}
FIGURES: dict[str, Callable[..., Figure]] = {
    "lines": lines,
    "heat_map": heat_map,
    **siegemund.FIGURES,
    **recursive.FIGURES,
    **kozempel.FIGURES,
    **rig_outputs.FIGURES,
    **battery_outputs.FIGURES,
}
