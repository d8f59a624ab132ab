"""Two estimators on the same runs: lags, settling times, biases and verdicts that are known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reports.recursive.comparison import BRAKED, SETTLED, better_table, lag_sums, verdict
from reports.recursive.comparison_figures import (
    manoeuvre_figure,
    start_figure,
    wrong_tracks_figure,
    wrong_tracks_table,
)
from reports.recursive.method_statements import methods
from reports.recursive.situations import Curves, curves, situation
from reports.recursive.vehicle import nis_of, noise_table, poor_start_table, vehicle_figure
from reports.studies import StudyResult

ESTIMATORS = ("filter", "adjustment", "poor filter", "started filter")
T_S = 0.04 * np.arange(1, 51)
RUNS = 8
AXES = {"position": ("x", "y", "z"), "orientation": ("x", "y", "z"), "speed": ("all",), "yaw_rate": ("all",)}


def scenario(kind: str, wrong: float = 0.0) -> dict[str, Any]:
    return {"vehicle": [{"motion": {"kind": kind}}], "outliers": [{"tracks": wrong}] if wrong else []}


def truth(kind: str, quantity: str) -> np.ndarray:
    if kind == "braking" and quantity == "speed":
        return np.asarray(np.clip(8 - 7 * (T_S - 0.8), 0, 8))
    if kind == "turning" and quantity == "yaw_rate":
        return np.asarray(np.clip(2 * (T_S - 0.8), 0, 0.5))
    return np.full(len(T_S), 5.0)


def error(label: str, kind: str, wrong: float, quantity: str, common: np.ndarray) -> np.ndarray:
    """The filter lags by 0.1 s and is quiet; the adjustment is on time, half as rough again and 0.02 too far.

    From a poor start a filter is off by 10 at first and comes back with a time constant of 0.1 s.
    """
    rate: np.ndarray = np.gradient(truth(kind, quantity), T_S)
    if label == "adjustment":
        return 0.03 * common + 0.02
    lagging = 0.02 * common * (1 + 10 * wrong) - 0.1 * rate
    return np.asarray(lagging + (10 * np.exp(-T_S / 0.1) if label == "poor filter" else 0))


def study(scenarios: dict[str, dict[str, Any]], estimators: tuple[str, ...] = ESTIMATORS) -> StudyResult:
    rng = np.random.default_rng(1)
    rows, nees, measures = [], [], []
    for point, s in scenarios.items():
        kind, wrong = s["vehicle"][0]["motion"]["kind"], sum(o["tracks"] for o in s["outliers"])
        for run in range(RUNS):
            for quantity, axes in AXES.items():
                for axis in axes:
                    common, true = rng.standard_normal(len(T_S)), truth(kind, quantity)
                    for label in estimators:
                        e = error(label, kind, wrong, quantity, common)
                        names = {"point": point, "run": run, "estimator": label, "quantity": quantity}
                        rows.append(pd.DataFrame(names | {"axis": axis, "t_s": T_S, "error": e, "truth": true}))
            for label in estimators:
                names = {"point": point, "run": run, "estimator": label}
                large = 12.0 if label == "adjustment" else 6.0
                nees += [pd.DataFrame(names | {"quantity": q, "t_s": T_S, "nees": large}) for q in ("pose", "velocity")]
                measures += [
                    pd.DataFrame(names | {"quantity": "nis", "t_s": T_S, "value": 1.5}),
                    pd.DataFrame(names | {"quantity": "nis_dof", "t_s": T_S, "value": 20.0}),
                ]
    nothing = pd.DataFrame(columns=["point", "run", "estimator"])
    return StudyResult(
        folder=Path("nowhere"),
        name="filter-vs-adjustment",
        title="",
        source="",
        scenario="oncoming",
        experiment=False,
        seed=1,
        runs=RUNS,
        points=pd.DataFrame(index=list(scenarios)),
        scenarios=scenarios,
        estimators=estimators,
        comparison=pd.concat(rows, ignore_index=True).assign(entity="target"),
        nees=pd.concat(nees, ignore_index=True),
        outliers=nothing,
        failures=nothing,
        support=nothing,
        measures=pd.concat(measures, ignore_index=True),
        runtimes=nothing,
    )


@pytest.fixture(scope="module")
def found() -> StudyResult:
    kinds = {"a": ("straight", 0.0), "b": ("straight", 0.2), "c": ("braking", 0.0), "d": ("turning", 0.0)}
    return study({p: scenario(*k) for p, k in kinds.items()})


def test_situations_have_names() -> None:
    assert situation(scenario("straight")) == "constant velocity"
    assert situation(scenario("straight", 0.2)) == "20 % wrong tracks"


def test_a_delay_is_the_lag() -> None:
    t_s = np.arange(0, 3, 0.01)
    true = np.sin(t_s)
    late = np.sin(t_s - 0.02)
    c = Curves(t_s, np.tile((late - true)[:, None], (2, 1, 1)), np.tile(true[:, None], (2, 1, 1)))
    sums = lag_sums(c, least=0.1)
    assert sums[:, 0] / sums[:, 1] == pytest.approx(0.02, rel=0.02)  # of first order in a delay of 0.02 rad


def test_the_table_says_where_each_is_better(found: StudyResult) -> None:
    table = better_table(found).set_index(["situation", "aspect"])
    says = table["better"]
    assert says["constant velocity", "bias of depth [m]"] == "filter"
    assert says["constant velocity", "RMS of position [m]"] == "filter"
    assert says["constant velocity", "NEES of pose, logarithm"] == "filter"
    assert says["braking", "lag of speed [s]"] == "adjustment"
    assert says["turning", "lag of yaw rate [s]"] == "adjustment"
    assert says["braking", "RMS of speed [m/s]"] == "adjustment"
    lag: Any = table.loc[("braking", "lag of speed [s]")]
    assert lag["filter"] == pytest.approx(0.1, abs=0.005)
    assert lag["from"] <= lag["difference"] <= lag["to"]
    assert ("20 % wrong tracks", "NEES of pose, logarithm") not in table.index
    itself = better_table(found, first="filter", second="filter")
    assert set(itself["better"]) == {"neither"}
    with pytest.raises(ValueError, match="found 'x', allowed: filter"):
        better_table(found, first="x")


def test_settling_after_a_poor_start(found: StudyResult) -> None:
    table = better_table(found, first="poor filter", second="filter").set_index("aspect")
    position: Any = table.iloc[0]
    # Three axes off by 10 exp(-t / 0.1) m fall below the limit after 0.1 ln(10 sqrt(3) / 0.3) s; frames are 0.04 s.
    assert position["poor filter"] == pytest.approx(0.1 * np.log(10 * np.sqrt(3) / SETTLED["position"]), abs=0.045)
    assert position["filter"] == T_S[0]
    assert position["better"] == "filter"


def test_no_estimate_is_not_settled() -> None:
    one = study({"a": scenario("straight")})
    c = one.comparison
    late = StudyResult(**{**vars(one), "comparison": c[(c["estimator"] != "filter") | (c["t_s"] > 0.5)]})
    assert np.isnan(curves(late, "a", "filter", "speed").error[:, 0]).all()
    assert better_table(late).iloc[0]["filter"] == pytest.approx(0.52)


def test_verdicts() -> None:
    assert verdict(-2, -1, "a", "b") == "a"
    assert verdict(1, 2, "a", "b") == "b"
    assert verdict(-1, 2, "a", "b") == "neither"


def test_statements_on_the_methods(found: StudyResult) -> None:
    assert [holds for _, _, holds in methods(found)] == ["yes", "yes", "yes", "yes", "in part"]


def test_figures_and_errors_by_wrong_tracks(found: StudyResult) -> None:
    table = wrong_tracks_table(found)
    assert sorted(set(table["wrong tracks [%]"])) == [0, 20]
    rms = table.set_index(["estimator", "wrong tracks [%]"])["position, RMS [m]"]
    assert rms["filter", 20] == pytest.approx(3 * rms["filter", 0], rel=0.1)
    assert len(start_figure(found).axes) == 3
    assert len(wrong_tracks_figure(found).axes) == 2
    lags = manoeuvre_figure(found).axes[2].get_legend()
    assert lags is not None
    assert [t.get_text() for t in lags.get_texts()][::2] == ["100 ms", "100 ms"]


@pytest.fixture(scope="module")
def tuned() -> StudyResult:
    def with_arguments(noise: float, sigmas: float) -> dict[str, Any]:
        arguments = {"name": "vehicle_filter", "longitudinal_noise_mps2_sqrt_s": noise, "poor_sigmas": sigmas}
        return scenario("braking") | {"estimator": [arguments | {"label": e} for e in ("own start", "poor start")]}

    points = [(0.3, 5.0), (3.0, 5.0), (30.0, 5.0), (3.0, 1.0)]
    return study({f"{p}": with_arguments(*p) for p in points}, ("own start", "poor start"))


def test_series_of_the_vehicle_filter(tuned: StudyResult) -> None:
    table = noise_table(tuned)
    assert table["√Q / default"].tolist() == pytest.approx([0.1, 1.0, 10.0])
    assert table["lag [s]"].tolist() == pytest.approx([0.1] * 3, abs=0.005)
    assert table["NEES of pose"].tolist() == [1.0] * 3
    start = poor_start_table(tuned)
    assert start["P*(0) / error²"].tolist() == pytest.approx([1 / 25, 1.0])
    assert len(vehicle_figure(tuned).axes) == 4
    assert BRAKED < 7


def test_nis_pools_all_frames(tuned: StudyResult) -> None:
    value, low, high = nis_of(tuned, "(3.0, 5.0)", "own start")
    assert value == pytest.approx(1.5)
    late = int((T_S >= 0.6 - 1e-9).sum())
    assert high - low == pytest.approx(2 * 1.96 * np.sqrt(2 / (20 * late * RUNS)), rel=0.01)  # normal, of so many
