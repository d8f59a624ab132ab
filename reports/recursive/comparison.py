"""Two estimators on the same observations: where each is better, with paired 95 % intervals over whole runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from jaxtyping import Float

from reports.bootstrap import interval_of_sums
from reports.recursive.situations import STEADY_S, Curves, curves, nees_of, situations
from reports.studies import StudyResult

Array = np.ndarray
Sums = Callable[[str], Array]
Summands = Callable[[Curves], Array]
SETTLED = {"position": 0.1, "speed": 1.0}  # RMS over the runs, m and m/s
_NEVER = 1e6
TURNED, BRAKED = 0.2, 1.0  # rad/s² and m/s²: less is no manoeuvre


@dataclass(frozen=True, eq=False)
class Aspect:
    """One thing two estimators are compared in: summands of every run (r, q), and what their sums come to.

    Best is zero, so absolute values are compared.
    """

    name: str
    unit: str
    sums: Sums
    finish: Callable[[Array], Array]


def difference(aspect: Aspect, first: str, second: str) -> tuple[float, float, float, float, float]:
    """Value of both estimators, and how much farther from the best the first is, with its 95 % interval.

    Whole runs are drawn, the same ones for both: what a run's noise does to both cancels.
    """
    a, b = aspect.sums(first), aspect.sums(second)
    q = a.shape[1]

    def apart(x: Array) -> Array:
        return np.asarray(np.abs(aspect.finish(x[..., :q])) - np.abs(aspect.finish(x[..., q:])))

    both = np.concatenate([a, b], axis=1)
    low, high = interval_of_sums(apart, both)
    total = both.sum(axis=0)
    return float(aspect.finish(total[:q])), float(aspect.finish(total[q:])), float(apart(total)), low, high


def better_table(result: StudyResult, *, first: str = "filter", second: str = "adjustment") -> pd.DataFrame:
    """Every aspect in every situation: both estimators, the paired difference with its interval, and who is better.

    Raises
        ValueError: an estimator the study does not have.
    """
    for label in (first, second):
        if label not in result.estimators:
            raise ValueError(f"found {label!r}, allowed: {', '.join(result.estimators)}")
    rows = []
    for where, point in situations(result).items():
        for aspect in aspects(result, where, point):
            a, b, apart, low, high = difference(aspect, first, second)
            unit = "" if aspect.unit == "1" else f" [{aspect.unit}]"
            row: dict[str, object] = {"situation": where, "aspect": aspect.name + unit}
            row["better"] = verdict(low, high, first, second)
            rows.append(row | {first: a, second: b, "difference": apart, "from": low, "to": high})
    return pd.DataFrame(rows)


def verdict(low: float, high: float, first: str, second: str) -> str:
    """Who is nearer to the best, by the interval of how much farther the first is; neither where it holds zero."""
    return first if high < 0 else second if low > 0 else "neither"


def aspects(result: StudyResult, where: str, point: str) -> Iterator[Aspect]:
    """What is compared in a situation."""

    def of(quantity: str, summands: Summands, axis: str | None = None, since: float = STEADY_S) -> Sums:
        return lambda estimator: summands(curves(result, point, estimator, quantity, axis).since(since))

    def consistency(quantity: str) -> Sums:
        return lambda estimator: _sum(nees_of(result, point, estimator, quantity).since(STEADY_S))

    if where == "constant velocity":
        for quantity, limit in SETTLED.items():
            t_s = curves(result, point, result.estimators[0], quantity).t_s
            sums = of(quantity, _squares_over_time, since=0.0)
            yield Aspect(f"settling time of {quantity}", "s", sums, _settled(t_s, limit))
        yield Aspect("bias of depth", "m", of("position", _sum, "z"), _mean)
        yield Aspect("bias of speed", "m/s", of("speed", _sum), _mean)
    for quantity, unit in (("position", "m"), ("orientation", "rad"), ("speed", "m/s"), ("yaw_rate", "rad/s")):
        yield Aspect(f"RMS of {quantity.replace('_', ' ')}", unit, of(quantity, _squares), _root_mean)
    if "wrong" not in where:
        for quantity in ("pose", "velocity"):
            yield Aspect(f"NEES of {quantity}, logarithm", "1", consistency(quantity), _log_mean)
    if where == "braking":
        yield Aspect("lag of speed", "s", of("speed", partial(lag_sums, least=BRAKED), since=0.0), _mean)
    if where == "turning":
        yield Aspect("lag of yaw rate", "s", of("yaw_rate", partial(lag_sums, least=TURNED), since=0.0), _mean)


def _squares_over_time(c: Curves) -> Array:
    """Squared error at every time; no estimate is as bad as can be."""
    squares = np.nan_to_num(np.sum(c.error**2, axis=-1), nan=_NEVER)
    return np.concatenate([squares, np.ones((len(squares), 1))], axis=1)


def _settled(t_s: Array, limit: float) -> Callable[[Array], Array]:
    """From when on the RMS over runs stays below a limit; the last time where it never does."""

    def finish(sums: Array) -> Array:
        late = np.sqrt(sums[..., :-1] / sums[..., -1:]) > limit
        last = late.shape[-1] - np.argmax(late[..., ::-1], axis=-1)
        return np.asarray(t_s[np.where(late.any(axis=-1), np.minimum(last, len(t_s) - 1), 0)])

    return finish


def _sum(c: Curves) -> Array:
    return np.stack([np.nansum(c.error[..., 0], axis=1), np.isfinite(c.error[..., 0]).sum(axis=1)], axis=1)


def _squares(c: Curves) -> Array:
    squares = np.sum(c.error**2, axis=-1)
    return np.stack([np.nansum(squares, axis=1), np.isfinite(squares).sum(axis=1)], axis=1)


def lag_sums(c: Curves, least: float) -> Float[Array, "r 2"]:
    """Summands of the lag tau that explains errors best, e(t) = -tau dx/dt, while the truth changes fast enough."""
    known = np.isfinite(c.truth[..., 0]).any(axis=0)
    truth, error = c.truth[:, known, 0], c.error[:, known, 0]
    rate = np.gradient(np.nanmean(truth, axis=0), c.t_s[known])
    used = np.isfinite(error) & (np.abs(rate) >= least)
    return np.stack([-np.sum(np.where(used, error * rate, 0), axis=1), np.sum(used * rate**2, axis=1)], axis=1)


def _mean(s: Array) -> Array:
    return np.asarray(s[..., 0] / s[..., 1])


def _root_mean(s: Array) -> Array:
    return np.asarray(np.sqrt(s[..., 0] / s[..., 1]))


def _log_mean(s: Array) -> Array:
    return np.asarray(np.log(s[..., 0] / s[..., 1]))
