"""How well an image front end tracked, from its labelled tracks: noise, bias, correlation, drift, outliers, honesty.

Intervals (95 %) draw whole tracks, since the errors of one are not independent. Errors are those against the track's
material point, which is the mean of where the track itself was seen: one row per track is lost to that mean.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.stats import chi2

from reports.bootstrap import interval_of_sums
from reports.consistency import band, nees
from reports.evaluation import VISIBLE_POINTS
from reports.metrics import BIN_M, metric_row
from reports.statistics import Direction
from sim.observations import Tracks
from sim.truth import Truth

Array = np.ndarray
AXES = ("u_left", "v_left", "u_right", "v_right", "disparity")
LAGS = range(1, 6)
AGES = (1, 2, 5, 10, 20, 40)
INLIER_NAME = "inlier"
_MIN_PAIRS = 20  # fewer say nothing of a correlation or of drift
_DOF = 4


def pixel_errors(truth: Truth, tracks: Tracks) -> pd.DataFrame:
    """One row per row of the tracks: frame, track, age [frames], kind, errors [px] and stated sigmas of `AXES`, NEES.

    Errors are measured minus true, NaN for tracks without a material point; the sigmas are called "sigma_<axis>".
    """
    error, cov = tracks.uv - truth.labels.uv_true, tracks.cov
    first = pd.Series(tracks.frame).groupby(tracks.track).transform("min").to_numpy(int)
    names = np.array([INLIER_NAME, *truth.labels.kinds])
    columns: dict[str, Any] = {"frame": tracks.frame, "track": tracks.track, "age": tracks.frame - first}
    columns["kind"] = names[truth.labels.kind]
    to_axes = np.vstack([np.eye(4), [[1.0, 0.0, -1.0, 0.0]]])
    variance = np.einsum("ai,nij,aj->na", to_axes, cov, to_axes)
    columns |= dict(zip(AXES, (error @ to_axes.T).T, strict=True))
    columns |= {f"sigma_{axis}": np.sqrt(variance[:, i]) for i, axis in enumerate(AXES)}
    columns["nees"] = nees(error, cov) if len(error) else np.empty(0)
    return pd.DataFrame(columns)


def front_end_rows(truth: Truth, tracks: Tracks, seconds_per_frame: float | None = None) -> Iterator[dict[str, Any]]:
    """Every metric of a front end, as rows of metrics.csv without the columns that say whose they are."""
    errors = pixel_errors(truth, tracks)
    good = errors[errors["kind"] == INLIER_NAME]
    if len(good):
        yield from _noise_rows(good)
        yield from _correlation_rows(good)
        yield from _honesty_rows(good)
    yield from _drift_rows(errors[errors["kind"].isin([INLIER_NAME, "drift"])])
    yield from _track_rows(truth, errors)
    yield from _outlier_rows(truth, errors)
    if seconds_per_frame is not None:
        row = metric_row("runtime", "all", "mean", 1e3 * seconds_per_frame, "ms", "lower", len(truth.t_s))
        yield row | {"entity": "track, per frame"}


def _pooled(
    what: tuple[str, str, str, str, Direction],
    rows: pd.DataFrame,
    summands: Sequence[Array],
    finish: Callable[[Float[Array, "*b q"]], Float[Array, "*b"]],
) -> dict[str, Any]:
    """A metric (quantity, axis, statistic, unit, direction) of sums over tracks, with its interval over tracks."""
    per_track = pd.DataFrame(dict(enumerate(summands))).groupby(rows["track"].to_numpy()).sum().to_numpy(float)
    quantity, axis, statistic, unit, direction = what
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(finish(per_track.sum(axis=0)))
        low, high = interval_of_sums(finish, per_track)
    row = metric_row(quantity, axis, statistic, value, unit, direction, len(rows))
    return row | {"ci_low": low, "ci_high": high}


def _ratio(s: Array) -> Array:
    return np.asarray(s[..., 0] / s[..., 1])


def _root_ratio(s: Array) -> Array:
    return np.asarray(np.sqrt(_ratio(s)))


def _correlation(s: Array) -> Array:
    return np.asarray(s[..., 0] / np.sqrt(s[..., 1] * s[..., 2]))


def _degrees(rows: pd.DataFrame) -> Float[Array, "n"]:
    """Degrees of freedom that each row brings to the noise about its own track's mean place."""
    return np.asarray(1 - 1 / rows.groupby("track")["frame"].transform("size").to_numpy(float))


