"""Studies of airborne georeferencing, Kozempel 2012, chapters 3 and 4, beside what the source says.

Functions of a `StudyResult` that study files name, as ``kozempel_...``. Every module of a part has TABLES and FIGURES
of its own, merged here.
"""

from collections.abc import Callable

import pandas as pd
from matplotlib.figure import Figure

TABLES: dict[str, Callable[..., pd.DataFrame]] = {}
FIGURES: dict[str, Callable[..., Figure]] = {}
