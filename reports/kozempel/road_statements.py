"""What the source says of its road map in images, held against what a study has found."""

from __future__ import annotations

import numpy as np
import pandas as pd

from reports.claim import Claim, holds
from reports.kozempel.ortho import of
from reports.kozempel.road import (
    ATKIS_M,
    MARGIN_M,
    PUBLISHED_MAX_M,
    PUBLISHED_MEAN_M,
    networks,
    pooled,
    single,
    value,
    views,
)
from reports.studies import StudyResult


def claims(result: StudyResult) -> pd.DataFrame:
    """One row per statement of the source: what it says, what was found, whether it holds (yes, in part, no)."""
    found = _points(result) + _faults(result) + _margin(result)
    return pd.DataFrame(found, columns=["the source says", "found here", "holds"])


def _points(result: StudyResult) -> list[Claim]:
    mean, largest, off = (
        of(single(result, f"road_{name}"), displacement_m=PUBLISHED_MEAN_M)
        for name in ("displacement", "displacement_max", "off")
    )
    low, high = np.quantile(mean["value"], [0.025, 0.975])
    least, most = np.quantile(largest["value"], [0.025, 0.975])
    reached = 100 * float(np.mean(largest["value"] >= PUBLISHED_MAX_M))
    by_class = off.groupby("t_s")["value"].mean()
    local, others = 100 * float(by_class[4.0]), 100 * float(by_class.drop(4.0).mean())
    return [
        (
            f"ten points of the map are off by {PUBLISHED_MEAN_M} m on average",
            f"ours by {mean['value'].mean():.1f} m, ten of a map by {low:.1f} to {high:.1f} m (95 %)",
            holds(
                low <= PUBLISHED_MEAN_M <= high and abs(mean["value"].mean() / PUBLISHED_MEAN_M - 1) < 0.15,
                low <= PUBLISHED_MEAN_M <= high,
            ),
        ),
        (
            f"now and then more, one of the ten by {PUBLISHED_MAX_M} m",
            f"largest of ten {largest['value'].mean():.1f} m on average, {least:.1f} to {most:.1f} m (95 %); "
            f"{reached:.0f} % of the maps reach {PUBLISHED_MAX_M} m",
            holds(least <= PUBLISHED_MAX_M <= most),
        ),
        (
            "smaller roads are sometimes very wrong: one lies more than five metres beside its edge",
            f"{local:.1f} % of local roads are displaced across by more than 5 m, {others:.1f} % of the others: "
            "our faults know no classes",
            holds(False, local > 0.2),
        ),
    ]


def _faults(result: StudyResult) -> list[Claim]:
    rows = of(pooled(result), view="known", quantity="road_affected")
    far, narrowed = (100 * _mean(of(rows, estimator=case, bin=MARGIN_M)) for case in ("displaced", "narrowed"))
    return [
        (
            "vehicles at the edge of such a road are outside the mask in spite of the margin",
            f"of pavement that is displaced so far {100 - far:.0f} % is outside",
            holds(far < 90),
        ),
        (
            "a road of four lanes and 16.5 m is class 4 in the map, 7.5 m wide",
            f"the mask of such roads, 10.5 m with its margins, holds {narrowed:.0f} % of their pavement (10.5 / 16.5: "
            "64 %, more at crossings and on narrower roads)",
            holds(60 <= narrowed < 95),
        ),
    ]


def _mean(rows: pd.DataFrame) -> float:
    """Over networks, by the number of runs that have such roads."""
    return float(np.average(rows["value"].to_numpy(float), weights=rows["n"].to_numpy(float)))


def _margin(result: StudyResult) -> list[Claim]:
    rows, measured = pooled(result), views(result)[1]
    names = networks(result)

    def inside(case: str, view: str, quantity: str, margin: float) -> float:
        chosen = {"estimator": case, "view": view, "quantity": f"road_{quantity}", "bin": margin}
        return 100 * float(np.mean([value(rows, network=n, **chosen) for n in names]))

    without, with_margin = (inside("exact", measured, "vehicles", m) for m in (0.0, MARGIN_M))
    whole_without, whole = (inside("exact", measured, "whole_vehicles", m) for m in (0.0, MARGIN_M))
    faulty, faulty_whole = (inside("all", measured, q, MARGIN_M) for q in ("vehicles", "whole_vehicles"))
    empty, wider = (inside("all", measured, "excess", m) for m in (0.0, MARGIN_M))
    atkis = pooled(result, ATKIS_M)
    network = str(atkis["network"].iloc[0])
    chosen = {"estimator": "displaced", "quantity": "road_vehicles", "bin": MARGIN_M, "view": measured}
    off, usual = 100 * value(atkis, **chosen), 100 * value(rows, network=network, **chosen)
    return [
        (
            f"{MARGIN_M} m on both sides keep vehicles from being lost by a wrong orientation",
            f"with a right map vehicles inside: {without:.0f} % without a margin, {with_margin:.0f} % with it; as a "
            f"whole {whole_without:.0f} and {whole:.0f} % (ANTAR, mean of the networks)",
            holds(with_margin >= 97 and with_margin > without, with_margin > without),
        ),
        (
            "the map is faulty: corrections of the roads' places are needed",
            f"with all its faults {faulty:.0f} % of the vehicles are inside, {faulty_whole:.0f} % as a whole; of the "
            f"mask {wider:.0f} % is no road ({empty:.0f} % without a margin)",
            holds(faulty < with_margin - 2),
        ),
        (
            f"ATKIS, {ATKIS_M} m off, is even less reliable",
            f"displaced by {ATKIS_M} m: {off:.0f} % of the vehicles inside, by {PUBLISHED_MEAN_M} m {usual:.0f} % "
            f"({network})",
            holds(off < usual),
        ),
    ]
