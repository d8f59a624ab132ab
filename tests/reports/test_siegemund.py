"""The published tables and figures, made of small studies whose numbers are known."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from estimators.estimate import WindowEstimate
from reports.run import Run
from reports.siegemund import clouds, datum, depth, detectors, matrices, motion, recordings, statements
from reports.siegemund.over_time import over_time
from reports.studies import RESULTS, StudyResult
from sim.pose import Pose

Array = np.ndarray


def result(points: dict[str, dict[str, Any]], estimators: tuple[str, ...], **tables: pd.DataFrame) -> StudyResult:
    """A study with these points (name to settings), labels and tables."""
    categories = {"point": list(points), "estimator": ["", *estimators]}
    empty = pd.DataFrame(columns=["point", "run", "estimator"])
    every = dict.fromkeys((*RESULTS, "runtimes"), empty) | tables
    for name, table in every.items():
        every[name] = table.assign(**{c: pd.Categorical(table[c], v) for c, v in categories.items()})
    return StudyResult(
        folder=Path("nowhere"),
        name="study",
        title="",
        source="",
        scenario="point-grid",
        experiment=False,
        seed=1,
        runs=2,
        points=pd.DataFrame(list(points.values()), index=list(points)),
        scenarios={},
        estimators=estimators,
        **every,
    )


def detected(labels: tuple[str, ...] = ("points", "robust")) -> StudyResult:
    """Two rows of the table, two runs; fp is 10 and 14 of the first detector, 0 and 1 of the second."""
    points = {f"{rho} {t}": {detectors.FRAMES: rho, detectors.SHARE: t} for rho, t in ((10, 0.1), (1, 0.5))}
    rows = [
        {"point": p, "run": run, "estimator": e, "fp": fp[run], "fn": 7, "tp": 43}
        for p, (e, fp), run in itertools.product(points, zip(labels, [(10, 14), (0, 1)], strict=True), range(2))
    ]
    return result(points, labels, outliers=pd.DataFrame(rows))


def test_outlier_table_beside_the_published_numbers() -> None:
    table = detectors.outlier_table(detected())
    assert list(table["theta [%]"]) == [10, 50]
    assert list(table["rho"]) == [10, 1]
    assert list(table["points fp"]) == [12, 12]
    assert list(table["points fp, source"]) == [15.3, 0]
    assert list(table["points fn, source"]) == [0, 7]
    assert list(table["robust fp"]) == [0.5, 0.5]
    assert "robust fp, source" not in table


def test_a_detector_that_gave_nothing_leaves_its_cells_empty() -> None:
    whole = detected()
    table = detectors.outlier_table(replace(whole, outliers=whole.outliers[whole.outliers["estimator"] == "points"]))
    assert table["robust fn"].isna().all()
    assert list(table["points fn"]) == [7, 7]


def test_published_numbers_are_whole() -> None:
    rows = {(theta, rho) for theta in (10, 30, 50) for rho in (10, 5, 1)}
    assert set(detectors.PUBLISHED) == {"points", "tracks", "prior knowledge"}
    for numbers in detectors.PUBLISHED.values():
        assert set(numbers) == rows
    # The cap of ten batches of 5 %: 43 of 100 tracks can go.
    for theta, rho in rows:
        for method in ("points", "tracks"):
            fp, fn = detectors.PUBLISHED[method][theta, rho]
            assert theta < 50 or fn == pytest.approx(7 + fp)


def test_outlier_figure_shows_ours_and_the_source() -> None:
    figure = detectors.outlier_counts(detected())
    left, right = figure.axes
    assert [t.get_text() for t in left.get_yticklabels()] == [
        "10 % of tracks\nin 10 frames",
        "50 % of tracks\nin 1 frame",
    ]
    labels = [t.get_text() for t in figure.legends[0].get_texts()]
    assert labels == ["points", "points, source", "robust"]
    for ax, values in ((left, [15.3, 0]), (right, [0, 7])):
        published = [line for line in ax.get_lines() if line.get_label() == "points, source"]
        np.testing.assert_array_equal(published[0].get_xdata(), values)


def errors(
    labels: tuple[str, ...], biases: tuple[float, ...], quantity: str = "position", axis: str = "z"
) -> StudyResult:
    """Two runs of three frames; the error is the bias plus 0.1 in one run and minus 0.1 in the other."""
    rows = [
        {
            "point": "",
            "run": run,
            "estimator": e,
            "quantity": quantity,
            "t_s": 0.04 * k,
            "entity": "target",
            "axis": axis,
        }
        | {"error": b + (0.1, -0.1)[run], "truth": 70 - k, "bound": 0.05, "distance_m": 70 - k, "sigma": 0.1}
        for (e, b), run, k in itertools.product(zip(labels, biases, strict=True), range(2), range(3))
    ]
    support = pd.DataFrame(
        [{"point": "", "run": r, "estimator": e, "windows": 3, "failed": 0} for e in labels for r in (0, 1)]
    ).assign(wanted=3, estimated=3, overlap=10, over_ground=False)
    nothing = pd.DataFrame(columns=["point", "run", "estimator", "reason", "quantity", "nees", "disjoint"])
    outliers = nothing.assign(tp=0, fp=0, fn=0, flagged=0)
    return result(
        {"": {}},
        labels,
        comparison=pd.DataFrame(rows),
        support=support,
        failures=nothing,
        nees=nothing,
        outliers=outliers,
    )


def test_errors_over_time_pool_the_runs() -> None:
    table = over_time(errors(("observed", "estimated"), (-1.0, 0.2)), "position", "z")
    observed = table[table["estimator"] == "observed"]
    np.testing.assert_allclose(observed["mean"], -1.0)
    # Standard deviation of +-0.1 is sqrt(0.02), of its mean over two runs 0.1.
    np.testing.assert_allclose(observed["high"] - observed["mean"], 1.96 * 0.1)
    np.testing.assert_allclose(observed["q_high"], -1 + 0.1 - 0.025 * 0.2)
    np.testing.assert_allclose(observed["distance_m"], [70, 69, 68])


def test_depth_table_has_the_bias_beside_the_source() -> None:
    table = depth.depth_table(errors(("observed", "image space"), (-1.0, 0.0))).set_index("estimator")
    assert table.loc["observed", "bias [m]"] == pytest.approx(-1)
    assert table.loc["image space", "rms [m]"] == pytest.approx(0.1)
    assert table.loc["image space", "efficiency"] == pytest.approx(0.5)
    assert table.loc["observed", "source"] == "too near (4.1.4)"
    assert table.loc["image space", "source"] == ""


def test_depth_figure_zooms_and_has_a_line_per_estimator() -> None:
    labels = ("observed", "averaged", "estimated")
    figure = depth.depth_error(errors(labels, (-1.0, -0.2, 0.2)), zoom_m=0.5)
    whole, zoom = figure.axes
    assert zoom.get_ylim() == (-0.5, 0.5)
    assert [t.get_text() for t in figure.legends[0].get_texts()] == list(labels)
    means = {line.get_label(): line.get_ydata() for line in whole.get_lines() if line.get_label() in labels}
    np.testing.assert_allclose(means["observed"], -1.0)


def test_an_origin_that_moves_on_the_object_is_seen(world: Any) -> None:
    changed, shift = 20, np.array([0.0, 0.0, 1.25])

    def moved(w: WindowEstimate) -> WindowEstimate:
        new = Pose(np.eye(3), shift) if w.frames[0] >= changed else Pose(np.eye(3), np.zeros(3))
        return replace(w, T_co=w.T_co @ new, X_o=new.inv().apply(w.X_o))

    run = Run(Path("nowhere"), "", {}, {}, world.truth, world.observations, {"cloud": world.with_windows(moved)})
    path = datum.origin_path(run, "cloud", changed)
    strayed = np.stack([path[f"estimate_{a}"] - path[f"truth_{a}"] for a in "xyz"], axis=1)
    settled = path["settled"].to_numpy(bool)
    assert settled.any()
    np.testing.assert_allclose(np.linalg.norm(strayed[settled], axis=1), 1.25, atol=1e-9)
    np.testing.assert_allclose(strayed[~settled], 0, atol=1e-9)


def test_trajectory_is_that_of_the_first_run_in_degrees() -> None:
    study = errors(("known",), (0.5,), "yaw_rate", "all")
    figure = motion.trajectory(study, parameters=("yaw_rate all",))
    left, right = figure.axes
    points = next(line for line in left.get_lines() if line.get_label() == "one run")
    np.testing.assert_allclose(points.get_ydata(), np.rad2deg(70 - np.arange(3) + 0.6))
    mean = next(line for line in right.get_lines() if "mean" in str(line.get_label()))
    np.testing.assert_allclose(mean.get_ydata(), np.rad2deg(0.5))
    table = motion.trajectory_table(study, parameters=("yaw_rate all",))
    assert table.loc[0, "unit"] == "deg/s"
    assert table.loc[0, "bias"] == pytest.approx(np.rad2deg(0.5))
    assert table.loc[0, "efficiency"] == pytest.approx(np.sqrt(0.05**2 / 0.26))


def test_a_direction_does_not_leap_by_a_turn() -> None:
    study = errors(("known",), (0.0,), "driving_direction", "all")
    truth = np.tile([np.pi - 0.01, 0.01 - np.pi, np.pi], 2)
    figure = motion.trajectory(
        replace(study, comparison=study.comparison.assign(truth=truth)), parameters=("driving_direction all",)
    )
    drawn = next(line for line in figure.axes[0].get_lines() if line.get_label() == "truth")
    np.testing.assert_allclose(drawn.get_ydata(), 180 + np.rad2deg([-0.01, 0.01, 0]))


def test_a_parameter_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="'speed'"):
        motion.trajectory(errors(("known",), (0.0,)), parameters=("speed",))


def test_clouds_of_a_perfect_estimate_are_the_truth(world: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    run = Run(Path("nowhere"), "", {}, {}, world.truth, world.observations, {"known": world.estimate})
    study = errors(("known",), (0.0,))
    monkeypatch.setattr(StudyResult, "example", lambda *_: run)
    last = world.estimate.windows[-1]
    depths = world.truth.points_c(last.frames, last.track)[:, :, 2].mean(axis=1)
    (near,) = clouds.clouds(study, (float(depths[3]),))
    assert near.true[:, 2].mean() == pytest.approx(depths[3])
    for cloud in (near.triangulated, near.adjusted):
        np.testing.assert_allclose(cloud, near.true, atol=1e-6)
    table = clouds.cloud_table(study, distances_m=(float(depths[0]),))
    assert table.loc[0, "points"] == len(last.track)
    figure = clouds.point_clouds(study, distances_m=(float(depths[0]), float(depths[-1])))
    assert len(figure.axes) == 6


def test_system_of_a_run_has_its_sizes(world: Any) -> None:
    """Three coordinates per observation; columns for all points and poses; a known axis takes two turns a frame."""
    config = {"name": "known", "weights": "estimated", "second_order": True}
    known = {"smoothing": {"translation": "velocity"}, "rotation_axis": {"mode": "fixed"}}
    run = Run(Path("nowhere"), "", {"estimator": [config | known]}, {}, world.truth, world.observations, {})
    s = matrices.system(replace(run, estimates={"known": world.estimate}))
    window = world.estimate.windows[-1]
    m, n = len(window.frames), len(window.track)
    assert (s.m, s.n) == (m, n)
    assert s.rows["observations"] == slice(0, 3 * m * n)
    assert s.A.shape == (3 * m * n + 3 * (m - 2), 3 * n + 6 * m)
    assert s.conditions["axis"].stop - s.conditions["axis"].start == 2 * m


def test_claims_hold_or_not_by_the_numbers() -> None:
    good = replace(errors(("estimated", "estimated second order"), (0.5, 0.0)), name="siegemund-fig-4-1-7")
    assert list(statements.claims(good)["holds"]) == ["yes", "yes"]
    near = replace(errors(("estimated", "estimated second order"), (-0.5, -0.4)), name="siegemund-fig-4-1-7")
    assert list(statements.claims(near)["holds"]) == ["no", "no"]
    half = replace(errors(("observed", "averaged"), (-1.0, -0.4)), name="siegemund-fig-4-1-6")
    assert list(statements.claims(half)["holds"]) == ["in part"]
    with pytest.raises(KeyError):
        statements.claims(errors(("observed",), (0.0,)))


def test_claims_of_the_detectors() -> None:
    points = {f"{rho} {t}": {detectors.FRAMES: rho, detectors.SHARE: t} for rho in (10, 5, 1) for t in (0.1, 0.3, 0.5)}
    labels = ("points", "tracks", "prior knowledge")

    def study(dropped: int) -> StudyResult:
        """The published behaviour, but for the good tracks that the test of tracks drops."""
        rows = [
            {"point": p, "run": 0, "estimator": e, "fp": fp, "fn": fn}
            for p, s in points.items()
            for e, fp, fn in zip(
                labels,
                (0, 0, 0) if s[detectors.SHARE] == 0.5 else (15, dropped, 0),
                (7, 7, 16) if s[detectors.SHARE] == 0.5 else (0, 0, 20 - s[detectors.FRAMES]),
                strict=True,
            )
        ]
        made = result(points, labels, outliers=pd.DataFrame(rows))
        return replace(made, name="siegemund-table-3-4-1")

    # fn of the prior knowledge does not grow where half the tracks are wrong.
    assert list(statements.claims(study(1))["holds"]) == ["yes", "yes", "yes", "yes", "no"]
    assert list(statements.claims(study(3))["holds"])[:2] == ["in part", "yes"]
    assert list(statements.claims(study(14))["holds"])[:2] == ["no", "no"]


def test_points_of_a_perfect_estimate_lie_on_the_car(world: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a surface of which the test knows every vertex, among them the points."""
    body = world.truth.bodies[0]
    truth = replace(world.truth, bodies=(replace(body, outline_v=world.truth.point_v),))
    off = np.where(np.arange(len(world.truth.track)) == 3, 20.0, 0.0)[:, None] * [0, 0, 1]
    estimate = world.with_windows(lambda w: replace(w, X_o=w.X_o + off @ datum_axes(w)))
    run = Run(Path("nowhere"), "", {}, {}, truth, world.observations, {"known": estimate})
    study = errors(("known",), (0.0,))
    monkeypatch.setattr(StudyResult, "example", lambda *_: run)
    row = recordings.cloud_above_table(study, distances_m=(30.0,)).iloc[0]
    points = len(world.truth.track)
    assert (row["points"], row["outliers"]) == (points, 0)
    assert row["on the car [%]"] == pytest.approx(100 * (points - 1) / points)
    assert row["median distance [m]"] == pytest.approx(0, abs=1e-6)
    assert 15 < row["largest distance [m]"] <= 20 + 1e-9
    assert len(recordings.cloud_above(study, distances_m=(35.0, 30.0)).axes) == 2


