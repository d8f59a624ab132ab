"""A run folder becomes tables, figures and one file that needs nothing else."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest

from reports.display import number, settings
from reports.errors import ERROR_COLUMNS
from reports.figures.cloud import silhouette
from reports.figures.strip import project_box
from reports.figures.style import robust_limits
from reports.html import FIGURES, write_report
from reports.metrics import METRIC_COLUMNS
from reports.run import load_run
from sim.pose import Pose


def make_run(folder, world, estimators, with_image=True):
    """A run folder as the stages before the report leave it; an estimator without estimate has failed."""
    world.truth.save(folder / "truth")
    names = tuple((f"images/left/{k:06d}.png", f"images/right/{k:06d}.png") for k in range(len(world.truth.t_s)))
    replace(world.observations, images=names if with_image else None).save(folder / "observations")
    if with_image:
        image = folder / "observations" / names[2][0]
        image.parent.mkdir(parents=True)
        cv2.imwrite(str(image), np.full((768, 1024, 3), 90, np.uint8))
    for label, estimate in estimators.items():
        target = folder / "estimates" / label
        target.mkdir(parents=True)
        if estimate is None:
            (target / "failure.json").write_text(json.dumps({"reason": "no <tracks>", "hints": ["look"]}))
        else:
            estimate.save(target)
    scenario = {
        "title": "A box & more",
        "source": None,
        "kind": "stereo",
        "seed": 7,
        "vehicle": [{"name": "target", "motion": {"start_m": [0, 40.0]}}],
        "estimator": [{"name": "sliding_window_adjustment", "label": label} for label in estimators],
    }
    provenance = {
        "hash": "0123456789abcdef",
        "git_commit": "abc123",
        "versions": {"numpy": "2"},
        "stages": {"simulate": {"key": "k", "seconds": 1.5}, "report": {"key": "k", "seconds": 9.0}},
    }
    (folder / "scenario.json").write_text(json.dumps(scenario))
    (folder / "provenance.json").write_text(json.dumps(provenance))


@pytest.fixture(scope="module")
def report(world, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "box-7"
    offset = world.moved(Pose(np.eye(3), np.array([0, 0, 0.3])))
    make_run(folder, world, {"true": world.estimate, "off by 0.3": offset, "failing": None})
    return write_report(folder)


def test_tables_have_the_columns_of_the_contract(report):
    errors, metrics = pd.read_parquet(report.parent / "errors.parquet"), pd.read_csv(report.parent / "metrics.csv")
    assert errors.columns.tolist() == ERROR_COLUMNS
    assert metrics.columns.tolist() == METRIC_COLUMNS
    assert set(errors["scenario"]) == {"box"}
    assert set(errors["estimator"]) == {"true", "off by 0.3", "failing"}
    assert (errors.loc[errors["estimator"] == "failing", "quantity"] == "failure").all()


def test_figures_are_there_in_three_formats(report):
    names = {p.name for p in (report.parent / "figures").iterdir()}
    assert names == {f"{name}.{kind}" for name in FIGURES for kind in ("png", "svg", "pdf")}


def test_the_report_needs_nothing_else(report):
    text = report.read_text("utf-8")
    assert not re.search(r"(src|href)=\"(?!data:|#)", text)
    assert "http" not in re.sub(r"base64,[^\"]*", "", text)
    assert text.count("data:image/png;base64,") == len(FIGURES)
    assert "A box &amp; more" in text
    assert "no &lt;tracks&gt;" in text
    assert "vehicle.0.motion.start_m =" in text
    assert "1.50 s" in text
    assert "9.00 s" not in text


def test_nothing_estimated_still_reports(world, tmp_path):
    folder = tmp_path / "somewhere"
    make_run(folder, world, {"failing": None}, with_image=False)
    text = write_report(folder, name="box").read_text("utf-8")
    assert write_report(folder, name="box").read_text("utf-8") == text  # no dates, no random numbers
    assert text.count("data:image/png;base64,") == 1
    assert load_run(folder).name == "somewhere"
    metrics = pd.read_csv(folder / "metrics.csv")
    assert set(metrics["scenario"]) == {"box"}
    assert metrics.loc[metrics["statistic"] == "converged", "value"].tolist() == [0]


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0729, "m", "0.0729"),
        (-12.345, "m", "−12.3"),
        (0.0, "m", "0.00"),
        (1234.0, "m", "1234"),
        (np.pi, "rad", "180"),
        (2.5e-9, "m", "2.5·10⁻⁹"),
        (np.nan, "m", "–"),
    ],
)
def test_numbers(value, unit, text):
    assert number(value, unit) == text


def test_settings_are_paths_and_values():
    found = dict(settings({"a": {"b": [1, 2]}, "c": [{"d": "e"}], "f": [], "g": None}))
    assert found == {"a.b": "[1, 2]", "c.0.d": '"e"', "f": "[]"}


def test_silhouette_of_an_l_keeps_its_notch():
    """Area of an L of two unit squares and one more: 3 m²; its convex hull has 3.5."""
    u = np.linspace(0, 2, 41)
    grid = np.stack(np.meshgrid(u, u), axis=-1).reshape(-1, 2)
    (contour,) = silhouette(grid[~((grid[:, 0] > 1.001) & (grid[:, 1] > 1.001))])
    x, y = contour.T
    area = abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2
    assert area == pytest.approx(3.0, abs=0.08)  # raster of 5 mm, one triangle across the notch
    assert silhouette(np.zeros((5, 2))) == []


def test_box_behind_the_camera_is_not_drawn(world):
    box = world.truth.bodies[0].box_v
    camera = world.truth.rig.left
    front = project_box(camera, world.truth.T_cv[0], box)
    assert np.isfinite(front).all()
    corners = world.truth.T_cv[0].apply(box)
    assert np.allclose(front.reshape(-1, 2).min(axis=0), camera.project(corners).min(axis=0), atol=60)
    assert np.isnan(project_box(camera, Pose(np.eye(3), np.array([0, 0, -50.0])), box)).all()


def test_limits_hold_the_bulk_and_the_truth():
    low, high = robust_limits(np.append(np.linspace(-1, 1, 100), 1e6), np.array([3.0]))
    assert low < -0.9
    assert 3 < high < 5
