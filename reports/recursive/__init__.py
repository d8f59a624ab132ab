"""Studies of recursive estimation, Dickmanns 2007, 6.4, beside what the source says.

Functions of a `StudyResult` that study files name, as ``dickmanns_...`` and ``filter_...``:

precision      which forms of the filter survive single precision (6.4.6)
scalar         influence of Q, R and P*(0) on the filter of one state, (6.21)-(6.26)
comparison     filter against adjustment, with paired intervals; comparison_figures
vehicle        the vehicle filter over the noise of its motion and P*(0)
statements     what the source says of these in words
"""

from collections.abc import Callable

import pandas as pd
from matplotlib.figure import Figure

from reports.recursive.comparison import better_table
from reports.recursive.comparison_figures import manoeuvre_figure, start_figure, wrong_tracks_figure, wrong_tracks_table
from reports.recursive.precision import precision_errors, precision_lost, precision_table
from reports.recursive.scalar import gain_table, scalar_figure, start_table, tuning_table
from reports.recursive.statements import claims
from reports.recursive.vehicle import noise_table, poor_start_table, vehicle_figure

TABLES: dict[str, Callable[..., pd.DataFrame]] = {
    "dickmanns_precision": precision_table,
    "dickmanns_gain": gain_table,
    "dickmanns_start": start_table,
    "dickmanns_tuning": tuning_table,
    "dickmanns_noise": noise_table,
    "dickmanns_poor_start": poor_start_table,
    "dickmanns_claims": claims,
    "filter_better": better_table,
    "filter_wrong_tracks": wrong_tracks_table,
}
FIGURES: dict[str, Callable[..., Figure]] = {
    "dickmanns_precision_errors": precision_errors,
    "dickmanns_precision_lost": precision_lost,
    "dickmanns_scalar": scalar_figure,
    "dickmanns_vehicle": vehicle_figure,
    "filter_start": start_figure,
    "filter_manoeuvres": manoeuvre_figure,
    "filter_wrong_tracks": wrong_tracks_figure,
}
