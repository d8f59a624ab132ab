"""What the source says of its calibrations of the boresight, held against what studies have found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from reports.claim import Claim, holds
from reports.kozempel import boresight_offset as offset
from reports.kozempel.boresight import (
    ADJUSTED,
    ANGLES,
    PER_IMAGE,
    PIXEL_M,
    SOURCE_PX,
    SOURCE_SCATTER_DEG,
    as_source,
    pooled,
)
from reports.kozempel.boresight_ties import FOUND, LAYOUTS, SOURCE_GROUND_M
from reports.studies import StudyResult

Array = np.ndarray
FOCAL_PX, HALF_PX = 2500.0, 512.0
"""Of ANTAR: 0.20 m on the ground from 500 m, and half of 1024 pixels."""
_ROLL_DEG, _HEADING_DEG, _GNSS_M = 0.008, 0.015, 0.3


def claims(result: StudyResult) -> pd.DataFrame:
    """One row per statement of the source: what it says, what was found, whether it holds (yes, in part, no).

    Raises
        KeyError: the source says nothing of a study of this name.
    """
    return pd.DataFrame(_CLAIMS[result.name](result), columns=["the source says", "found here", "holds"])


def _scatter(result: StudyResult) -> list[Claim]:
    images, adjusted = pooled(result, PER_IMAGE), pooled(result, ADJUSTED)
    shaken = as_source(result)
    still = str(images[images["vibration_deg"] == 0].sort_values("position_m").index[-1])
    scatter = images[[f"boresight_scatter_{a}" for a in ANGLES]].T
    low, high = SOURCE_SCATTER_DEG
    inside = scatter[shaken].between(low, high)
    px, quiet_px = (float(images.T[p]["boresight_px"]) for p in (shaken, still))
    roll, edge = FOCAL_PX * np.deg2rad(_ROLL_DEG), HALF_PX * np.deg2rad(_HEADING_DEG)
    gain = [float(adjusted.T[shaken][q]) / float(images.T[shaken][q]) for q in (f"boresight_{a}" for a in ANGLES)]
    return [
        (
            "the angles of single images scatter by 0.05 to 0.12°",
            f"{_angles(scatter[shaken])} with 0.08° of vibration and 0.3 m of GNSS",
            holds(bool(inside.all()), bool(inside.any())),
        ),
        (
            "their mean leaves an RMS of 5 to 6 px, 1.0 to 1.2 m on the ground",
            f"{px:.2f} px, {PIXEL_M * px:.2f} m",
            holds(SOURCE_PX[0] <= px <= SOURCE_PX[1], 4.5 <= px <= 6.5),
        ),
        (
            "that is more than the accuracy of the navigation system (Table 3.1) explains",
            f"without vibration, with GNSS at the table's worst: {_angles(scatter[still])}, {quiet_px:.2f} px",
            holds(quiet_px < SOURCE_PX[0] / 2 and bool((scatter[still] < low).all()), quiet_px < SOURCE_PX[0]),
        ),
        (
            "0.30 m of GNSS are about 1.5 px",
            f"{_GNSS_M / PIXEL_M:.1f} px along an axis, {np.sqrt(2) * _GNSS_M / PIXEL_M:.1f} px in the plane",
            holds(bool(np.isclose(_GNSS_M / PIXEL_M, 1.5))),
        ),
        (
            "0.008° of roll or pitch are a third of a pixel, 0.015° of heading less than an eighth at the border",
            f"{roll:.2f} px; {edge:.3f} px at the border, {np.sqrt(2) * edge:.3f} px in the corner",
            holds(abs(roll - 1 / 3) < 0.05 and edge < 1 / 8, abs(roll - 1 / 3) < 0.05),
        ),
        (
            "the mean of angles found image by image is the boresight",
            "error of one adjustment over that of the mean: "
            + ", ".join(f"{v:.2f}" for v in gain)
            + "; the adjustment gains an honest covariance",
            holds(all(abs(v - 1) < 0.1 for v in gain)),
        ),
    ]


def _angles(values: pd.Series) -> str:
    return " / ".join(f"{v:.3f}" for v in values) + "°"


def _offset(result: StudyResult) -> list[Claim]:
    points = offset.unsteady(result)
    vibration, jitter = points["vibration"], points["jitter"]
    held = pooled(result, offset.HELD)
    lowest = offset.minima(result, offset.HELD)
    own = lowest[lowest.index == vibration].to_numpy(float)
    gain = float(held.T[vibration]["offset_gain"])
    middle, spread = float(own.mean()), float(own.std(ddof=1))
    return [
        (
            "the RMS is least at -1 ms",
            f"with no offset at all at {middle:+.1f} ± {spread:.1f} ms over the runs",
            holds(abs(middle - offset.SOURCE_MINIMUM_MS) < 2 * spread),
        ),
        (
            "there it differs only slightly from that at 0 ms: no offset improves anything",
            f"by {100 * gain:.2f} %",
            holds(gain < 0.01, gain < 0.05),
        ),
        _absorbed(held.T[_constant(result)]),
        *_of_images(result, vibration, jitter),
    ]


def _absorbed(flight: pd.Series) -> Claim:
    gain = float(flight["offset_gain"])
    return (
        "(meant by it:) a constant offset would show as a minimum elsewhere",
        f"one of {1e3 * flight['time_offset_s']:.0f} ms, flown in calm air at one height, gives a curve that is lowest "
        f"at {flight['offset_minimum']:+.1f} ms, by {100 * gain:.1f} %: the boresight has taken it up",
        holds(gain > 0.1, gain > 0.02),
    )


def _of_images(result: StudyResult, vibration: str, jitter: str) -> list[Claim]:
    """On offsets of every image's own, and what they say of the cause."""
    good, bad = offset.SOURCE_GOOD_PX[1], offset.SOURCE_BAD_PX[0]
    zero, best, cured, shifted = (
        offset.of_images(result, point, f"offset_image_{what}px").to_numpy(float)
        for point, what in ((vibration, "zero_"), (vibration, ""), (jitter, ""), (jitter, "zero_"))
    )
    left, left_by_jitter = float(np.mean(best > bad)), float(np.mean(cured > bad))
    shaken_px, jitter_px = (float(np.sqrt(np.mean(v**2))) for v in (zero, shifted))
    return [
        (
            "an offset of each image's own brings some images to 0.5 to 1.5 px, but leaves 3 of 9 at 4 to 7 px",
            f"with vibration {_share(best < good)} come below 1.5 px ({_share(zero < good)} were before), "
            f"{_share(best > bad)} stay above 4 px; 3 of 9 are 33 %",
            holds(0.2 < left < 0.47, left > 0.1),
        ),
        (
            "so unsteady synchronisation does not explain it",
            f"18 ms of jitter alone give {jitter_px:.1f} px as well, but then an own offset leaves "
            f"{_share(cured > bad)} of the images above 4 px",
            holds(left_by_jitter < 0.1 < left),
        ),
        (
            "next in question is the poor damping of the camera",
            f"0.08° of vibration leaves {shaken_px:.1f} px, the source 5 to 6",
            holds(4.5 <= shaken_px <= 6.5),
        ),
    ]


