"""What the source says of its real recordings, 4.2, held against what is found on their rendered twins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from reports.claim import Claim, holds
from reports.errors import SMOOTHED
from reports.siegemund.recordings import cloud_above_table, system_error_table
from reports.studies import StudyResult

_CLEAR = 0.7  # what is clearly reduced is at most this part of what it was
_ALIKE = 0.05  # shares that differ by less are alike
_ROUGH = 3  # what is rough scatters by so many times its bound
_RAGGED = 0.05  # or changes from frame to frame by such a part of the true value
_TRACKS, _NEARLY = 120, 0.15


def _middle(values: pd.Series) -> float:
    """Half the range of the middle 68 %: a standard deviation that no single window rules."""
    low, high = values.quantile([0.16, 0.84])
    return float(high - low) / 2


def _spread(result: StudyResult, parameter: str, estimator: str | None = None) -> float:
    """Standard deviation of a parameter's errors, by their middle 68 %."""
    return _middle(_series(result, parameter, estimator)["error"])


def _series(result: StudyResult, parameter: str, estimator: str | None = None) -> pd.DataFrame:
    """Error rows of a parameter ("quantity axis") in the newest frames, by run and time; by default of the first
    estimator."""
    quantity, axis = parameter.split()
    c = result.comparison
    chosen = (c["quantity"] == quantity) & (c["axis"] == axis) & (c["entity"] != SMOOTHED)
    rows = c[chosen & (c["estimator"] == (estimator or result.estimators[0]))]
    return rows.sort_values(["run", "t_s"])


def _tracks(result: StudyResult) -> float:
    o = result.outliers
    return float(o.loc[o["estimator"] == result.estimators[0], "tracks"].mean())


def _roughness(result: StudyResult, parameter: str, estimator: str) -> float:
    """Standard deviation, by the middle 68 %, of the change of the error from a window to the one of the next frame."""
    rows = _series(result, parameter, estimator)
    steps = rows.groupby("run")[["t_s", "error"]].diff()
    return _middle(steps.loc[steps["t_s"] < 1.5 * steps["t_s"].min(), "error"])


def _reduced(ratio: float) -> str:
    return holds(ratio < _CLEAR, ratio < 1 - _ALIKE)


def _about(tracks: float) -> Claim:
    return (
        f"about {_TRACKS} tracks a window on average",
        f"{tracks:.0f}",
        holds(abs(tracks / _TRACKS - 1) < _NEARLY),
    )


def _oncoming(result: StudyResult) -> list[Claim]:
    """Figure 4.2.13."""
    z, v = _spread(result, "position z"), _spread(result, "velocity z")
    bound = float(result.select("position", "z", "crb")["value"].iloc[0])
    middle = _series(result, "position z")["distance_m"].median()
    halves = []
    for parameter in ("position z", "velocity z"):
        rows = _series(result, parameter)
        by_half = rows["error"].abs().groupby(rows["distance_m"] > middle).median()
        halves.append((float(by_half[True]), float(by_half[False])))
    y, distance = _series(result, "position y"), _series(result, "position z")
    seen = np.polyfit(distance["truth"] + distance["error"], y["truth"] + y["error"], 1)[0]
    pitch = float(next(iter(result.scenarios.values()))["rig"]["pitch_deg"])
    return [
        _about(_tracks(result)),
        (
            "clear fluctuations of the position, and so of the velocity",
            f"the middle 68 % within {z:.2f} m in depth, {z / bound:.1f} times the bound, and {v:.1f} m/s",
            holds(z > _ROUGH * bound and v > 1, z > 2 * bound),
        ),
        (
            "the farther away, the stronger",
            "median error in the farther and nearer half "
            f"{halves[0][0]:.2f} and {halves[0][1]:.2f} m, {halves[1][0]:.1f} and {halves[1][1]:.1f} m/s",
            holds(all(far > near for far, near in halves), any(far > near for far, near in halves)),
        ),
        (
            "motion in Y comes from the tilt of the camera",
            f"Y over Z falls by {np.rad2deg(np.arctan(-seen)):.2f} degrees, the camera's tilt is {-pitch:.2f}",
            holds(abs(np.rad2deg(np.arctan(-seen)) + pitch) < 0.2),
        ),
    ]


def _clouds(result: StudyResult) -> list[Claim]:
    """Figure 4.2.14."""
    table = cloud_above_table(result, distances_m=(50.0, 30.0))
    far, near = (int(n) for n in table["points"])
    return [
        _about(_tracks(result)),
        (
            "no truth: the car in the figure only illustrates",
            f"here it is the true one: {', '.join(f'{s:.0f} %' for s in table['on the car [%]'])} of the points lie on "
            f"it at {far} and {near} points",
            holds(bool((table["on the car [%]"] > 50).all())),
        ),
    ]


