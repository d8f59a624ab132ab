"""The published tables and figures of Siegemund 2008, each beside what its source says.

Functions of a `StudyResult` that study files name, as ``siegemund_...``:

detectors      Table 3.4.1
datum          Figure 3.7.10
depth          Figures 4.1.4, 4.1.6, 4.1.7
"""

from collections.abc import Callable

import pandas as pd
from matplotlib.figure import Figure

from reports.siegemund.datum import datum_problem, datum_table
from reports.siegemund.depth import depth_and_cloud, depth_error, depth_table
from reports.siegemund.detectors import outlier_counts, outlier_table

TABLES: dict[str, Callable[..., pd.DataFrame]] = {
    "siegemund_outliers": outlier_table,
    "siegemund_datum": datum_table,
    "siegemund_depth": depth_table,
}
FIGURES: dict[str, Callable[..., Figure]] = {
    "siegemund_outliers": outlier_counts,
    "siegemund_datum": datum_problem,
    "siegemund_depth": depth_error,
    "siegemund_depth_and_cloud": depth_and_cloud,
}
