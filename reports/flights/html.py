"""The report of a flight: tables, figures and one self-contained page."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from estimators.estimate import EstimationFailed
from reports import display
from reports.flights import figures
from reports.flights.boresight import ANGLES, boresight_figure, boresight_table
from reports.flights.errors import MEASURED, TRUE, covered_vehicles, ortho_errors, pose_errors
from reports.flights.metrics import error_rows, flight_metrics
from reports.flights.product import matched_displacements
from reports.flights.run import FlightRun, load_flight
from reports.html import embedded, template
from reports.run import save_figures
from sim.archive import write_atomically, write_text

CAPTIONS = {
    "overview": "The mosaic, every ground pixel from the image that sees it most steeply; outlines of the images as "
    "their measured orientation has them, and where the camera was.",
    "ortho": "Left the mean error of check points in the ortho images by their place in the image: one common shift is "
    "an error of attitude or position, a turn one of kappa, a stretch one of height or focal length. Right its root "
    "mean square by image, and what is left with the true orientation: the method's own error.",
    "orientation": "Errors of the navigation solution at the exposures, a wrong time of exposure included.",
    "boresight": "Estimated minus true boresight angles with three standard deviations as stated, and the angles of "
    "every image alone, in the order of time.",
    "roads": "Part of an ortho image at full resolution with the roads as estimators know them, and the vehicles where "
    "they are.",
}


def write_flight_report(folder: Path, name: str) -> Path:
    """Writes errors.parquet, metrics.csv, figures/ and report.html into a flight's run folder."""
    run = load_flight(folder, name)
    poses = pose_errors(run)
    errors = {label: ortho_errors(run, e) for label, e in run.orthos.items()}
    matched = {label: matched_displacements(run, label, e) for label, e in run.orthos.items()}
    covered = {label: covered_vehicles(run, e) for label, e in run.orthos.items()}
    metrics = flight_metrics(run, poses, errors, matched, covered)
    rows = error_rows(run, poses, errors)
    write_atomically(folder / "errors.parquet", lambda p: rows.to_parquet(p, index=False))
    write_atomically(folder / "metrics.csv", lambda p: metrics.to_csv(p, index=False))
    drawn = save_figures(folder / "figures", _figures(run, poses, errors))
    path = folder / "report.html"
    write_text(path, _page(run, metrics, drawn))
    return path


def _figures(run: FlightRun, poses: pd.DataFrame, errors: dict[str, pd.DataFrame]) -> dict[str, Figure]:
    """Of the first estimator's products, and the errors of each."""
    found: dict[str, Figure] = {}
    for k, (label, orthos) in enumerate(run.orthos.items()):
        for camera in run.observations.cameras:
            suffix = f" {camera.name}" if len(run.observations.cameras) > 1 else ""
            mosaic = run.folder / "estimates" / label / f"overview-{camera.name}.png"
            if k == 0 and mosaic.is_file():
                picture = np.asarray(cv2.imread(str(mosaic), cv2.IMREAD_UNCHANGED))
                found[f"overview{suffix}"] = figures.overview(run, picture, orthos, camera.name)
            part = errors[label][errors[label]["head"] == camera.name]
            if len(part):
                of_label = f" {label}" if len(run.orthos) > 1 else ""
                found[f"ortho{suffix}{of_label}"] = figures.ortho_errors(part, camera.camera.size_px)
        if k == 0:
            found["roads"] = figures.roads(run, label, orthos)
    if run.boresights:
        found["boresight"] = boresight_figure(run, run.boresights)
    found["orientation"] = figures.orientation(poses, run)
    return found


def _page(run: FlightRun, metrics: pd.DataFrame, drawn: dict[str, Path]) -> str:
    plan = run.scenario["flight"]
    return template("flight.html.j2").render(
        title=run.scenario["title"],
        source=run.scenario.get("source") or "",
        name=run.name,
        seed=run.seed,
        images=len(run.observations),
        cameras=", ".join(f"{plan['system']} {c.name}" for c in run.observations.cameras),
        zone=run.observations.georeference.epsg,
        figures=[(key, CAPTIONS[key.split(" ")[0]], embedded(path)) for key, path in drawn.items()],
        failed=[(k, e) for k, e in run.estimates.items() if isinstance(e, EstimationFailed)],
        failures=[(k, _reasons(e.failures)) for k, e in run.orthos.items() if e.failures],
        orthos=[(label, _ortho_table(metrics, label)) for label in run.orthos],
        matched=[(label, _matched(metrics, label)) for label in run.orthos],
        own_px=[(label, _own_px(metrics, label)) for label in run.orthos],
        boresights=_boresight_rows(run),
        said=[(label, words) for label, b in run.boresights.items() for words in (*b.inseparable, *b.excluded)],
        poses=_pose_table(metrics),
        others=_other_rows(metrics),
        settings=list(display.settings(run.scenario)),
        stages={k: v["seconds"] for k, v in run.provenance["stages"].items()},
        provenance=run.provenance,
    )