def _detection(result: StudyResult) -> list[Claim]:
    """Figure 4.2.15."""
    names = ("position z", "velocity x", "velocity z", "yaw_rate all")
    ratio = {n: _spread(result, n) / _spread(result, n, "plain") for n in names}
    z, v = (_spread(result, f"{q} z") for q in ("position", "velocity"))
    bounds = [float(result.select(q, "z", "crb")["value"].iloc[0]) for q in ("position", "velocity")]
    said = ", ".join(f"{r:.2f} ({n.removesuffix(' all').replace('_', ' ')})" for n, r in ratio.items())
    clear = [r < _CLEAR for r in ratio.values()]
    return [
        (
            "detection and Levenberg-Marquardt reduce the fluctuations clearly",
            f"the range of the middle 68 % becomes {said} of what it was",
            holds(all(clear), any(clear)),
        ),
        (
            "they are still there",
            f"{z:.3f} m and {v:.2f} m/s along the line of sight; what no method avoids is {bounds[0]:.3f} m and "
            f"{bounds[1]:.2f} m/s",
            holds(z > bounds[0] and v > bounds[1], z > bounds[0] or v > bounds[1]),
        ),
    ]


def _system_error(result: StudyResult) -> list[Claim]:
    """Figure 4.2.16."""
    left = system_error_table(result).set_index("estimator")["system error"]
    plain = float(left["3 batches"])
    ratio = plain / float(left["no detection"])
    solvers = {n: float(left[f"3 batches {n}"]) / plain for n in ("Levenberg-Marquardt", "line search")}
    return [
        ("detection reduces the system error clearly", f"to {ratio:.2f} of what it was", _reduced(ratio)),
        (
            "neither Levenberg-Marquardt nor line search improve it conspicuously",
            ", ".join(f"{r:.2f} of it with {n}" for n, r in solvers.items()),
            holds(all(r > 1 - _ALIKE for r in solvers.values())),
        ),
    ]


def _smoothed(result: StudyResult) -> list[Claim]:
    """Figure 4.2.17."""
    new, old = result.estimators[:2]
    T, v = (_roughness(result, p, new) / _roughness(result, p, old) for p in ("position z", "velocity z"))
    return [
        (
            "clear smoothing of translations and velocities",
            f"changes from window to window {T:.2f} (position z) and {v:.2f} (velocity z) of those without",
            holds(T < _CLEAR and v < _CLEAR, min(T, v) < _CLEAR),
        )
    ]


def _tied(result: StudyResult) -> list[Claim]:
    """Figure 4.2.18."""
    new, old = result.estimators[:2]
    T, v = (_roughness(result, p, new) / _roughness(result, p, old) for p in ("position z", "velocity z"))
    rms = [float(np.sqrt((_series(result, "velocity z", e)["error"] ** 2).mean())) for e in (new, old)]
    return [
        (
            "tied frames make the translations of consecutive windows alike",
            f"changes from window to window {T:.2f} (position z) and {v:.2f} (velocity z) of those without; "
            f"but RMS error of the velocity {rms[0]:.2f} m/s, without {rms[1]:.2f} m/s",
            holds(T < _CLEAR and v < _CLEAR, min(T, v) < _CLEAR),
        )
    ]


def _few_tracks(result: StudyResult) -> list[Claim]:
    """Figure 4.2.19."""
    course = _series(result, "driving_direction all")
    course = course[course["run"] == course["run"].iloc[0]]
    turn = float(np.rad2deg(np.ptp(np.unwrap(course["truth"]))))
    rough = {}
    for parameter in ("speed all", "yaw_rate all"):
        true = float(_series(result, parameter)["truth"].abs().median())
        rough[parameter] = (_roughness(result, parameter, result.estimators[0]), true)
    (v, speed), (w, rate) = rough.values()
    return [
        (
            "few tracks; the car turns by about 30 degrees",
            f"{_tracks(result):.0f} tracks a window; {turn:.0f} degrees while windows end",
            holds(_tracks(result) < _TRACKS / 2 and turn > 15),
        ),
        (
            "speed and yaw rate are clearly rough in spite of smoothing",
            f"changes from window to window {v:.2f} m/s and {np.rad2deg(w):.1f} deg/s where the truth is an even "
            f"{speed:.1f} m/s and {np.rad2deg(rate):.1f} deg/s",
            holds(v > _RAGGED * speed and w > _RAGGED * rate, v > _RAGGED * speed or w > _RAGGED * rate),
        ),
    ]


CLAIMS: dict[str, Callable[[StudyResult], list[Claim]]] = {
    "siegemund-fig-4-2-13": _oncoming,
    "siegemund-fig-4-2-14": _clouds,
    "siegemund-fig-4-2-15": _detection,
    "siegemund-fig-4-2-16": _system_error,
    "siegemund-fig-4-2-17": _smoothed,
    "siegemund-fig-4-2-18": _tied,
    "siegemund-fig-4-2-19": _few_tracks,
}
