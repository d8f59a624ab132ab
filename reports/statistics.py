"""The registry of statistics of errors: how each is pooled, its unit, and which way is better.

Squared errors are pooled, never averaged RMS values; percentiles come from the data. Over several axes a statistic is
that of the vectors' lengths: the bias is the length of the mean vector, the standard deviation the root of the summed
variances. Errors and bounds come stacked (..., n, 2k) as [errors, bounds].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

Array = np.ndarray
Direction = Literal["lower", "higher", "zero", "one"]
Pool = Callable[[Float[Array, "*b n k"]], Float[Array, "*b"]]


@dataclass(frozen=True)
class Statistic:
    """``pool`` maps errors and bounds (..., n, 2k) to (...).

    unit None means that of the quantity; ``interval`` whether a bootstrap interval makes sense. Where the statistic
    comes from sums, ``sums`` makes the summands (..., n, q) and ``finish`` the value of their sums (..., q): runs can
    then be pooled, and drawn again, by their sums alone.
    """

    direction: Direction
    pool: Pool
    unit: str | None = None
    needs_bound: bool = False
    interval: bool = True
    sums: Callable[[Array], Array] | None = None
    finish: Callable[[Array], Array] | None = None


def _of_sums(
    direction: Direction, sums: Callable[[Array], Array], finish: Callable[[Array], Array], **more: Any
) -> Statistic:
    return Statistic(direction, lambda v: finish(sums(v).sum(axis=-2)), sums=sums, finish=finish, **more)


def _error(v: Array) -> Array:
    return v[..., : v.shape[-1] // 2]


def _bound(v: Array) -> Array:
    return v[..., v.shape[-1] // 2 :]


def _square(x: Array) -> Array:
    return np.asarray(np.sum(x * x, axis=-1))


def _length(x: Array) -> Array:
    return np.asarray(np.sqrt(_square(x)))


def _counted(*columns: Array) -> Array:
    """Summands with a column of ones, whose sum is the number of rows."""
    return np.concatenate([*columns, np.ones((*columns[0].shape[:-1], 1))], axis=-1)


def _mean_vector(s: Array) -> Array:
    mean = s[..., :-1] / s[..., -1:]
    return np.asarray(mean[..., 0] if mean.shape[-1] == 1 else _length(mean))


def _centred(v: Array) -> Array:
    """Errors and their squares, from the mean of all rows, so that no digits are lost where the bias is large."""
    e = _error(v) - _error(v).mean(axis=-2, keepdims=True)
    return _counted(e, _square(e)[..., None])


def _spread(s: Array) -> Array:
    """Root of the summed variances; NaN for a single row."""
    n = s[..., -1]
    above = s[..., -2] - _square(s[..., :-2]) / n
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(np.maximum(above, 0) / (n - 1)))


def _root_mean(s: Array) -> Array:
    return np.asarray(np.sqrt(s[..., 0] / s[..., 1]))


def _root_ratio(s: Array) -> Array:
    """sqrt(sum of squared bounds / sum of squared errors); NaN where there is no error at all."""
    bound, error = s[..., 0], s[..., 1]
    return np.asarray(np.sqrt(np.divide(bound, error, out=np.full_like(bound, np.nan), where=error > 0)))


STATISTICS: dict[str, Statistic] = {
    "bias": _of_sums("zero", lambda v: _counted(_error(v)), _mean_vector),
    "std": _of_sums("lower", _centred, _spread),
    "rms": _of_sums("lower", lambda v: _counted(_square(_error(v))[..., None]), _root_mean),
    "p95": Statistic("lower", lambda v: np.quantile(_length(_error(v)), 0.95, axis=-1)),
    "max": Statistic("lower", lambda v: _length(_error(v)).max(axis=-1), interval=False),
    "crb": _of_sums(
        "lower", lambda v: _counted(_square(_bound(v))[..., None]), _root_mean, needs_bound=True, interval=False
    ),
    "efficiency": _of_sums(
        "higher",
        lambda v: np.stack([_square(_bound(v)), _square(_error(v))], axis=-1),
        _root_ratio,
        unit="1",
        needs_bound=True,
    ),
}