def datum_axes(w: WindowEstimate) -> np.ndarray:
    """Camera axes of the newest frame in the object frame: rows v @ this are vectors of the object frame."""
    return w.T_co.R[-1]


def test_system_errors_of_the_windows(world: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fixture's windows all have a cost and a redundancy of 100."""
    half = world.with_windows(lambda w: replace(w, cost=w.cost / 2, rejected=w.track[:2]))
    estimates = {"none": world.estimate, "half": half}
    run = Run(Path("nowhere"), "", {}, {}, world.truth, world.observations, estimates)
    study = replace(errors(("none", "half"), (0.0, 0.0)), name="siegemund-fig-4-2-16")
    monkeypatch.setattr(StudyResult, "example", lambda *_: run)
    table = recordings.system_error_table(study).set_index("estimator")
    assert table.loc["half", "system error"] == pytest.approx(table.loc["none", "system error"] / 2)
    assert table.loc["half", "tracks left out"] == 2
    left, right = recordings.system_error(study, left=("none", "half"), right=("half",)).axes
    assert len(left.get_lines()) == 2
    np.testing.assert_allclose(right.get_lines()[0].get_ydata(), [w.cost for w in half.windows])


def test_claims_of_smoothing() -> None:
    """Errors of the two runs of `errors` do not change over time; a step of one estimator makes it rough."""
    labels = ("smoothed", "detection")

    def study(rough: dict[str, float]) -> StudyResult:
        tables = [errors(labels, (0.0, 0.0), q, "z").comparison for q in ("position", "velocity")]
        c = pd.concat(tables, ignore_index=True)
        swing = np.where(np.round(c["t_s"] / 0.04) % 2 == 1, c["estimator"].astype(str).map(rough), 0.0)
        whole = errors(labels, (0.0, 0.0))
        return replace(whole, comparison=c.assign(error=swing))

    smooth, same = study({"smoothed": 0.1, "detection": 0.4}), study({"smoothed": 0.4, "detection": 0.4})
    for name in ("siegemund-fig-4-2-17", "siegemund-fig-4-2-18"):
        assert list(statements.claims(replace(smooth, name=name))["holds"]) == ["yes"]
        assert list(statements.claims(replace(same, name=name))["holds"]) == ["no"]
        assert "0.25" in statements.claims(replace(smooth, name=name))["found here"][0]
