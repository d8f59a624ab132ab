"""Two estimators over the same runs: the difference of a statistic, its interval and whether it may be chance.

Both saw the same observations, so what a run's noise does to both cancels in the difference: far fewer runs tell two
estimators apart than two separate intervals would need.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from reports.bootstrap import interval_of_sums
from reports.metrics import Stack, stacks
from reports.statistics import STATISTICS, Statistic
from sim.streams import stream

Array = np.ndarray
_SWAPS = 9999
_CHUNK = 4_000_000


@dataclass(frozen=True)
class Paired:
    """Statistic of the first estimator, of the second, and first minus second with its 95 % interval.

    p: probability of a difference as large where the two are exchangeable; runs that both have; unpaired: rows that
    only one of them has, left out. Of a bias, whose best is zero, the absolute values are compared.
    """

    first: float
    second: float
    difference: float
    ci_low: float
    ci_high: float
    p: float
    runs: int
    unpaired: int


def paired(
    comparison: pd.DataFrame,
    first: str,
    second: str,
    *,
    quantity: str,
    axis: str,
    statistic: str,
    entity: str,
) -> Paired:
    """Compares two estimators on the error rows (run, estimator, quantity, t_s, entity, axis, error, bound) of a point.

    The interval draws whole runs, the same for both. The p value (two-sided) is that of 9999 random swaps of the two
    within runs: no distribution is assumed. A statistic that does not come from sums is averaged over the runs.

    Raises
        ValueError: an unknown statistic, or fewer than two runs in common.
    """
    if statistic not in STATISTICS:
        raise ValueError(f"statistic: found {statistic!r}, allowed: {', '.join(STATISTICS)}")
    s = STATISTICS[statistic]
    a, b, unpaired = _common(comparison, (first, second), quantity, axis, entity, s.needs_bound)
    runs = len(np.unique(a.run))
    if runs < 2:
        raise ValueError(
            f"{first!r} and {second!r} have {runs} runs of {quantity} {axis} in common, expected 2 or more"
        )
    sums = np.stack([_summands(s, a), _summands(s, b)])

    def finish(x: Array) -> Array:
        value = s.finish(x) if s.finish is not None else x[..., 0] / x[..., 1]
        return np.asarray(np.abs(value) if s.direction == "zero" else value)

    q = sums.shape[2]
    of_both = np.concatenate(list(sums), axis=1)
    low, high = interval_of_sums(lambda x: finish(x[..., :q]) - finish(x[..., q:]), of_both)
    values = finish(sums.sum(axis=1))
    difference = float(values[0] - values[1])
    swapped = _swapped(finish, sums, stream(0, 0, "paired/swaps"))
    larger = np.count_nonzero(np.abs(swapped) >= abs(difference) * (1 - 1e-12))
    p = (1 + larger) / (1 + _SWAPS)
    return Paired(float(values[0]), float(values[1]), difference, low, high, float(p), runs, unpaired)


def _common(
    comparison: pd.DataFrame, labels: tuple[str, str], quantity: str, axis: str, entity: str, bounded: bool
) -> tuple[Stack, Stack, int]:
    """Rows of both estimators at the same runs and times."""
    rows = comparison[(comparison["quantity"] == quantity) & (comparison["entity"] == entity)]
    parts = [rows[rows["estimator"] == label] for label in labels]
    if bounded:
        parts = [p[np.isfinite(p["bound"])] for p in parts]
    keys = [pd.MultiIndex.from_frame(p[["run", "t_s"]]) for p in parts]
    unpaired = len(keys[0].unique().symmetric_difference(keys[1].unique()))
    both = [p[key.isin(other)] for p, key, other in zip(parts, keys, reversed(keys), strict=True)]
    if both[0].empty:
        return Stack(np.empty(0, int), np.empty((0, 2))), Stack(np.empty(0, int), np.empty((0, 2))), unpaired
    return stacks(both[0])[axis], stacks(both[1])[axis], unpaired


def _summands(s: Statistic, stack: Stack) -> Float[Array, "r q"]:
    """Sums of every run; of a statistic that has none its value in every run, and one."""
    if s.sums is not None:
        return stack.per_run(s)
    starts = np.flatnonzero(np.append(True, stack.run[1:] != stack.run[:-1]))
    return np.array([(float(s.pool(v)), 1.0) for v in np.split(stack.values, starts[1:])])


def _swapped(
    finish: Callable[[Array], Array], sums: Float[Array, "2 r q"], rng: np.random.Generator
) -> Float[Array, "swaps"]:
    """Differences with the two estimators swapped in a random half of the runs."""
    total, difference = sums.sum(axis=(0, 1)), sums[0] - sums[1]
    step = max(1, _CHUNK // len(difference))
    found = []
    for done in range(0, _SWAPS, step):
        sign = rng.integers(0, 2, (min(step, _SWAPS - done), len(difference))) * 2.0 - 1
        d = sign @ difference
        found.append(finish((total + d) / 2) - finish((total - d) / 2))
    return np.concatenate(found)
