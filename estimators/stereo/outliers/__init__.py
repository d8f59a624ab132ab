"""Outlier detection among the tracks of a window, Siegemund 2008, 3.4, and a robust detector beside it.

A `Detector` is a frozen configuration, called with a problem, start poses and the adjustment to use:

    Ransac                     three tracks, before the adjustment (3.4.4)-(3.4.8)
    PointTest, TrackTest       statistical tests after it (3.4.9)-(3.4.16), corrected by default
    SOURCE_POINT_TEST, ...     the same as the source has them
    Robust                     graduated non-convexity, for half the tracks and more wrong; reports a second rigid group

`PriorKnowledge` (3.4.1)-(3.4.3) needs no motion and comes before any of them.
"""

from estimators.stereo.outliers.prior_knowledge import PriorKnowledge
from estimators.stereo.outliers.ransac import Ransac
from estimators.stereo.outliers.robust import Robust
from estimators.stereo.outliers.statistical import (
    PRINTED_TRACK_TEST,
    SOURCE_POINT_TEST,
    SOURCE_TRACK_TEST,
    PointTest,
    TrackTest,
)
from estimators.stereo.outliers.verdict import Detector, Verdict, select_points

DETECTORS: dict[str, Detector] = {
    "ransac": Ransac(),
    "points": PointTest(),
    "points_source": SOURCE_POINT_TEST,
    "tracks": TrackTest(),
    "tracks_source": SOURCE_TRACK_TEST,
    "robust": Robust(),
}

__all__ = [
    "DETECTORS",
    "PRINTED_TRACK_TEST",
    "SOURCE_POINT_TEST",
    "SOURCE_TRACK_TEST",
    "Detector",
    "PointTest",
    "PriorKnowledge",
    "Ransac",
    "Robust",
    "TrackTest",
    "Verdict",
    "select_points",
]
