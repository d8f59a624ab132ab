"""The published tables and figures of Siegemund 2008, each beside what its source says.

Functions of a `StudyResult` that study files name, as ``siegemund_...``:

detectors      Table 3.4.1
datum          Figure 3.7.10
clouds         Figure 4.1.2
depth          Figures 4.1.4, 4.1.6, 4.1.7
motion         Figures 4.1.8 to 4.1.10, 4.2.13, 4.2.15 and 4.2.17 to 4.2.19
matrices       Figures C.0.1 to C.0.4
recordings     Figures 4.2.14 and 4.2.16
statements     what the source says of all of these in words; recording_statements of 4.2
"""

from collections.abc import Callable

import pandas as pd
from matplotlib.figure import Figure

from reports.siegemund.clouds import cloud_table, point_clouds
from reports.siegemund.datum import datum_problem, datum_table
from reports.siegemund.depth import depth_and_cloud, depth_error, depth_table
from reports.siegemund.detectors import outlier_counts, outlier_table
from reports.siegemund.matrices import matrix_structure, structure_table
from reports.siegemund.motion import trajectory, trajectory_table
from reports.siegemund.recordings import cloud_above, cloud_above_table, system_error, system_error_table
from reports.siegemund.statements import claims

TABLES: dict[str, Callable[..., pd.DataFrame]] = {
    "siegemund_outliers": outlier_table,
    "siegemund_datum": datum_table,
    "siegemund_clouds": cloud_table,
    "siegemund_depth": depth_table,
    "siegemund_trajectory": trajectory_table,
    "siegemund_matrices": structure_table,
    "siegemund_cloud_above": cloud_above_table,
    "siegemund_system_error": system_error_table,
    "siegemund_claims": claims,
}
FIGURES: dict[str, Callable[..., Figure]] = {
    "siegemund_outliers": outlier_counts,
    "siegemund_datum": datum_problem,
    "siegemund_clouds": point_clouds,
    "siegemund_depth": depth_error,
    "siegemund_depth_and_cloud": depth_and_cloud,
    "siegemund_trajectory": trajectory,
    "siegemund_matrices": matrix_structure,
    "siegemund_cloud_above": cloud_above,
    "siegemund_system_error": system_error,
}
