"""Two measurements of the same battery, paired by run: which metrics are better, the same, worse.

A metric has become worse where three things hold:

- its value over all runs is worse, in the direction the metric registry gives it;
- the difference is at least the smallest that matters (`checked.CHECKED`);
- chance would not have brought it about. If neither code is better, old and new may change places in every run: of all
  2^n such exchanges, made in all metrics at once, at most 1 % may show any metric that differs by what matters and as
  consistently, ``z = |sum d| / sqrt(sum d²)`` over the paired differences d. So the chance of a single false alarm in
  the whole battery is at most 1 %, however many metrics it has and however they hang together (Westfall and Young 1993,
  single step).

Three changes need no such test: of a metric that counts what must not happen at all (failed windows), of the number of
runs that give a value, and of an RMS to beyond ten times its largest of all runs before: the estimate has come apart.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from reports.regression.checked import CHECKED, METRIC, Matters, Metric

Array = np.ndarray
LEVEL = 0.01
APART = 10.0
MIN_RUNS, MAX_RUNS = 8, 12  # fewer can never be significant; of more not all exchanges could be looked at
SETUP = ["scene", "config", "estimator"]
KEY = [*SETUP, *METRIC]
LABELS = [*KEY, "unit", "direction"]
VERDICTS = ("worse", "better", "new", "missing", "same")
_UNCHECKED = Matters(0.0, np.inf)
_ROUNDING = 1e-9


def compare(old: pd.DataFrame, new: pd.DataFrame, checked: Mapping[Metric, Matters] = CHECKED) -> pd.DataFrame:
    """One row per metric: the columns of `LABELS`; old and new, its values over all runs; change (positive is worse)
    and the smallest that matters, both in its unit; p, corrected for the number of metrics; verdict and reason.

    old, new: the columns of `LABELS` and one per run, named by its number; NaN where a run gave no value. A metric
    without a baseline is "new", one that is no longer measured "missing"; but where its scene and estimator still are,
    all its runs are without a value.
    """
    labels = pd.concat([new[LABELS], old[LABELS]]).drop_duplicates(KEY, ignore_index=True)
    index, runs = pd.MultiIndex.from_frame(labels[KEY]), [c for c in new.columns if c not in LABELS]
    x_old, x_new = (t.set_index(KEY).reindex(index=index, columns=runs).to_numpy(float) for t in (old, new))
    pairs = Pairs(labels["statistic"].to_numpy(str), labels["direction"].to_numpy(str), x_old, x_new)
    matters = [checked.get(m, _UNCHECKED) for m in labels[METRIC].itertuples(index=False, name=None)]
    smallest = _smallest(labels, pairs.scale, matters)
    certain = np.array([m.certain for m in matters], bool)
    change, p = pairs.change, pairs.chance(np.where(certain, np.inf, smallest))
    way = np.sign(change) * (np.abs(change) >= smallest)
    reasons = {
        "must not happen": way * certain,
        "runs without a value": pairs.lost,
        "came apart": way * (pairs.apart == way),
        "": way * (p <= LEVEL),
    }
    here = _among(labels, new, SETUP) & np.array([m is not _UNCHECKED for m in matters], bool)
    compared = _among(labels, old, KEY) & (_among(labels, new, KEY) | here)
    sign = _way(reasons.values()) * compared
    verdict = np.select(
        [sign > 0, sign < 0, compared, _among(labels, old, KEY)], ["worse", "better", "same", "missing"], "new"
    )
    table = labels.assign(old=pairs.pooled(x_old), new=pairs.pooled(x_new))
    known = compared & np.isfinite(table[["old", "new"]]).all(axis=1)
    numbers = {"change": change, "smallest": smallest, "p": p}
    return table.assign(
        **{name: np.where(known, x, np.nan) for name, x in numbers.items()},
        verdict=verdict,
        reason=np.select([s * sign > 0 for s in reasons.values()], list(reasons), ""),
    )


def _among(labels: pd.DataFrame, table: pd.DataFrame, columns: list[str]) -> Bool[Array, "k"]:
    return np.asarray(pd.MultiIndex.from_frame(labels[columns]).isin(pd.MultiIndex.from_frame(table[columns])))


def _way(signs: Iterable[Array]) -> Float[Array, "k"]:
    """1 where any sign is positive, else -1 where any is negative."""
    stacked = np.stack(list(signs))
    return np.where((stacked > 0).any(axis=0), 1.0, -1.0 * (stacked < 0).any(axis=0))


def _smallest(labels: pd.DataFrame, scale: Float[Array, "k"], matters: Sequence[Matters]) -> Float[Array, "k"]:
    """The smallest difference that matters, of every metric in its unit."""
    as_rms = pd.MultiIndex.from_frame(labels[KEY].replace({"statistic": {"bias": "rms"}}))
    size = pd.Series(scale, pd.MultiIndex.from_frame(labels[KEY])).reindex(as_rms).fillna(0).to_numpy(float)
    return np.asarray(np.maximum(np.array([m.relative for m in matters]) * size, [m.absolute for m in matters]))


@dataclass(frozen=True, eq=False)
class Pairs:
    """Values of k metrics in r runs, old and new, NaN where a run gave none; statistic and direction (k,) of each."""

    statistic: Array
    direction: Array
    old: Float[Array, "k r"]
    new: Float[Array, "k r"]

    def pooled(self, values: Float[Array, "k r"]) -> Float[Array, "k"]:
        """Values over all runs: the mean, of an RMS the root of the mean square; NaN where no run has any."""
        finite = np.isfinite(values)
        with np.errstate(invalid="ignore"):
            mean = self._power(np.where(finite, values, 0)).sum(axis=1) / finite.sum(axis=1)
        return self._root(np.asarray(mean))

    @property
    def change(self) -> Float[Array, "k"]:
        """By how much new is worse than old, over the runs that have both."""
        return np.asarray(self._changes(np.ones((1, self.old.shape[1])))[0])

    @property
    def scale(self) -> Float[Array, "k"]:
        """Size of a metric, the same whichever of the two is old."""
        old, new = self._powers
        return np.asarray(np.abs(self._root((old + new).sum(axis=1) / 2)))

    @property
    def lost(self) -> Float[Array, "k"]:
        """Positive where fewer runs give a value than before, negative where more do."""
        old, new = (np.isfinite(x).sum(axis=1) for x in (self.old, self.new))
        return np.asarray(np.sign(old - new), float)

    @property
    def apart(self) -> Float[Array, "k"]:
        """1 where a new RMS is beyond what any old one suggests, -1 where it is the other way round."""
        old, new = (np.nan_to_num(x).max(axis=1, initial=0) for x in (self.old, self.new))
        sign = np.where(new > APART * old, 1.0, 0.0) - np.where(old > APART * new, 1.0, 0.0)
        return np.where(self.statistic == "rms", sign, 0.0)

    def chance(self, smallest: Float[Array, "k"]) -> Float[Array, "k"]:
        """Share of all exchanges of old and new that let any metric differ by what matters and as consistently."""
        signs = np.array([(1, *rest) for rest in itertools.product((1.0, -1.0), repeat=self.old.shape[1] - 1)])
        d = np.where(self._paired, np.nan_to_num(self.new) - np.nan_to_num(self.old), 0)
        length = np.sqrt((d * d).sum(axis=1))
        z = np.abs(signs @ np.divide(d, length[:, None], out=np.zeros_like(d), where=length[:, None] > 0).T)
        z[np.abs(self._changes(signs)) < smallest] = 0
        return np.asarray((z.max(axis=1)[:, None] >= z[0] - _ROUNDING).mean(axis=0))

    def _changes(self, signs: Float[Array, "s r"]) -> Float[Array, "s k"]:
        """Changes where old and new are exchanged in the runs whose sign is negative."""
        old, new = self._powers
        middle, half = (old + new).sum(axis=1) / 2, signs @ (new - old).T / 2
        return np.asarray(self._badness(self._root(middle + half)) - self._badness(self._root(middle - half)))

    def _badness(self, value: Float[Array, "*b k"]) -> Float[Array, "*b k"]:
        ways = {"lower": value, "higher": -value, "zero": np.abs(value), "one": np.abs(value - 1)}
        return np.asarray(np.select([self.direction == w for w in ways], list(ways.values()), np.nan))

    @property
    def _paired(self) -> Array:
        return np.asarray(np.isfinite(self.old) & np.isfinite(self.new))

    @property
    def _powers(self) -> tuple[Array, Array]:
        """Summands of the values over all runs that have both."""
        n = np.maximum(self._paired.sum(axis=1), 1)[:, None]
        return np.where(self._paired, self._power(self.old), 0) / n, np.where(
            self._paired, self._power(self.new), 0
        ) / n

    def _power(self, values: Float[Array, "k r"]) -> Float[Array, "k r"]:
        return np.where((self.statistic == "rms")[:, None], values * values, values)

    def _root(self, values: Float[Array, "*b k"]) -> Float[Array, "*b k"]:
        return np.where(self.statistic == "rms", np.sqrt(np.abs(values)), values)
