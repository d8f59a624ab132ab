"""Accuracy of ortho images over passes and methods, and what costs how much (Kozempel 2012, 4.1.2)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from estimators.aerial.orthorectify import ground_sampling
from reports.studies import StudyResult
from sim.camera_systems import antar, argos

SYSTEMS = {"antar": antar(), "argos": argos()}
SOURCES = ("attitude", "position", "synchronisation", "boresight", "vibration", "interior", "clicks")
PUBLISHED_PX = 5.6
"""RMS over nine images of ANTAR; two of them are shown with 1.6 and 7.5 px (Fig. 4.4)."""
PUBLISHED_IMAGES_PX = (1.6, 7.5)
# What 3.3 reckons for ANTAR at 500 m.
_RECKONED = {"attitude": "1/3 (roll, pitch), < 1/8 (heading)", "position": "1.5"}
_DEMS = {"exact": "exact", "srtm": "SRTM", "flat": "flat"}
HEIGHTS, WHOLE = "heights: SRTM", "all, heights SRTM"
"""Rows of a `budget`: what SRTM's heights cost, and all errors with them."""
_KNOWN = ("system", "height_m", "errors", "dem", "gsd_m")
BEST = "exact"
"""The method that adds nothing of its own."""


def settings(result: StudyResult) -> pd.DataFrame:
    """Columns system, height_m, errors, dem, gsd_m by point."""
    table = pd.DataFrame({p: {k: s[k] for k in _KNOWN[:-1]} for p, s in result.scenarios.items()}).T
    heads = [SYSTEMS[name].heads[0].camera for name in table["system"]]
    table["gsd_m"] = [ground_sampling(float(h), c) for h, c in zip(table["height_m"], heads, strict=True)]
    return table


def pooled(result: StudyResult) -> pd.DataFrame:
    """Metrics with the settings of their point; px, px_low, px_high are value and interval in pixels of the map."""
    rows = result.metrics.join(settings(result), on="point")
    for name, column in (("px", "value"), ("px_low", "ci_low"), ("px_high", "ci_high")):
        rows[name] = rows[column].astype(float) / rows["gsd_m"].astype(float)
    rows["bin"] = rows["bin"].astype(float)
    return rows


def single(result: StudyResult, quantity: str) -> pd.DataFrame:
    """What every run has measured: columns of `settings`, run, estimator, t_s, value [m] and px."""
    rows = result.measures[result.measures["quantity"] == quantity].join(settings(result), on="point")
    return rows.assign(px=rows["value"].astype(float) / rows["gsd_m"].astype(float))


def of(rows: pd.DataFrame, **chosen: object) -> pd.DataFrame:
    """The rows whose columns have these values."""
    keep = np.ones(len(rows), bool)
    for column, value in chosen.items():
        keep &= (rows[column] == value).to_numpy()
    return rows[keep]


def px(rows: pd.DataFrame, **chosen: object) -> float:
    """The one value in pixels that is meant.

    Raises
        ValueError: the study does not have it, or more than one.
    """
    found = of(rows, **chosen)
    if len(found) != 1:
        raise ValueError(f"ortho: {len(found)} values of {chosen}, one is needed")
    return float(found["px"].iloc[0])


def systems(result: StudyResult) -> list[str]:
    return list(dict.fromkeys(settings(result)["system"]))