def _reasons(failures: Any) -> list[tuple[str, int]]:
    return list(Counter(f.reason for f in failures).items())


def _value(rows: pd.DataFrame, **where: str) -> str:
    for column, value in where.items():
        rows = rows[rows[column] == value]
    if rows.empty:
        return "–"
    row = rows.iloc[0]
    text = display.number(float(row["value"]))
    known = pd.notna(row["ci_low"]) and row["ci_low"] != ""
    return (
        f"{text} ({display.number(float(row['ci_low']))} to {display.number(float(row['ci_high']))})" if known else text
    )


def _ortho_table(metrics: pd.DataFrame, label: str) -> list[tuple[str, ...]]:
    """Errors of places: rows of orientation and axis; bias, std, rms, p95, max [m]."""
    own = metrics[(metrics["estimator"] == label) & (metrics["quantity"] == "ortho") & (metrics["unit"] == "m")]
    table = []
    for entity in (MEASURED, TRUE):
        axes = (("x", "east"), ("y", "north"), ("all", "both"))
        for axis, shown in axes if entity == MEASURED else axes[2:]:
            cells = [_value(own, entity=entity, axis=axis, statistic=s) for s in ("bias", "std", "rms", "p95", "max")]
            table.append((entity, shown, *cells))
    return table


def _own_px(metrics: pd.DataFrame, label: str) -> str:
    """The largest error of the method alone [px]."""
    own = metrics[(metrics["estimator"] == label) & (metrics["quantity"] == "ortho") & (metrics["unit"] == "px")]
    return _value(own, entity=TRUE, statistic="max")


def _matched(metrics: pd.DataFrame, label: str) -> dict[str, str]:
    own = metrics[(metrics["estimator"] == label) & (metrics["quantity"] == "ortho_matched")]
    if own.empty:
        return {}
    found = {s: _value(own, statistic=s) for s in ("rms", "median")}
    return found | {"n": str(int(own["n"].iloc[0]))}


def _boresight_rows(run: FlightRun) -> list[tuple[str, ...]]:
    """Estimator, camera, then of each angle estimate, error and sigma, images, points left out, residual."""
    table = boresight_table(run)
    rows = []
    for label, b in run.boresights.items():
        own = table[table["estimator"] == label].set_index("angle")
        values = own.loc[list(ANGLES), ["estimate", "error", "sigma"]].to_numpy(float).ravel()
        cells = [display.number(v) for v in values.tolist()]
        rows.append((label, b.camera, *cells, str(len(b.images)), f"{b.rejected} of {b.measured}"))
    return rows


def _pose_table(metrics: pd.DataFrame) -> list[tuple[str, ...]]:
    """Errors of orientation: axis, unit, bias, std, rms, max."""
    own = metrics[metrics["quantity"].isin(["attitude", "position"])]
    table: list[tuple[str, ...]] = []
    for axis in dict.fromkeys(own["axis"]):
        unit = str(own.loc[own["axis"] == axis, "unit"].iloc[0])
        table.append((axis, unit, *(_value(own, axis=axis, statistic=s) for s in ("bias", "std", "rms", "max"))))
    return table


def _other_rows(metrics: pd.DataFrame) -> list[tuple[str, ...]]:
    """All other numbers: what, whose, statistic, value with its interval, unit, n."""
    shown = metrics["quantity"].isin(["attitude", "position", "ortho_matched"])
    shown |= (metrics["quantity"] == "boresight") & metrics["statistic"].isin(["estimate", "bias", "sigma"])
    shown |= (metrics["quantity"] == "ortho") & ~metrics["statistic"].isin(["made", "failed"])
    rows: list[tuple[str, ...]] = []
    for _, m in metrics[~shown].iterrows():
        whose = " ".join(str(m[column]) for column in ("estimator", "entity") if m[column])
        unit = "" if m["unit"] == "1" else str(m["unit"])
        statistic = str(m["statistic"]).replace("_", " ")
        what = str(m["quantity"]).replace("_", " ")
        rows.append((what, whose, statistic, _value(pd.DataFrame([m])), unit, str(m["n"])))
    return rows
