"""Tables, figures and statements on the calibration wall, made of results whose answers are known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from estimators.aerial.image_error import displacements, image_rays, unturned
from estimators.aerial.interior_orientation import NAMES, camera_of, parameters
from reports.kozempel.interior import (
    CORNERS_PX,
    chosen,
    claims,
    design_table,
    iteration_errors,
    iteration_table,
    left_field,
    lens_field,
    parameters_table,
    reduced_field,
    true_camera,
)
from reports.kozempel.interior_figures import design_figure, field_figure, iteration_figure
from reports.studies import StudyResult
from sim.camera import Camera
from sim.pose import exp_so3

Array = np.ndarray
LENS: dict[str, Any] = {
    "focal_px": 2500.0, "principal_px": [3.0, -4.0], "radial": [-0.12, 0.08, 0.05], "decentring": [4e-4, -3e-4],
    "affinity_px": [4.0, 1.5],
}  # fmt: skip
SIGMA = dict(zip(NAMES, (0.1, 0.05, 0.05, 0.2, 0.2, 2e-3, 0.07, 0.7, 2e-5, 2e-5), strict=True))
RUNS = 4


def study(nees: float = 1.0, depths: tuple[float, ...] = (0.0, 0.5)) -> StudyResult:
    """Errors of exactly one sigma, the sign by turns; the image's error as large as stated."""
    settings: dict[str, dict[str, Any]] = {
        f"{depth:g} {images} {photographs}": {
            "depth_m": depth, "tilt_deg": 30.0, "images": images, "photographs": photographs,
        }
        for depth in depths
        for images, photographs in ((12, False), (48, False), (12, True))
    }  # fmt: skip
    rows = []
    for point in settings:
        for run in range(RUNS):
            values = {"points": 1000.0, "failed": 0.0, "corner_noise": 0.03, "nees": nees, "sigma_0": 1.0}
            values |= {"image_error": 0.2, "image_sigma": 0.2, "image_largest": 0.3, "largest_turned": 0.1}
            values |= {f"{n}_sigma": s for n, s in SIGMA.items()} | {"k1_k2_correlation": -0.97}
            values |= {f"{n}_error": s * (-1) ** run for n, s in SIGMA.items()}
            rows += [(point, run, "adjustment", q, settings[point]["images"], v) for q, v in values.items()]
    nothing = pd.DataFrame(columns=["point", "run", "estimator", "reason"])
    measures = pd.DataFrame(rows, columns=["point", "run", "estimator", "quantity", "t_s", "value"])
    return StudyResult(
        folder=Path("nowhere"), name="kozempel-interior-orientation", title="", source="", scenario="experiment",
        experiment=True, seed=1, runs=RUNS, points=pd.DataFrame(list(settings.values()), index=list(settings)),
        scenarios={p: s | LENS for p, s in settings.items()}, estimators=("adjustment",), comparison=nothing,
        nees=nothing, outliers=nothing, failures=nothing, support=nothing, measures=measures, runtimes=nothing,
    )  # fmt: skip


def test_the_true_camera_is_the_study_s() -> None:
    x = dict(zip(NAMES, parameters(true_camera(study())), strict=True))
    assert x["cx"] == 514.5
    assert (x["b1"], x["b2"], x["k3"], x["p2"]) == pytest.approx((4.0, 1.5, 0.05, -3e-4))


def test_tables_hold_what_was_measured() -> None:
    design = design_table(study())
    assert list(design["wall"]) == ["flat"] * 3 + ["deep"] * 3
    assert design["f, RMS [px]"].tolist() == pytest.approx([0.1] * 6)
    assert design["principal p., sigma [px]"].tolist() == pytest.approx([0.2 * np.sqrt(2)] * 6)
    table = parameters_table(study()).set_index("parameter")
    assert table["RMS / sigma"].tolist() == pytest.approx([1.0] * 10)
    assert table["true / sigma"]["b1"] == pytest.approx(80.0)
    assert table["correlated with"]["k1"] == "k2 -0.97"
    with pytest.raises(ValueError, match="12 images"):
        chosen(study(depths=(0.0,)), deep=True)


def test_a_rotation_is_no_error_and_the_rest_stays() -> None:
    camera = true_camera(study())
    rays = image_rays(camera)
    turned = camera.project(rays @ exp_so3(np.array([2e-4, -1e-4, 3e-4])).T) - camera.project(rays)
    left = unturned(camera, rays, turned)
    # What is of second order in the angles.
    assert np.abs(left).max() < 1e-3 * np.abs(turned).max()
    longer = camera_of(parameters(camera) + np.array([5.0] + [0.0] * 9), camera.size_px)
    d = displacements(longer, camera, rays)
    np.testing.assert_allclose(np.linalg.norm(unturned(camera, rays, d)), np.linalg.norm(d), rtol=0.01)


def test_fields_are_those_of_the_lens() -> None:
    camera = true_camera(study())
    own, lost = lens_field(camera), reduced_field(camera)
    x = parameters(camera)
    assert np.linalg.norm(own, axis=1).max() == pytest.approx(7.0, abs=1.0)
    plain = camera_of(np.array([*x[:1], 0, 0, *x[3:7], 0, 0, 0]), camera.size_px)
    assert np.abs(reduced_field(plain)).max() < 1e-9
    assert 0.5 < np.linalg.norm(lost, axis=1).max() < 2.0
    none = Camera.simple((1024, 1024), 2500.0)
    assert np.abs(lens_field(none)).max() < 1e-9
    # Each run is off by the same one sigma to one side or the other.
    left = left_field(study(), chosen(study()))
    rays = image_rays(camera)
    d = displacements(camera_of(x + np.array(list(SIGMA.values())), camera.size_px), camera, rays)
    np.testing.assert_allclose(left, np.linalg.norm(unturned(camera, rays, d), axis=1), rtol=0.02)


def test_the_iteration_s_error_falls_by_the_slope_of_the_distortion() -> None:
    camera = true_camera(study())
    left = iteration_errors(camera, 7.0)
    assert left[0] == pytest.approx(7.0)
    # The slope of a distortion by r^3 at the corner, 723 px out, is three times its size over the radius.
    assert left[2] / left[1] == pytest.approx(3 * 7 / 723, rel=0.4)
    table = iteration_table(study())
    assert list(table["distortion in the corner [px]"])[:1] == [CORNERS_PX[0]]
    enough = table["enough for 0.1 px"].tolist()
    assert enough[0] == "1"
    assert len(set(enough)) > 2


def test_statements_follow_the_numbers() -> None:
    good = claims(study())
    assert list(good["holds"]) == ["yes", "in part", "yes", "in part"]
    assert "not: k2, k3" in good["found here"][1]
    # Covariances that are wrong everywhere, by a factor of four.
    assert claims(study(nees=16.0))["holds"][0] != "yes"


def test_figures_show_every_series() -> None:
    figure = design_figure(study())
    labels = {line.get_label() for line in figure.axes[0].lines}
    assert {"flat wall, sigma", "deep wall, RMS", "flat wall, photos"} <= labels
    assert len(field_figure(study()).axes) == 4
    assert len(iteration_figure(study()).axes[0].lines) == len(CORNERS_PX) + 3
