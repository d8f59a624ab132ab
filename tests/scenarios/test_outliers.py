"""Simulated outliers meet the detectors: what is labelled is found, and the report counts it."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from estimators import SlidingWindowAdjustment
from estimators.estimate import TrajectoryEstimate
from reports.evaluation import evaluate
from scenarios import spec
from sim.simulate import simulate

SCENE = ("render.enabled=false", "world.roadside=false", "rig.frames=10", "vehicle.0.motion.start_m=[-3.5, 25.0]")


@pytest.mark.parametrize("detector", ["tracks", "robust"])
@pytest.mark.parametrize("kind", ["noise", "stereo"])
def test_a_detector_leaves_the_outliers_out_and_names_them(detector: Literal["tracks", "robust"], kind: str) -> None:
    scenario = spec.read("oncoming", [*SCENE, f"outliers=[{{kind='{kind}', tracks=0.3}}]"])
    observations, truth = simulate(scenario)
    wrong = set(observations.tracks.track[truth.labels.kind > 0].tolist())
    estimate = SlidingWindowAdjustment(start_window=10, outliers=detector)(observations)
    assert isinstance(estimate, TrajectoryEstimate)
    window = estimate.windows[-1]
    rejected, used = set(window.rejected.tolist()), set(window.track.tolist())
    assert not rejected & used
    assert not wrong & used
    assert len(rejected - wrong) <= 0.15 * len(used)  # the detectors' levels are 5 % and 1 %
    assert 0.9 < window.sigma_0 < 1.1
    counted = evaluate(truth, observations.tracks, estimate, scenario="x", seed=1, run=0, estimator="x").outliers
    assert counted["fn"].iloc[0] == 0
    assert counted["tp"].iloc[0] == len(wrong & rejected)
    assert counted["fp"].iloc[0] == len(rejected - wrong)


def test_without_outliers_nothing_is_counted() -> None:
    observations, truth = simulate(spec.read("oncoming", SCENE))
    estimate = SlidingWindowAdjustment(start_window=10)(observations)
    counted = evaluate(truth, observations.tracks, estimate, scenario="x", seed=1, run=0, estimator="x").outliers
    assert (counted[["tp", "fp", "fn", "flagged"]] == 0).all(axis=None)
    assert np.array_equal(estimate.windows[0].rejected, [])
