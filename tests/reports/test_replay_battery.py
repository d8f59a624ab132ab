"""The battery of replayed cars: what a car does, which error belongs to which frame, and what is made of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.patches import Rectangle

from reports.battery_outputs import FIGURES, TABLES
from reports.manoeuvres import manoeuvres, replayed
from reports.replay_battery import Battery, Group, battery, groups, spread
from reports.studies import StudyResult
from sim.scenario import Braking, Straight, Turning
from sim.traffic import trajectory

FRAMES, RATE_HZ = 30, 10.0
ALONG, ACROSS = 0.3, 0.05


def row(frame: int, track: int, x: float, z: float, occluded: int = 0) -> str:
    return f"{frame} {track} Car 0 {occluded} 0 0 0 0 0 1.5 1.7 4.2 {x} 1.65 {z} -1.5707963"


def labels(folder: Path) -> Path:
    """Car 0 drives off at 10 m/s from 6 m, occluded in its last ten frames; 1 stands at 15 m; 2 stands at 25 m and is
    not labelled in five frames."""
    rows = [row(f, 0, 2.0, 6.0 + f, 2 if f >= 20 else 0) for f in range(FRAMES)]
    rows += [row(f, 1, -3.0, 15.0) for f in range(FRAMES)]
    rows += [row(f, 2, 0.0, 25.0, 1) for f in range(FRAMES) if not 10 <= f < 15]
    path = folder / "labels.txt"
    path.write_text("\n".join(rows) + "\n")
    return path


def scenario(path: Path, track: int) -> dict[str, Any]:
    motion = {"kind": "labels", "labels": str(path), "track": track, "label_rate_hz": RATE_HZ}
    return {
        "measure": {"target": None},
        "vehicle": [{"name": "target", "motion": motion}],
        "ego": {"poses": None},
        "rig": {"rate_hz": RATE_HZ, "frames": None},
    }


def made(folder: Path, estimated: bool = True) -> StudyResult:
    """Two estimators on three cars: "a" errs by `ALONG` and `ACROSS` times the frame's number, "b" by twice as much and
    fails in every even frame; each window has 20 tracks, three of them wrong. None of it without ``estimated``."""
    path = labels(folder)
    points = [f"track={n}" for n in range(3)]
    errors, outliers, failures = [], [], []
    for n, point in enumerate(points):
        for frame in range(2, FRAMES) if estimated else ():
            p = np.array([[2.0, 1.0, 6.0 + frame], [-3.0, 1.0, 15.0], [0.0, 1.0, 25.0]][n])
            line, side = p / np.linalg.norm(p), np.array([p[2], 0, -p[0]]) / np.hypot(p[0], p[2])
            for factor, estimator in ((1, "a"), (2, "b")):
                key = (point, 0, estimator, frame / RATE_HZ)
                if estimator == "b" and frame % 2 == 0:
                    failures.append((*key, "window", "too few tracks"))
                    continue
                e = factor * frame * (ALONG * line - ACROSS * side)
                errors += [(*key, "position", "target", a, e[i], p[i]) for i, a in enumerate("xyz")]
                errors += [(*key, "position", "smoothed", a, 99.0, p[i]) for i, a in enumerate("xyz")]
                errors += [(*key, q, "target", "all", factor * 0.1, 1.0) for q in ("speed", "yaw_rate")]
                outliers.append((*key, 20, 2, 4, 1, 0))
    head = ["point", "run", "estimator", "t_s"]
    tables = {
        "comparison": pd.DataFrame(errors, columns=[*head, "quantity", "entity", "axis", "error", "truth"]),
        "outliers": pd.DataFrame(outliers, columns=[*head, "tracks", "tp", "fp", "fn", "flagged"]),
        "failures": pd.DataFrame(failures, columns=[*head, "kind", "reason"]),
    }
    for table in tables.values():
        table["point"] = pd.Categorical(table["point"], points)
    nothing = pd.DataFrame()
    return StudyResult(
        folder=folder,
        name="battery",
        title="",
        source="",
        scenario="replay",
        experiment=False,
        seed=1,
        runs=1,
        points=pd.DataFrame({"track": range(3)}, index=points),
        scenarios={p: scenario(path, n) for n, p in enumerate(points)},
        estimators=("a", "b"),
        **tables,
        nees=nothing,
        support=nothing,
        measures=nothing,
        runtimes=nothing,
    )


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Battery:
    return battery(made(tmp_path_factory.mktemp("battery")))


def one(b: Battery, by: str, value: str, estimator: str = "a") -> Group:
    return next(g for g in groups(b, by) if (g.value, g.estimator) == (value, estimator))


def test_manoeuvres_are_those_driven() -> None:
    t = np.linspace(0, 5, 51)
    start = (0.0, 10.0)
    straight = trajectory(Straight(kind="straight", speed_mps=8.0, start_m=start), 5.0)
    standing = trajectory(Straight(kind="straight", speed_mps=0.5, start_m=start), 5.0)
    assert set(manoeuvres(straight, t, 5.0)) == {"straight"}
    assert set(manoeuvres(standing, t, 5.0)) == {"standing"}
    turning = trajectory(Turning(kind="turning", yaw_rate_dps=20.0, turn_deg=40.0, straight_s=1.0, start_m=start), 5.0)
    # The yaw rate is a trapezoid with ramps of 0.5 s from 1 to 3.5 s; in the second around its ends it turns by 5 deg.
    inside = t[:-1] + 0.03
    np.testing.assert_array_equal(manoeuvres(turning, inside, 5.0) == "turning", (inside > 1) & (inside < 3.5))
    braking = trajectory(
        Braking(kind="braking", speed_mps=12.0, deceleration_mps2=4.0, brake_s=1.0, start_m=start), 5.0
    )
    what = manoeuvres(braking, t, 5.0)
    assert what[0] == "straight"
    assert (what[(t > 1) & (t < 3.5)] == "braking").all()
    assert what[-1] == "standing"


def test_frames_of_a_car(tmp_path: Path) -> None:
    label, frames = replayed(scenario(labels(tmp_path), 0))
    assert label.kind == "Car"
    assert len(frames) == FRAMES
    np.testing.assert_allclose(frames["distance_m"], 6.0 + np.arange(FRAMES), atol=1e-6)
    np.testing.assert_array_equal(frames["occlusion"], [0] * 20 + [2] * 10)
    assert set(frames["manoeuvre"]) == {"straight"}
    with pytest.raises(ValueError, match="the motion of 'target' is no replay"):
        replayed(scenario(tmp_path, 0) | {"vehicle": [{"name": "target", "motion": {"kind": "straight"}}]})


def test_errors_along_and_across_the_line_of_sight(found: Battery) -> None:
    of_a = found.windows[found.windows["estimator"] == "a"]
    assert len(of_a) == 3 * (FRAMES - 2)
    np.testing.assert_allclose(of_a["along"], ALONG * of_a["frame"])
    np.testing.assert_allclose(of_a["across"], -ACROSS * of_a["frame"])
    np.testing.assert_allclose(of_a["speed"], 0.1)
    np.testing.assert_allclose(of_a["yaw_rate"], np.rad2deg(0.1))


def test_all_frames_and_windows_are_counted(found: Battery) -> None:
    a, b = groups(found, "all")
    assert (a.cars, a.frames, a.windows, a.failed) == (3, 3 * FRAMES, 3 * (FRAMES - 2), 0)
    assert (b.windows, b.failed) == (3 * (FRAMES - 2), 3 * (FRAMES - 2) // 2)
    assert a.estimated == pytest.approx((FRAMES - 2) / FRAMES)
    assert b.estimated == pytest.approx((FRAMES - 2) / 2 / FRAMES)
    assert a.outliers == b.outliers == pytest.approx(3 / 20)
    assert b.errors["speed"].median == pytest.approx(0.2)
    for by in ("distance", "occlusion", "manoeuvre", "point"):
        parts = [g for g in groups(found, by) if g.estimator == "a"]
        assert sum(g.frames for g in parts) == a.frames
        assert sum(g.windows for g in parts) == a.windows


def test_frames_are_told_apart(found: Battery) -> None:
    near = one(found, "distance", "0-10 m")  # frames 0 to 3 of car 0, of which 2 and 3 have an estimate
    assert (near.cars, near.frames, near.windows) == (1, 4, 2)
    assert near.errors["along"].median == pytest.approx(2.5 * ALONG)
    hidden = one(found, "occlusion", "2 largely")
    assert (hidden.cars, hidden.frames) == (1, 10)
    assert hidden.errors["across"].median == pytest.approx(24.5 * ACROSS)
    assert one(found, "occlusion", "not labelled").frames == 5
    assert one(found, "occlusion", "1 partly").frames == FRAMES - 5
    assert one(found, "manoeuvre", "standing").cars == 2
    assert one(found, "manoeuvre", "straight").distance_m == pytest.approx(20.5)
    assert {g.value for g in groups(found, "manoeuvre")} == {"standing", "straight"}


def test_intervals_draw_whole_cars() -> None:
    """Cars without any scatter of their own: only which of them are drawn matters, however many windows each has."""
    level = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    few, many = (spread(np.repeat(level, n) * (-1) ** np.arange(5 * n), np.repeat(np.arange(5), n)) for n in (2, 200))
    assert few.median == many.median == 3.0
    assert (few.low, few.high) == (many.low, many.high)
    # By the binomial distribution of how many of the five drawn are 1 or 2: P(median <= 1) = 0.058, not in the tails.
    assert (few.low, few.high) == (1.0, 5.0)
    assert np.isnan(spread(level[:2], np.arange(2)).low)
    assert np.isnan(spread(np.array([np.nan]), np.zeros(1)).median)
    assert spread(np.arange(101.0), np.zeros(101)).p95 == 95.0


def test_tables_and_figures(tmp_path: Path) -> None:
    study = made(tmp_path)
    table = TABLES["replay_battery"](study)
    assert list(table["frames of"].unique()) == ["all", "distance", "occlusion", "manoeuvre"]
    assert table.loc[1, "windows failed"] == "42 of 84"
    cars = TABLES["replay_cars"](study).set_index(["track", "estimator"])
    assert cars.loc[(0, "a"), "from-to [m]"] == "6-35"
    assert cars.loc[(0, "a"), "occluded [%]"] == 33
    assert cars.loc[(2, "b"), "mostly"] == "standing"
    for by in ("distance", "occlusion", "manoeuvre"):
        figure = FIGURES["replay_errors"](study, by=by)
        titles = [ax.get_title(loc="left") for ax in figure.axes]
        assert titles[:4] == ["position along", "position across", "speed", "yaw rate"]
        assert sum(p.get_height() for p in figure.axes[4].patches if isinstance(p, Rectangle)) == 3 * FRAMES


def test_cars_that_nobody_could_estimate_are_counted(tmp_path: Path) -> None:
    study = made(tmp_path, estimated=False)
    table = TABLES["replay_battery"](study)
    assert (table.loc[table["frames of"] == "all", ["frames", "estimated [%]"]] == [3 * FRAMES, 0]).all(axis=None)
    assert table["speed [m/s]"].isna().all()
    FIGURES["replay_errors"](study)
