"""A run folder to one self-contained report that opens from disk without a network."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined, Template, select_autoescape

from estimators.estimate import EstimationFailed
from reports import display
from reports.front_end_display import front_end_section
from reports.run import Run, evaluate_run, load_run, write_figures, write_tables
from sim.archive import write_text

FIGURES = {
    "frames": (
        "What the camera saw",
        "Left images at five times, whole and enlarged. The true bounding box in black, the estimated ones in colour: "
        "the true box carried over by the alignment of the estimated points on the true ones. Dots are the measured "
        "tracks, crosses labelled outliers with a line from where the point truly is. Without rendered images the "
        "canvas is empty.",
    ),
    "trajectory": (
        "Trajectory",
        "Path of the points' centroid seen from above, with 3σ bars, and its error in every frame, estimated online: "
        "each frame as the newest of its window. Bands are ±3σ as the estimator states them; an honest one's errors "
        "leave them once in 370 frames. Triangles mark values beyond the axes, gaps are frames without an estimate.",
    ),
    "velocity": (
        "Velocity",
        "Velocity of the reference point (middle of the rear axle), speed and yaw rate, positive to the "
        "left, with ±3σ. All are differences of the two newest frames of one window: noisy, and in turns half an "
        "interval late against the truth at the instant.",
    ),
    "depth_error": (
        "Depth error over distance",
        "Depth error of every window against the true distance: negative is too near. The shaded band is what the "
        "estimator states, the dashed lines three Cramér-Rao bounds, which no unbiased estimator can undercut. "
        "Black bars are means per 10 m; a run of bars away from zero is a depth bias.",
    ),
    "point_cloud": (
        "Shape",
        "Estimated points of a far, a middle and a near window in the true vehicle's frame, over its true outline. "
        "Lines join each point to the true one it stands for, so both shape and position errors show.",
    ),
    "nees": (
        "Consistency",
        "Squared error of each window, weighted by the inverse of the stated covariance, per degree of freedom: one on "
        "average if the covariance is honest, above if it is too optimistic. Velocities are compared with true "
        "differences of the same two frames. Large symbols are windows that share no frame; only these are independent "
        "and enter the summary.",
    ),
}


def write_report(run_folder: Path, name: str | None = None) -> Path:
    """Evaluates a run and writes errors.parquet, metrics.csv, figures/ and report.html into its folder.

    name: the scenario's, by default taken from a folder called ``<scenario>-<seed>``.
    """
    run = load_run(run_folder, name)
    evaluations = evaluate_run(run)
    metrics = write_tables(run, evaluations)
    figures = write_figures(run, evaluations, metrics)
    path = run_folder / "report.html"
    write_text(path, render(run, metrics, figures))
    return path


def render(run: Run, metrics: pd.DataFrame, figures: Mapping[str, Path]) -> str:
    """The report as one HTML text, figures embedded."""
    labels = list(run.estimates)
    return template("report.html.j2").render(
        title=run.scenario["title"],
        source=run.scenario.get("source") or "",
        name=run.name,
        seed=run.seed,
        estimators=[_estimator(run, metrics, label) for label in labels],
        statistics=display.HEADINGS,
        bins=display.depth_bins(metrics, labels),
        labels=labels,
        figures=[(key, *text, embedded(figures[key])) for key, text in FIGURES.items() if key in figures],
        front_end=front_end_section(metrics) if run.tracked else None,
        front_end_figure=embedded(figures["front_end"]) if run.tracked else None,
        settings=list(display.settings(run.scenario)),
        stages=run.stages_s,
        provenance=run.provenance,
    )


def _estimator(run: Run, metrics: pd.DataFrame, label: str) -> dict[str, Any]:
    estimate = run.estimates[label]
    failed = estimate if isinstance(estimate, EstimationFailed) else None
    return {
        "label": label,
        "failed": failed,
        "cards": display.cards(metrics, label),
        "groups": display.error_groups(metrics, label),
        "failures": [] if failed else display.failures(metrics, label),
    }


def template(name: str) -> Template:
    """One of our templates, strict about what is not given, with numbers as the reports write them."""
    environment = Environment(
        loader=PackageLoader("reports"),
        autoescape=select_autoescape(["html", "html.j2"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = display.number
    return environment.get_template(name)


def embedded(path: Path) -> str:
    """An image as a part of the page itself."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