def _constant(result: StudyResult) -> str:
    """The flight with an offset at one height in the calmest air."""
    p = result.points
    return str(p[(p["time_offset_s"] != 0) & (p["heights_m"].map(len) == 1)]["gusts"].idxmin())


def _share(which: Array) -> str:
    return f"{100 * which.mean():.0f} %"


def _ties(result: StudyResult) -> list[Claim]:
    found = pooled(result, FOUND)
    found = found[found["navigation"] == "pos_av_410"].set_index("layout")
    position, height = found["ties_position"], found["ties_height"]
    crossed = [str(v) for v in found.index if v != "strip"]
    return [
        (
            "three images, no control: 5 m in position and 1 m in height",
            "; ".join(f"{said} {position[v]:.2f} m, {height[v]:.2f} m" for v, said in LAYOUTS.items()),
            holds(
                bool((position <= SOURCE_GROUND_M["position"]).all() and (height <= SOURCE_GROUND_M["height"]).all()),
                bool((position[crossed] <= SOURCE_GROUND_M["position"]).all()),
            ),
        ),
        (
            "that is significantly worse than with control points, 1.0 and 0.5 m",
            f"only of a strip, whose φ stays unknown by {found['boresight_phi']['strip']:.2f}°: of lines in two "
            f"directions the tie points alone give {max(position[crossed]):.2f} m and {max(height[crossed]):.2f} m",
            holds(bool((position > 1.0).all()), position["strip"] > 1.0),
        ),
        (
            "the angles are found where the rays come closest",
            f"started 1° off, all three angles of lines in two directions: {_angles(_worst(found, crossed))}",
            holds(bool((_worst(found, crossed) < [0.03, 0.03, 0.06]).all())),
        ),
    ]


def _worst(found: pd.DataFrame, layouts: list[str]) -> pd.Series:
    return found.loc[layouts, [f"boresight_{a}" for a in ANGLES]].max()


_CLAIMS: dict[str, Callable[[StudyResult], list[Claim]]] = {
    "kozempel-fig-3-7": _scatter,
    "kozempel-fig-3-8": _offset,
    "kozempel-3-4-ties": _ties,
}
