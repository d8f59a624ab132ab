"""Formulas of a rig's accuracy: found again from a study made by them, and what their figures show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from reports.rig_design import QUANTITIES, Rig, fit, rig_table
from reports.rig_outputs import FIGURES
from reports.studies import StudyResult

Array = np.ndarray
CONSTANTS = {"depth": (1.1, 0.9), "closing speed": (1.3, 1.2), "yaw rate": (0.6, 1.15)}
EFFICIENCY = 0.8


def made(points: int = 40) -> StudyResult:
    """A study that obeys the formulas: errors of plus and minus the bound over the efficiency in two runs."""
    rng = np.random.default_rng(3)
    low, high = np.array([0.15, 700, 0.05, 15, 40, 3.0]), np.array([0.9, 2500, 0.1, 60, 300, 20.0])
    drawn = low * (high / low) ** rng.uniform(size=(points, 6))
    names = [str(i) for i in range(points)]
    scenarios, rows = {}, []
    for name, (b, f, s, z, n, w) in zip(names, drawn, strict=True):
        n, w = int(n), int(w)
        scenarios[name] = {
            "rig": {"baseline_m": b, "focal_px": f, "frames": w, "rate_hz": 25.0},
            "measure": {"sigma_px": s, "points": n},
        }
        for label, q in QUANTITIES.items():
            bound = float(q.formula(Rig(b, f, s, z, n, w), *CONSTANTS[label]))
            for run, sign in enumerate((1, -1)):
                rows.append((name, run, "e", q.quantity, "target", q.axis, sign * bound / EFFICIENCY, bound, z))
        # The smoothed frames lie elsewhere and count for nothing.
        rows.append((name, 0, "e", "position", "smoothed", "z", 50.0, np.nan, 2 * z))
    columns = ["point", "run", "estimator", "quantity", "entity", "axis", "error", "bound", "distance_m"]
    comparison = pd.DataFrame(rows, columns=columns)
    comparison["point"] = pd.Categorical(comparison["point"], names)
    nothing = pd.DataFrame()
    return StudyResult(
        folder=Path("nowhere"),
        name="rig-design",
        title="",
        source="",
        scenario="oncoming",
        experiment=False,
        seed=1,
        runs=2,
        points=pd.DataFrame(drawn, index=names),
        scenarios=scenarios,
        estimators=("e",),
        comparison=comparison,
        nees=nothing,
        outliers=nothing,
        failures=nothing,
        support=nothing,
        measures=nothing,
        runtimes=nothing,
    )


@pytest.mark.parametrize("name", QUANTITIES)
def test_constants_and_efficiency_are_found_again(name: str) -> None:
    found = fit(made(), name)
    np.testing.assert_allclose(found.constants, CONSTANTS[name], rtol=1e-6)
    assert found.efficiency == pytest.approx(EFFICIENCY)
    assert found.deviation < 1e-6
    assert found.scatter < 1e-6


def test_what_scales_how() -> None:
    one = Rig(0.3, 1000.0, 0.2, 40.0, 120, 10)
    depth, speed, yaw_rate = (fit(made(), name) for name in QUANTITIES)
    twice = {
        "noise": Rig(0.3, 1000.0, 0.4, 40.0, 120, 10),
        "focal length": Rig(0.3, 2000.0, 0.2, 40.0, 120, 10),
        "distance": Rig(0.3, 1000.0, 0.2, 80.0, 120, 10),
        "rate": Rig(0.3, 1000.0, 0.2, 40.0, 120, 10, 50.0),
    }
    ratios = {what: [f.bound(rig) / f.bound(one) for f in (depth, speed, yaw_rate)] for what, rig in twice.items()}
    np.testing.assert_allclose(ratios["noise"], [2, 2, 2])
    np.testing.assert_allclose(ratios["focal length"], [0.5, 0.5, 0.5])
    np.testing.assert_allclose(ratios["distance"], [4, 4, 2**1.15], rtol=1e-6)
    np.testing.assert_allclose(ratios["rate"], [1, 2, 2])
    # Of a very wide base one frame alone is as good as it gets.
    wide = Rig(1e6, 1000.0, 0.2, 40.0, 120, 10)
    assert depth.bound(wide) == pytest.approx(CONSTANTS["depth"][0] * wide.one_frame_m)


def test_out_of_reach_no_yaw_rate_is_foretold() -> None:
    found = fit(made(), "yaw rate")
    near, far = Rig(0.3, 1000.0, 0.2, 30.0, 120, 10), Rig(0.3, 1000.0, 0.2, 80.0, 120, 10)
    assert np.isfinite(found.achieved(near))
    assert np.isnan(found.achieved(far))
    assert np.isfinite(found.bound(far))


def test_too_few_points_are_refused() -> None:
    with pytest.raises(ValueError, match="2 points have an estimate"):
        fit(made(2), "depth")


def test_table_and_figures() -> None:
    study = made()
    table = rig_table(study).set_index("quantity")
    assert table.loc["depth", "constants"] == "k = 1.1, S [m] = 0.9"
    assert table.loc["closing speed", "efficiency"] == pytest.approx(EFFICIENCY)
    for draw in FIGURES.values():
        draw(study)
    axes = FIGURES["rig_accuracy"](study).axes
    assert [ax.get_title() if ax.get_title() else ax.get_title(loc="left") for ax in axes] == list(QUANTITIES)
    solid, dashed = axes[0].get_lines()[:2]
    np.testing.assert_allclose(np.array(dashed.get_ydata()) / np.array(solid.get_ydata()), EFFICIENCY)
