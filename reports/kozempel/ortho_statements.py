"""What the source says of the accuracy of its ortho images, held against what a study has found."""

from __future__ import annotations

import numpy as np
import pandas as pd

from reports.claim import Claim, holds
from reports.kozempel.ortho import (
    BEST,
    HEIGHTS,
    PUBLISHED_IMAGES_PX,
    PUBLISHED_PX,
    SOURCES,
    WHOLE,
    budget,
    of,
    pooled,
    px,
    single,
)
from reports.studies import StudyResult


def claims(result: StudyResult) -> pd.DataFrame:
    """One row per statement of the source: what it says, what was found, whether it holds (yes, in part, no)."""
    return pd.DataFrame(_accuracy(result) + _parts(result), columns=["the source says", "found here", "holds"])


def _accuracy(result: StudyResult) -> list[Claim]:
    rows = of(pooled(result), system="antar", errors="all", dem="srtm", estimator=BEST)
    whole = of(rows, quantity="ortho").iloc[0]
    images = of(single(result, "ortho_image"), system="antar", errors="all", dem="srtm", estimator=BEST)["px"]
    low, high = np.quantile(images, [0.025, 0.975])
    best, worst = PUBLISHED_IMAGES_PX
    inside = [low <= v <= high for v in PUBLISHED_IMAGES_PX]
    # Nine images of one run, as the source has nine.
    runs = of(single(result, "ortho"), system="antar", errors="all", dem="srtm", estimator=BEST)["px"]
    run_low, run_high = np.quantile(runs, [0.025, 0.975])
    return [
        (
            f"RMS of three times three images: {PUBLISHED_PX} px, about a metre (ANTAR)",
            f"{whole['px']:.1f} px, {whole['value']:.2f} m; 95 % of single studies of nine images lie between "
            f"{run_low:.1f} and {run_high:.1f} px",
            holds(abs(whole["px"] / PUBLISHED_PX - 1) < 0.15, run_low <= PUBLISHED_PX <= run_high),
        ),
        (
            f"one image has {best} px (30 cm), another {worst} px (150 cm)",
            f"95 % of the images lie between {low:.1f} and {high:.1f} px",
            holds(all(inside), any(inside)),
        ),
    ]


def _parts(result: StudyResult) -> list[Claim]:
    table = budget(result, "antar").set_index("source")
    alone = table["simulated"]
    whole = float(alone[WHOLE])
    outer = float(np.sqrt(np.sum(np.square(alone[["attitude", "position", "boresight", "vibration"]]))))
    shares = np.square(alone[[*SOURCES, HEIGHTS]]) / whole**2
    rest = float(np.sqrt(max(whole**2 - alone["vibration"] ** 2, 0)))
    rows = of(pooled(result), system="antar", errors="none", dem="exact", bin=0.0, quantity="ortho")
    anchor, forward = (px(rows, estimator=m) for m in ("anchor", "forward"))
    return [
        (
            "it is what the accuracy of the exterior orientation had to lead to",
            f"orientation alone {outer:.1f} px, all together {whole:.1f} px; heights of SRTM "
            f"{alone[HEIGHTS]:.1f} px, clicks {alone['clicks']:.1f} px, interior orientation "
            f"{alone['interior']:.1f} px",
            holds(outer > 0.9 * whole, outer > 0.7 * whole),
        ),
        (
            "0.3 m of GNSS are 1.5 px (3.3)",
            f"{alone['position']:.1f} px: 1.5 px in every axis make {1.5 * np.sqrt(2):.1f} px in the plane",
            holds(abs(alone["position"] / (1.5 * np.sqrt(2)) - 1) < 0.15),
        ),
        (
            "errors of the IMU do not matter (3.3): roll and pitch a third of a pixel, heading less than an eighth",
            f"{alone['attitude']:.2f} px together, {100 * shares['attitude']:.0f} % of the variance",
            holds(shares["attitude"] < 0.02 and alone["attitude"] < 0.6),
        ),
        (
            "poor damping of the camera is the next cause to think of (3.3)",
            f"without it {rest:.1f} px are left; 0.08 degrees of vibration add {alone['vibration']:.1f} px, "
            f"{100 * shares['vibration']:.0f} % of the variance, and the next is {_second(shares)}",
            holds(rest < 0.75 * PUBLISHED_PX, bool(shares.idxmax() == "vibration")),
        ),
        (
            "ANTAR's own software takes anchor points without the lens, whose distortion is small",
            f"anchor points alone cost {anchor:.1f} px, {100 * (anchor / whole) ** 2:.0f} % of the variance that is "
            "there anyway",
            holds((anchor / whole) ** 2 < 0.05, (anchor / whole) ** 2 < 0.2),
        ),
        (
            "ARGOS projects pixels forward and interpolates gaps",
            f"whole pixels cost {forward:.2f} px, as half a pixel at most must (√(1/6) = 0.41)",
            holds(abs(forward / np.sqrt(1 / 6) - 1) < 0.05),
        ),
    ]


def _second(shares: pd.Series) -> str:
    rest = shares.drop("vibration")
    return f"{str(rest.idxmax()).replace(': ', ' of ')} with {100 * rest.max():.0f} %"
