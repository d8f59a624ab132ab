"""The published tables and figures of Siegemund 2008, each beside what its source says.

Functions of a `StudyResult` that study files name, as ``siegemund_...``:

detectors      Table 3.4.1
"""

from collections.abc import Callable

import pandas as pd
from matplotlib.figure import Figure

from reports.siegemund.detectors import outlier_counts, outlier_table

TABLES: dict[str, Callable[..., pd.DataFrame]] = {"siegemund_outliers": outlier_table}
FIGURES: dict[str, Callable[..., Figure]] = {"siegemund_outliers": outlier_counts}