def _noise_rows(good: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Sigma per axis, and by what factor it differs from the stated one; bias where no mean has been taken out."""
    ones, degrees = np.ones(len(good)), _degrees(good)
    for axis in AXES:
        e, stated = good[axis].to_numpy(float), good[f"sigma_{axis}"].to_numpy(float)
        free = ones if axis == "disparity" else degrees
        square = (e - e.mean()) ** 2 if axis == "disparity" else e**2
        if not free.any():
            continue
        yield _pooled(("pixel", axis, "std", "px", "lower"), good, (square, free), _root_ratio)
        yield _pooled(("pixel", axis, "factor", "1", "one"), good, (square, free * stated**2), _root_ratio)
    e = good["disparity"].to_numpy(float)
    yield _pooled(("pixel", "disparity", "bias", "px", "zero"), good, (e, ones), _ratio)


def _pairs(rows: pd.DataFrame, lag: int) -> pd.DataFrame:
    """Rows beside those of the same track some frames later, whose columns end in "_later"."""
    later = rows.assign(frame=rows["frame"] - lag)
    return rows.merge(later, on=["track", "frame"], suffixes=("", "_later"))


def _correlation_rows(good: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Correlation of a track's errors over time, both coordinates of the left image together, and of the disparity."""
    for lag in LAGS:
        pairs = _pairs(good, lag)
        if len(pairs) < _MIN_PAIRS:
            continue
        for name, axes in (("left", ("u_left", "v_left")), ("disparity", ("disparity",))):
            a, b = (pairs[[f"{axis}{end}" for axis in axes]].to_numpy(float) for end in ("", "_later"))
            if name == "disparity":
                a, b = a - a.mean(), b - b.mean()
            sums = [(x * y).sum(axis=1) for x, y in ((a, b), (a, a), (b, b))]
            row = _pooled(("pixel", name, "correlation", "1", "zero"), pairs, sums, _correlation)
            yield row | {"bin": f"lag {lag}"}


def _drift_rows(rows: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """RMS change per coordinate of the left image since a track's first frame; of white noise it is sqrt(2) sigma."""
    first = rows[rows["age"] == 0][["track", "u_left", "v_left"]]
    both = rows.merge(first, on="track", suffixes=("", "_first"))
    for age in AGES:
        old = both[both["age"] == age]
        if len(old) < _MIN_PAIRS:
            continue
        now, then = (old[[f"u_left{end}", f"v_left{end}"]].to_numpy(float) for end in ("", "_first"))
        change = np.sum((now - then) ** 2, axis=1)
        row = _pooled(("pixel", "left", "drift", "px", "lower"), old, (change, np.full(len(old), 2.0)), _root_ratio)
        yield row | {"bin": f"age {age}"}


def _honesty_rows(good: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Mean NEES of the four pixel coordinates over their degrees of freedom, and the factor on all stated sigmas that
    would make it one; the same factor of the median, which the worst points do not touch."""
    lost = 2 * (1 - _degrees(good))  # the mean place of a track takes up both coordinates of the left image once
    count = good["track"].nunique()
    low, high = band(_DOF, count, 0.95)
    said = {"reference": f"{low:.3f}..{high:.3f}", "source": "95 % chi-square band, one row per track"}
    sums = (good["nees"].to_numpy(float), _DOF - lost)
    yield _pooled(("pixel", "all", "nees", "1", "one"), good, sums, _ratio) | said
    yield _pooled(("pixel", "all", "factor", "1", "one"), good, sums, _root_ratio)
    share = (1 - lost.sum() / (_DOF * len(good))) * chi2.ppf(0.5, _DOF)
    median = float(np.sqrt(good["nees"].median() / share))
    yield metric_row("pixel", "all", "median_factor", median, "1", "one", len(good))


def _track_rows(truth: Truth, errors: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Tracks per frame with a visible target, all and those on it, by its distance too; their life in frames."""
    visible = truth.visible_points >= VISIBLE_POINTS
    counts = np.bincount(errors["frame"], minlength=len(truth.t_s))[visible]
    good = np.bincount(errors.loc[errors["kind"] == INLIER_NAME, "frame"], minlength=len(truth.t_s))[visible]
    for entity, count in (("", counts), (INLIER_NAME, good)):
        for name, pool in (("mean", np.mean), ("min", np.min)):
            if len(count):
                row = metric_row("track", "all", name, float(pool(count)), "1", "higher", len(count))
                yield row | {"entity": entity}
    distance = truth.T_cv.apply(truth.reference_v)[visible, 2]
    for start, part in pd.Series(good).groupby(np.floor(distance / BIN_M) * BIN_M):
        row = metric_row("track", "all", "mean", float(part.mean()), "1", "higher", len(part))
        yield row | {"entity": INLIER_NAME, "bin": f"{start:.0f}-{start + BIN_M:.0f} m"}
    if len(errors):
        life = errors.groupby("track").size()
        for name, value in (("mean", life.mean()), ("median", life.median())):
            yield metric_row("track", "life", name, float(value), "1", "higher", len(life))


def _outlier_rows(truth: Truth, errors: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Share of the tracked points with each label."""
    if not len(errors):
        return
    ones = np.ones(len(errors))
    for kind in truth.labels.kinds:
        is_kind = (errors["kind"] == kind).to_numpy(float)
        yield _pooled(("outlier", "all", "fraction", "1", "lower"), errors, (is_kind, ones), _ratio) | {"entity": kind}
    wrong = (errors["kind"] != INLIER_NAME).to_numpy(float)
    yield _pooled(("outlier", "all", "fraction", "1", "lower"), errors, (wrong, ones), _ratio) | {"entity": "all"}
