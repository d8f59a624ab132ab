"""The report of a calibration: tables, figures and one self-contained page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from estimators.estimate import EstimationFailed
from reports import display
from reports.calibrations import figures
from reports.calibrations.metrics import calibration_metrics
from reports.calibrations.run import CalibrationRun, load_calibration
from reports.calibrations.tables import (
    boresight_table,
    excluded_table,
    headings_deg,
    residual_table,
    striking_images,
)
from reports.calibrations.time_offset import least, time_offset_table
from reports.html import embedded, template
from reports.run import save_figures
from sim.archive import write_atomically, write_text

CAPTIONS = {
    "angles": "Boresight angles of every image with the standard deviation of clicks, control points and navigation as "
    "stated; lines and bands are the results of all images with theirs. The source found a scatter of 0.05 to 0.12 "
    "degrees (Kozempel 2012, Fig. 3.7).",
    "residuals": "All images in one image plane. Left from the click to where navigation and the result put the point: "
    "what georeferencing will show. Right by the pose that was adjusted to each image: what is left is error of the "
    "clicks, the control points and the lens. Each panel has its own scale.",
    "time_offset": "Residuals if the exposures came later than their time tags say, with the boresight held, and with "
    "it adjusted anew (as Kozempel 2012, Fig. 3.8): where the dashed curve is flat, the images do not tell a time "
    "offset from the boresight.",
}
_NAMES = {
    "omega": "ω",
    "phi": "φ",
    "kappa": "κ",
    "lever_forward": "lever arm forward",
    "lever_right": "lever arm right",
    "lever_down": "lever arm down",
    "time_offset": "time offset",
    "gnss_east": "GNSS offset east",
    "gnss_north": "GNSS offset north",
    "gnss_up": "GNSS offset up",
}


def write_calibration(folder: Path, name: str) -> Path:
    """Writes boresight.csv, residuals.csv, excluded.csv, metrics.csv, figures/ and report.html into a run folder."""
    run = load_calibration(folder, name)
    offsets = time_offset_table(run, _held(run)) if run.results else pd.DataFrame()
    tables = {"boresight": boresight_table(run), "residuals": residual_table(run), "excluded": excluded_table(run)}
    tables["metrics"] = calibration_metrics(run)
    for key, table in tables.items():
        write_atomically(folder / f"{key}.csv", lambda p, t=table: t.to_csv(p, index=False))
    drawn = save_figures(folder / "figures", _figures(run, tables, offsets))
    path = folder / "report.html"
    write_text(path, _page(run, tables, offsets, drawn))
    return path


def _figures(run: CalibrationRun, tables: dict[str, pd.DataFrame], offsets: pd.DataFrame) -> dict[str, Figure]:
    if not run.results:
        return {}
    label, images, headings = _held(run), run.observations.images, headings_deg(run)
    own = tables["residuals"][tables["residuals"]["estimator"] == label]
    bearing = dict(zip(images, headings.tolist(), strict=True))
    found = {
        "angles": figures.angles(tables["boresight"], images, headings, run.reference_source),
        "residuals": figures.residuals(own, bearing, run.observations.camera.size_px),
    }
    if len(offsets):
        found["time_offset"] = figures.time_offset(offsets, label)
    return found


def _held(run: CalibrationRun) -> str:
    """Whose residuals are drawn: of one adjustment rather than image by image, of the boresight alone if there is."""
    return min(run.results, key=lambda label: (_by_image(run, label), len(run.results[label].names)))


def _by_image(run: CalibrationRun, label: str) -> bool:
    return bool(np.isfinite(run.results[label].by_image).any())


def _page(run: CalibrationRun, tables: dict[str, pd.DataFrame], offsets: pd.DataFrame, drawn: dict[str, Path]) -> str:
    o = run.observations
    excluded = tables["excluded"]
    return template("calibration.html.j2").render(
        title=run.scenario["title"],
        source=run.scenario.get("source") or "",
        name=run.name,
        images=len(o.images),
        clicks=len(o.points),
        points=len(np.unique(o.points.point)),
        zone=o.georeference.epsg,
        heading=run.scenario["calibration"]["heading"],
        convergence=display.number(float(np.rad2deg(o.georeference.convergence(o.navigation.T_wb.t).mean()))),
        reference=run.reference_source,
        failed=[(k, e) for k, e in run.estimates.items() if isinstance(e, EstimationFailed)],
        unknowns=_unknown_rows(tables["boresight"]),
        inseparable=[(label, str(group)) for label, r in run.results.items() for group in r.inseparable],
        fits=[_fit(label, tables["metrics"]) for label in run.results],
        by_image=_image_table(run, tables),
        per_image_labels=[label for label in run.results if _by_image(run, label)],
        held=_held(run) if run.results else "",
        labels=list(run.results),
        striking=striking_images(run),
        figures=[(key, CAPTIONS[key], embedded(path)) for key, path in drawn.items()],
        least=least(offsets) if len(offsets) else None,
        excluded=excluded.to_numpy().tolist(),
        counted=list(excluded.assign(n=1).groupby("estimator", sort=False)["n"].sum().items()),
        still=[o.images[i] for i in np.flatnonzero(~o.knows_motion)],
        settings=list(display.settings(run.scenario)),
        provenance=run.provenance,
    )


def _unknown_rows(boresight: pd.DataFrame) -> list[tuple[str, ...]]:
    """Estimator, unknown, value, standard deviation, difference from the reference, unit."""
    rows = []
    for r in boresight[boresight["image"] == ""].to_dict("records"):
        digits = 4 if r["unit"] == "deg" else 3
        cells = [_fixed(r[column], digits) for column in ("value", "sigma", "error")]
        rows.append((str(r["estimator"]), _NAMES[str(r["name"])], *cells, str(r["unit"])))
    return rows


def _fixed(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "−") if np.isfinite(value) else "–"


def _fit(label: str, metrics: pd.DataFrame) -> tuple[str, ...]:
    own = metrics[(metrics["estimator"] == label) & (metrics["entity"] == "")]
    first = own.groupby(["quantity", "statistic"])["value"].first()
    wanted = (
        *(("image", "sum"), ("click", "sum"), ("outlier", "rejected"), ("residual", "rms")),
        *(("residual_adjusted", "rms"), ("sigma_0", "median")),
    )
    values = [float(first.get(key, np.nan)) for key in wanted]
    return (label, *(f"{v:.0f}" for v in values[:3]), *(display.number(v) for v in values[3:]))


def _image_table(run: CalibrationRun, tables: dict[str, pd.DataFrame]) -> list[list[str]]:
    """Image, heading, clicks, angles by the estimators that have them, residual by each."""
    residuals = tables["residuals"]
    headings, rows = headings_deg(run), []
    for i, image in enumerate(run.observations.images):
        row = [image, str(round(headings[i]) % 360), str(np.count_nonzero(run.observations.points.image == i))]
        for r in (r for label, r in run.results.items() if _by_image(run, label)):
            angles, sigma = np.rad2deg(r.by_image[i]), np.rad2deg(r.sigma_by_image[i])
            row += [f"{_fixed(a, 3)} ± {_fixed(s, 3)}" for a, s in zip(angles, sigma, strict=True)]
        own = residuals[(residuals["image"] == image) & ~residuals["rejected"].astype(bool)]
        for label in run.results:
            d = own.loc[own["estimator"] == label, ["du_px", "dv_px"]].to_numpy(float)
            row.append(display.number(float(np.sqrt(np.mean(np.sum(d**2, axis=1))))) if len(d) else "–")
        rows.append(row)
    return rows
