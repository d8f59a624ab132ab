"""What the source says of its experiments in words, held against what a study has found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from reports.claim import Claim, holds
from reports.siegemund.datum import datum_table
from reports.siegemund.detectors import counts
from reports.siegemund.matrices import beside_the_diagonal, structure_table, system
from reports.siegemund.recording_statements import CLAIMS as RECORDINGS
from reports.studies import StudyResult

_SPARSE = 33  # per cent of the elements
_ROUGH = 3  # a difference of two frames scatters by so many times what the mean over a window would


def claims(result: StudyResult) -> pd.DataFrame:
    """One row per statement of the source: what it says, what was found, whether it holds (yes, in part, no).

    Raises
        KeyError: the source says nothing of a study of this name.
    """
    found = _CLAIMS[result.name](result)
    return pd.DataFrame(found, columns=["the source says", "found here", "holds"])


def _detectors(result: StudyResult) -> list[Claim]:
    t = counts(result)
    few, half = t[t["theta"] <= 30], t[t["theta"] == 50]
    tracks, points = few[few["estimator"] == "tracks"], few[few["estimator"] == "points"]
    capped = half[half["estimator"].isin(["tracks", "points"])]
    off = float((capped["fn"] - capped["fp"] - 7).abs().max())
    ratio = float(points["fp"].mean() / max(tracks["fp"].mean(), 0.01))
    known = t[t["estimator"] == "prior knowledge"]
    by_rho = known.pivot_table(index="theta", columns="rho", values="fn")[[10, 5, 1]]
    grows = bool((np.diff(by_rho.to_numpy(), axis=1) > 0).all())
    fp, fn = tracks["fp"], float(tracks["fn"].max())
    return [
        (
            "track-wise, up to 30 % wrong: fp 0.6 to 1.5, fn at most 0.04",
            f"fp {fp.min():.1f} to {fp.max():.1f}, fn at most {fn:.2f}",
            holds(fp.max() <= 1.5 and fn <= 0.04, fp.max() <= 3 and fn <= 0.3),
        ),
        (
            "point-wise drops clearly more good tracks than track-wise",
            f"{ratio:.0f} times as many",
            holds(ratio > 3),
        ),
        ("both find less where 50 % are wrong: fn = 7 + fp", f"fn = 7 + fp to {off:.2f}", holds(off <= 0.1)),
        (
            "prior knowledge drops no good track",
            f"fp at most {known['fp'].max():.2f}",
            holds(known["fp"].max() < 0.05),
        ),
        (
            "prior knowledge misses the more, the fewer frames are wrong",
            f"fn at 30 %: {', '.join(f'{v:.1f}' for v in by_rho.loc[30])} for 10, 5, 1 frames",
            holds(grows),
        ),
    ]


def _datum(result: StudyResult) -> list[Claim]:
    moved = datum_table(result).set_index("start values")["origin moved by [m]"]
    cloud, propagated = float(moved["from the cloud"]), float(moved["propagated"])
    return [
        (
            "start values from the cloud: the change shows clearly",
            f"origin moves by {cloud:.2f} m",
            holds(cloud > 0.5),
        ),
        ("propagated: no effect", f"origin moves by {propagated:.2f} m", holds(propagated < 0.1)),
    ]


def _bias(result: StudyResult, estimator: str) -> tuple[float, float, float]:
    rows = result.select("position", "z", "bias")
    value, low, high = rows.loc[rows["estimator"] == estimator, ["value", "ci_low", "ci_high"]].to_numpy(float)[0]
    return value, low, high


def _metres(bias: tuple[float, float, float]) -> str:
    return f"{bias[0]:+.2f} m, 95 %: {bias[1]:+.2f} to {bias[2]:+.2f} m"


def _observed(result: StudyResult) -> list[Claim]:
    b = _bias(result, "observed")
    return [("weights from observed points: systematically too near", _metres(b), holds(b[2] < 0))]


def _averaged(result: StudyResult) -> list[Claim]:
    before, b = _bias(result, "observed"), _bias(result, "averaged")
    cured = b[1] <= 0 <= b[2]
    return [("averaged weights cure that", _metres(b), holds(cured, abs(b[0]) < abs(before[0]) / 2))]


def _estimated(result: StudyResult) -> list[Claim]:
    first, second = _bias(result, "estimated"), _bias(result, "estimated second order")
    cured = second[1] <= 0 <= second[2]
    return [
        ("weights from estimated points: systematically too far", _metres(first), holds(first[1] > 0)),
        ("terms of second order cure that", _metres(second), holds(cured, abs(second[0]) < abs(first[0]) / 3)),
    ]


def _rough(result: StudyResult) -> list[Claim]:
    std = [float(result.select("velocity", axis, "std")["value"].iloc[0]) for axis in "xz"]
    c = result.comparison
    speeds = c[(c["quantity"] == "velocity") & (c["axis"] == "z") & (c["run"] == 0)].sort_values("t_s")
    step = float(np.abs(np.diff(speeds["truth"])).max())
    return [
        (
            "differential parameters are clearly rough",
            f"standard deviation {std[0]:.2f} (x) and {std[1]:.2f} m/s (z); true steps {step:.2f} m/s",
            holds(std[1] > _ROUGH * step),
        )
    ]


def _crossing(result: StudyResult) -> list[Claim]:
    """Not only motion along the axis of view."""
    eff = {a: float(result.select("position", a, "efficiency")["value"].iloc[0]) for a in "xz"}
    return [
        (
            "it works across the axis of view, too",
            f"bound / RMS of position {eff['x']:.2f} (x) and {eff['z']:.2f} (z)",
            holds(min(eff.values()) > 0.5),
        )
    ]


def _turning(result: StudyResult) -> list[Claim]:
    c = result.comparison
    steps = {
        q: float(np.abs(np.diff(rows.sort_values("t_s")["truth"])).max())
        for q in ("speed", "centroid_speed")
        for rows in [c[(c["quantity"] == q) & (c["run"] == 0)]]
    }
    return [
        (
            "jumps of the speed are those of the truth, by the choice of the reference point",
            f"largest true step {steps['centroid_speed']:.2f} m/s (centroid), {steps['speed']:.2f} m/s (rear axle)",
            holds(steps["centroid_speed"] > 5 * steps["speed"]),
        )
    ]


def _matrices(result: StudyResult) -> list[Claim]:
    t = structure_table(result)
    large = t[t["points"] == t["points"].max()].set_index("matrix")["share [%]"]
    filled = ", ".join(f"{name} {share:.2g} %" for name, share in large.items())
    beside = sum(beside_the_diagonal(system(result.example(str(point)))) for point in result.points.index)
    return [
        ("all matrices are sparse", f"filled, of the larger system: {filled}", holds(float(large.max()) < _SPARSE)),
        (
            "the points' part of N has nothing beside its diagonal of 3 x 3 blocks",
            f"{beside} elements beside it",
            holds(beside == 0),
        ),
    ]


_CLAIMS: dict[str, Callable[[StudyResult], list[Claim]]] = {
    "siegemund-table-3-4-1": _detectors,
    "siegemund-fig-3-7-10": _datum,
    "siegemund-fig-4-1-4": _observed,
    "siegemund-fig-4-1-6": _averaged,
    "siegemund-fig-4-1-7": _estimated,
    "siegemund-fig-4-1-8": _rough,
    "siegemund-fig-4-1-9": _crossing,
    "siegemund-fig-4-1-10": _turning,
    "siegemund-fig-c-0": _matrices,
} | RECORDINGS
