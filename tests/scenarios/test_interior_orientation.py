"""The experiment of the calibration wall: exact without noise, honest with it, and what flat walls cannot give."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from estimators.aerial.interior_orientation import NAMES, parameters
from scenarios.experiments.interior_orientation import WallCalibration


def measured(runs: int = 1, **settings: float) -> pd.DataFrame:
    """A row per run, a column per quantity."""
    rows = [WallCalibration(**settings)(1, run).set_index("quantity")["value"] for run in range(runs)]  # type: ignore[arg-type]  # whole numbers stay whole
    return pd.DataFrame(rows)


def test_the_true_camera_is_the_one_that_is_set() -> None:
    camera = WallCalibration(focal_px=2000.0, principal_px=(1.0, 2.0), affinity_px=(3.0, 4.0)).camera
    assert dict(zip(NAMES, parameters(camera), strict=True)) == pytest.approx(
        {"f": 2000.0, "b1": 3.0, "b2": 4.0, "cx": 512.5, "cy": 513.5}
        | {"k1": -0.12, "k2": 0.08, "k3": 0.05, "p1": 4e-4, "p2": -3e-4}
    )


def test_without_noise_the_camera_is_found() -> None:
    found = measured(sigma_px=1e-6).iloc[0]
    assert found["image_largest"] < 1e-4
    assert found["failed"] == 0
    assert found["sigma_0"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("depth_m", [0.0, 0.5])
def test_covariances_are_honest(depth_m: float) -> None:
    found = measured(30, depth_m=depth_m)
    # 300 degrees of freedom: 3 sigma.
    assert found["nees"].mean() == pytest.approx(1.0, abs=3 * np.sqrt(2 / 300))
    assert np.sqrt(np.mean(found["corner_noise"] ** 2)) == pytest.approx(0.03, rel=0.01)


def test_a_flat_wall_needs_tilt_and_a_deep_one_does_not() -> None:
    flat, deep = (measured(5, tilt_deg=3.0, depth_m=d)["f_sigma"].mean() for d in (0.0, 0.5))
    assert flat > 5 * deep
    assert measured(5, tilt_deg=30.0)["f_sigma"].mean() < 0.2 * flat


def test_photographs_give_the_camera_too() -> None:
    found = measured(images=4, photographs=True).iloc[0]
    assert found["points"] > 300
    assert found["corner_noise"] < 0.05
    for name in ("f", "cx", "k1"):
        assert abs(found[f"{name}_error"]) < 4 * found[f"{name}_sigma"]


def test_a_calibration_that_fails_is_a_row() -> None:
    found = WallCalibration(images=1, tilt_deg=0.0)(1, 0).set_index("quantity")["value"]
    assert found["failed"] == 1
    assert "f_error" not in found


def test_wrong_settings_are_refused() -> None:
    for name, value in (("images", 0), ("tilt_deg", 80.0), ("depth_m", -1.0), ("sigma_px", 0.0), ("focal_px", 10.0)):
        with pytest.raises(ValueError, match=name):
            WallCalibration(**{name: value})  # type: ignore[arg-type]  # wrong on purpose
