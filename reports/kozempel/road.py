"""A faulty road map in ortho images: what its mask holds of roads and vehicles (Kozempel 2012, 4.2.2)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from reports.kozempel.ortho import of
from reports.studies import StudyResult
from sim.roads import SECTIONS

PUBLISHED_MEAN_M, PUBLISHED_MAX_M = 1.7, 6.1
"""Of ten checked points of the road map, the mean and the largest displacement."""
ATKIS_M = 3.3
MARGIN_M = 1.5
"""What the source adds to both sides of a road's RAS-Q width."""
_KNOWN = ("network", "system", "height_m", "orientation", "displacement_m")


def settings(result: StudyResult) -> pd.DataFrame:
    """Columns network, system, height_m, orientation, displacement_m and view (how images are oriented) by point."""
    table = pd.DataFrame({p: {k: s[k] for k in _KNOWN} for p, s in result.scenarios.items()}).T
    table["view"] = [
        "known" if r["orientation"] == "known" else f"{str(r['system']).upper()} at {float(r['height_m']):.0f} m"
        for _, r in table.iterrows()
    ]
    return table


def pooled(result: StudyResult, displacement_m: float = PUBLISHED_MEAN_M) -> pd.DataFrame:
    """Metrics of the maps with this mean displacement, with the settings of their point; bin is a number."""
    rows = result.metrics.join(settings(result), on="point")
    rows["bin"] = rows["bin"].astype(float)
    return of(rows, displacement_m=displacement_m)


def single(result: StudyResult, quantity: str) -> pd.DataFrame:
    """What single runs have measured, once for every network and displacement: orientation changes nothing in the map.

    Columns of `settings`, run, t_s and value.
    """
    known = settings(result).drop_duplicates(["network", "displacement_m"])
    rows = result.measures[result.measures["quantity"] == quantity]
    return rows[rows["point"].isin(known.index)].join(known, on="point")


def value(rows: pd.DataFrame, **chosen: object) -> float:
    """The one value that is meant, or NaN.

    Raises
        ValueError: the study has more than one.
    """
    found = of(rows, **chosen)
    if len(found) > 1:
        raise ValueError(f"road: {len(found)} values of {chosen}, one is needed")
    return float(found["value"].iloc[0]) if len(found) else np.nan


def networks(result: StudyResult) -> list[str]:
    return list(dict.fromkeys(settings(result)["network"]))


def views(result: StudyResult) -> list[str]:
    return list(dict.fromkeys(settings(result)["view"]))


def faults_table(result: StudyResult, *, margin_m: float = MARGIN_M) -> pd.DataFrame:
    """Every kind of fault alone and all together: what is inside the mask [%], with known orientation and with ANTAR's.

    concerned: of pavement of the roads that the fault concerns (displaced: by more than 5 m across), known orientation.
    """
    rows = of(pooled(result), bin=margin_m)
    measured = views(result)[1]
    out = []
    for network in networks(result):
        for case in result.estimators:
            mine = of(rows, network=network, estimator=case)
            row: dict[str, object] = {"network": network, "map": case}
            for view, mark in (("known", ""), (measured, f", {measured.split()[0]}")):
                for quantity in ("pavement", "vehicles", "whole_vehicles"):
                    name = f"{quantity.replace('_', ' ')} [%]{mark}"
                    row[name] = 100 * value(mine, view=view, quantity=f"road_{quantity}")
            row["mask without a road [%]"] = 100 * value(mine, view="known", quantity="road_excess")
            row["concerned [%]"] = 100 * value(mine, view="known", quantity="road_affected")
            out.append(row)
    return pd.DataFrame(out)


def classes_table(result: StudyResult, *, case: str = "all") -> pd.DataFrame:
    """RAS-Q classes over margins: pavement and middles of vehicles inside the mask [%], orientation of ANTAR."""
    rows = of(pooled(result), estimator=case, view=views(result)[1])
    margins = sorted(set(of(rows, quantity="road_pavement")["bin"]))
    out = []
    for network in networks(result):
        for k, section in enumerate(SECTIONS):
            row: dict[str, object] = {"network": network, "class": f"{k} ({section.name})"}
            for quantity in ("pavement", "vehicles"):
                mine = of(rows, network=network, quantity=f"road_{quantity}_{k}")
                row |= {f"{quantity}, {m:g} m": 100 * value(mine, bin=m) for m in margins}
            if not np.isnan([v for v in row.values() if isinstance(v, float)]).all():
                out.append(row)
    return pd.DataFrame(out)


def margins_table(result: StudyResult) -> pd.DataFrame:
    """Margins over orientations with all faults: pavement and vehicles inside, and mask without a road [%]."""
    rows = of(pooled(result), estimator="all")
    out = []
    for network in networks(result):
        for view in views(result):
            mine = of(rows, network=network, view=view)
            for margin in sorted(set(of(mine, quantity="road_pavement")["bin"])):
                row: dict[str, object] = {"network": network, "orientation": view, "margin [m]": margin}
                for quantity in ("pavement", "vehicles", "whole_vehicles"):
                    row[f"{quantity.replace('_', ' ')} [%]"] = 100 * value(
                        mine, bin=margin, quantity=f"road_{quantity}"
                    )
                row["mask without a road [%]"] = 100 * value(mine, bin=margin, quantity="road_excess")
                out.append(row)
    return pd.DataFrame(out)