def passes_table(result: StudyResult, *, dem: str = "srtm") -> pd.DataFrame:
    """All sources of error together: RMS of every system and method, its parts, and the spread over passes and images.

    Squares of common, passes, images and within add up to that of the RMS. Ranges hold 90 % of single passes, images.
    """
    rows = of(pooled(result), errors="all", dem=dem)
    spread = {name: of(single(result, f"ortho_{name}"), errors="all", dem=dem) for name in ("pass", "image")}
    out = []
    for system in systems(result):
        for method in result.estimators:
            mine = of(rows, system=system, estimator=method)
            whole = of(mine, quantity="ortho").iloc[0]
            row: dict[str, object] = {"system": system, "method": method, "RMS [m]": whole["value"]}
            row |= {"RMS [px]": whole["px"], "from": whole["px_low"], "to": whole["px_high"]}
            row["the source [px]"] = f"{PUBLISHED_PX}" if (system, method) == ("antar", BEST) else ""
            for part in ("common", "passes", "images", "within"):
                row[f"{part} [px]"] = px(mine, quantity=f"ortho_{part}")
            for name, table in spread.items():
                low, high = np.quantile(of(table, system=system, estimator=method)["px"], [0.05, 0.95])
                row[f"one {name} [px]"] = f"{low:.1f} … {high:.1f}"
            out.append(row)
    return pd.DataFrame(out)


def budget(result: StudyResult, system: str) -> pd.DataFrame:
    """Sources of error, each alone: simulated and predicted RMS [px]; methods and heights with all else known."""
    rows = of(pooled(result), system=system, bin=0.0)
    cases = [(s, {"errors": s, "dem": "exact", "estimator": BEST}) for s in SOURCES]
    cases += [(f"heights: {_DEMS[d]}", {"errors": "none", "dem": d, "estimator": BEST}) for d in ("srtm", "flat")]
    cases += [
        (f"method: {m}", {"errors": "none", "dem": "exact", "estimator": m}) for m in ("map", "forward", "anchor")
    ]
    cases += [(f"all, heights {_DEMS[d]}", {"errors": "all", "dem": d, "estimator": BEST}) for d in _DEMS]
    found = [
        (name, px(rows, quantity="ortho", **case), px(rows, quantity="ortho_predicted", **case)) for name, case in cases
    ]
    return pd.DataFrame(found, columns=["source", "simulated", "predicted"])


def budget_table(result: StudyResult) -> pd.DataFrame:
    """The budget of every system, beside what the source reckons; shares are those of the variance of all with SRTM."""
    out = []
    for system in systems(result):
        table = budget(result, system).set_index("source")
        whole = float(table["simulated"][WHOLE])
        gsd_m = float(of(settings(result), system=system)["gsd_m"].iloc[0])
        for name, row in table.iterrows():
            part = str(name) in (*SOURCES, HEIGHTS)
            out.append(
                {
                    "system": system,
                    "error": name,
                    "simulated [px]": row["simulated"],
                    "predicted [px]": row["predicted"],
                    "simulated [m]": row["simulated"] * gsd_m,
                    "share [%]": 100 * (row["simulated"] / whole) ** 2 if part else np.nan,
                    "the source [px]": _reckoned(system, str(name)),
                }
            )
    return pd.DataFrame(out)


def _reckoned(system: str, name: str) -> str:
    if system != "antar":
        return ""
    return str(PUBLISHED_PX) if name == WHOLE else _RECKONED.get(name, "")


def methods_table(result: StudyResult) -> pd.DataFrame:
    """Methods over models of the heights with true orientation: RMS of all, in the middle and at the border [px]."""
    rows = pooled(result)
    out = []
    for system in systems(result):
        for dem in ("exact", "srtm", "flat"):
            for method in result.estimators:
                mine = of(rows, system=system, dem=dem, estimator=method)
                known = of(mine, errors="none")
                zones = of(known, quantity="ortho_zone").sort_values("bin")["px"]
                whole = of(known, quantity="ortho").iloc[0]
                out.append(
                    {
                        "system": system,
                        "heights": dem,
                        "method": method,
                        "RMS [px]": whole["px"],
                        "RMS [m]": whole["value"],
                        "middle [px]": zones.iloc[0],
                        "border [px]": zones.iloc[-1],
                        "with all errors [px]": px(mine, errors="all", quantity="ortho"),
                        "not in the map [%]": 100 * float(of(known, quantity="ortho_lost")["value"].iloc[0]),
                    }
                )
    return pd.DataFrame(out)
