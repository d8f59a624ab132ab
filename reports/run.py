"""A run folder: its parts read, its tables and figures written."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
import pandas as pd
from jaxtyping import Int, UInt8
from matplotlib.figure import Figure

from estimators.estimate import EstimationFailed, TrajectoryEstimate
from reports import figures
from reports.errors import ERROR_COLUMNS, compare_windows
from reports.evaluation import Evaluation, evaluate
from reports.figures.strip import strip_frames
from reports.figures.style import STYLE
from reports.front_end import front_end_rows, pixel_errors
from reports.metrics import as_table, metrics_table
from sim.archive import write_atomically
from sim.observations import Observations
from sim.truth import Truth

Array = np.ndarray
_DPI = 200
# Without a date, two reports of the same run are the same file.
_METADATA: dict[str, dict[str, Any]] = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}


@dataclass(frozen=True, eq=False)
class Run:
    """What the stages before the report left: resolved scenario, provenance, products, estimates by label."""

    folder: Path
    name: str
    scenario: Mapping[str, Any]
    provenance: Mapping[str, Any]
    truth: Truth
    observations: Observations
    estimates: Mapping[str, TrajectoryEstimate | EstimationFailed]

    @property
    def tracked(self) -> bool:
        """Whether the observations are tracks of the image front end."""
        return self.observed.name == "tracks"

    @property
    def observed(self) -> Path:
        """The folder that the estimators were given."""
        return _observed(self.folder)

    @property
    def seed(self) -> int:
        return int(self.scenario["seed"])

    @property
    def stages_s(self) -> dict[str, float]:
        """Run time of every stage before the report [s]."""
        stages = self.provenance["stages"]
        return {name: float(stage["seconds"]) for name, stage in stages.items() if name != "report"}


def _observed(folder: Path) -> Path:
    tracks = folder / "tracks"
    return tracks if tracks.is_dir() else folder / "observations"


def load_run(folder: Path, name: str | None = None) -> Run:
    """Reads a run folder; the scenario's name defaults to that of a folder ``<scenario>-<seed>``.

    Raises
        ValueError: a file is not one of ours.
    """
    scenario, provenance = (json.loads((folder / f).read_text("utf-8")) for f in ("scenario.json", "provenance.json"))
    labels = [e.get("label") or e["name"] for e in scenario["estimator"]]
    labelled = folder / "labels"
    folders = {label: folder / "estimates" / label for label in labels}
    return Run(
        folder,
        name or folder.resolve().name.removesuffix(f"-{scenario['seed']}"),
        scenario,
        provenance,
        Truth.load(labelled if labelled.is_dir() else folder / "truth"),
        Observations.load(_observed(folder)),
        {label: load_estimate(path) for label, path in folders.items() if path.is_dir()},
    )


def load_estimate(folder: Path) -> TrajectoryEstimate | EstimationFailed:
    """What an estimator left in its folder."""
    failure = folder / "failure.json"
    if failure.is_file():
        stored = json.loads(failure.read_text("utf-8"))
        return EstimationFailed(stored["reason"], tuple(stored["hints"]))
    return TrajectoryEstimate.load(folder)


def evaluate_run(run: Run) -> list[Evaluation]:
    """Every estimate of a run held against its truth, in the scenario's order."""
    return [
        evaluate(
            run.truth,
            run.observations.tracks,
            estimate,
            scenario=run.name,
            seed=run.seed,
            run=0,
            estimator=label,
        )
        for label, estimate in run.estimates.items()
    ]


def write_tables(run: Run, evaluations: list[Evaluation]) -> pd.DataFrame:
    """Writes errors.parquet and metrics.csv; returns the metrics."""
    errors = pd.concat([e.comparison[ERROR_COLUMNS] for e in evaluations], ignore_index=True)
    metrics = metrics_table(evaluations, run.stages_s)
    if run.tracked:
        metrics = pd.concat([metrics, _front_end_metrics(run)], ignore_index=True)
    write_atomically(run.folder / "errors.parquet", lambda p: errors.to_parquet(p, index=False))
    write_atomically(run.folder / "metrics.csv", lambda p: metrics.to_csv(p, index=False))
    return metrics


def _front_end_metrics(run: Run) -> pd.DataFrame:
    seconds = run.stages_s["track"] / len(run.truth.t_s)
    whose = {"scenario": run.name, "seed": run.seed, "runs": 1, "estimator": ""}
    return as_table(whose | row for row in front_end_rows(run.truth, run.observations.tracks, seconds))


def write_figures(run: Run, evaluations: list[Evaluation], metrics: pd.DataFrame) -> dict[str, Path]:
    """Writes every figure as PNG, SVG and PDF into figures/; the PNG by name, in the report's order."""
    drawn = _figures(run, evaluations)
    if run.tracked:
        errors = pixel_errors(run.truth, run.observations.tracks)
        drawn["front_end"] = figures.front_end(errors, metrics, run.truth.t_s, run.truth.labels.kinds)
    return save_figures(run.folder / "figures", drawn)


def save_figures(folder: Path, figures: Mapping[str, Figure]) -> dict[str, Path]:
    """Writes figures as PNG, SVG and PDF; the PNG by name."""
    with mpl.rc_context(STYLE):
        for name, figure in figures.items():
            for kind, metadata in _METADATA.items():
                write_atomically(
                    folder / f"{name}.{kind}",
                    lambda p, f=figure, k=kind, m=metadata: f.savefig(p, format=k, dpi=_DPI, metadata=m),
                )
    return {name: folder / f"{name}.png" for name in figures}


def _figures(run: Run, evaluations: list[Evaluation]) -> dict[str, Figure]:
    tracks = run.observations.tracks
    comparisons = {
        label: compare_windows(run.truth, tracks, e)
        for label, e in run.estimates.items()
        if isinstance(e, TrajectoryEstimate)
    }
    frames = strip_frames(comparisons, run.truth)
    strip = figures.frame_strip(run.truth, tracks, comparisons, frames, left_images(run, frames))
    if not any(comparisons.values()):
        return {"frames": strip}
    table = pd.concat([e.comparison for e in evaluations], ignore_index=True)
    reference = "over ground" if any(e.over_ground for e in evaluations) else "relative"
    return {
        "frames": strip,
        "trajectory": figures.trajectory(table),
        "velocity": figures.velocity(table, reference),
        "depth_error": figures.depth_error(table),
        "point_cloud": figures.point_cloud(run.truth, comparisons),
        "nees": figures.nees(pd.concat([e.nees for e in evaluations if len(e.nees)], ignore_index=True)),
    }


def left_images(run: Run, frames: Int[Array, "f"]) -> dict[int, UInt8[Array, "h w 3"]]:
    """The left images of some frames as RGB, as far as they are there."""
    names = run.observations.images
    if names is None:
        return {}
    found = {}
    for frame in frames.tolist():
        image = cv2.imread(str(run.observed / names[frame][0]), cv2.IMREAD_COLOR)
        if image is not None:
            found[frame] = np.asarray(image[:, :, ::-1], np.uint8)
    return found
