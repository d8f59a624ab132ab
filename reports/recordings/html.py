"""The report of a recording: tables, figures and one self-contained page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from jaxtyping import UInt8
from matplotlib.figure import Figure

from estimators.estimate import EstimationFailed
from estimators.stereo.self_calibration import TERMS
from reports import display
from reports.html import embedded, template
from reports.recordings import figures
from reports.recordings.metrics import epipolar_errors, recording_metrics
from reports.recordings.motion import COMMON, motions
from reports.recordings.run import RecordingRun, load_recording
from reports.run import save_figures
from sim.archive import write_atomically, write_text

Array = np.ndarray
_SHOWN = 6
CAPTIONS = {
    "strip": "Left images with the tracks of that frame; crosses were left out by the outlier detection of the window.",
    "motion": "Every window's newest frame, with three standard deviations as the estimator states them.",
    "epipolar": "How far right points lie from the epipolar line of their left point. Left the distribution; right the "
    "median by place in the image: what is not zero there is an error of the calibration or rectification, since "
    "noise of matching has no sign.",
}


def write_recording(folder: Path, name: str) -> Path:
    """Writes motions.csv, metrics.csv, figures/ and report.html into a recording's run folder."""
    run = load_recording(folder, name)
    table = motions(run) if run.windows else pd.DataFrame(columns=COMMON)
    metrics = recording_metrics(run, table)
    write_atomically(folder / "motions.csv", lambda p: table.to_csv(p, index=False))
    write_atomically(folder / "metrics.csv", lambda p: metrics.to_csv(p, index=False))
    drawn = save_figures(folder / "figures", _figures(run, table))
    path = folder / "report.html"
    write_text(path, _page(run, table, metrics, drawn))
    return path


def _reference(run: RecordingRun) -> str:
    if run.of_vehicle:
        return "block matching in the box"
    return "measured poses" if run.reference.T_wc is not None else ""


def _figures(run: RecordingRun, table: pd.DataFrame) -> dict[str, Figure]:
    tracks = run.observations.tracks
    first = next(iter(run.windows.values()), None)
    found = {"strip": figures.strip(_images(run), tracks, first, run.followed)}
    if len(table):
        found["motion"] = figures.motion(table, run.of_vehicle, _reference(run))
    if len(tracks):
        found["epipolar"] = figures.epipolar(epipolar_errors(run), run.observations.rig.left.size_px)
    return found


def _images(run: RecordingRun) -> dict[int, UInt8[Array, "h w 3"]]:
    """Left images of frames evenly spread over those with tracks, as RGB."""
    seen = np.unique(run.observations.tracks.frame)
    seen = seen if len(seen) else np.arange(len(run.observations.t_s))
    chosen = seen[np.unique(np.linspace(0, len(seen) - 1, _SHOWN).round().astype(int))]
    names, found = run.observations.images, {}
    assert names is not None
    for frame in chosen.tolist():
        image = cv2.imread(str(run.folder / "tracks" / names[frame][0]), cv2.IMREAD_COLOR)
        if image is not None:
            found[frame] = np.asarray(image[:, :, ::-1], np.uint8)
    return found


def _page(run: RecordingRun, table: pd.DataFrame, metrics: pd.DataFrame, drawn: dict[str, Path]) -> str:
    target = "the vehicle in the box" if run.of_vehicle else "the scene, seen from the moving camera"
    return template("recording.html.j2").render(
        title=run.scenario["title"],
        source=run.scenario.get("source") or "",
        name=run.name,
        target=target,
        reference=_reference(run),
        frames=len(run.observations.t_s),
        figures=[(key, CAPTIONS[key], embedded(path)) for key, path in drawn.items()],
        failed=[(k, e) for k, e in run.estimates.items() if isinstance(e, EstimationFailed)],
        failures=[(k, _reasons(e.failures), len(e.windows)) for k, e in run.windows.items()],
        calibration=_calibration(run),
        not_calibrated=run.calibrated.reason,
        metrics=_rows(metrics),
        heads=list(table.columns),
        windows=[[_cell(v) for v in row] for row in table.itertuples(index=False)],
        settings=list(display.settings(run.scenario)),
        provenance=run.provenance,
    )


def _reasons(failures: Any) -> str:
    counted = pd.Series([f.reason for f in failures], dtype=str).value_counts()
    return ", ".join(f"{reason} ({count})" for reason, count in counted.items())


def _calibration(run: RecordingRun) -> list[tuple[str, ...]]:
    """Terms of the rectification's error: disparity with its standard deviation, and rows [px]."""
    error = run.calibrated.error
    if error is None:
        return []
    values = zip(TERMS, error.disparity, error.sigma, error.row, strict=True)
    return [(term, *(display.number(float(v)) for v in row)) for term, *row in values]


def _rows(metrics: pd.DataFrame) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for m in metrics.to_dict("records"):
        known = pd.notna(m["ci_low"]) and m["ci_low"] != ""
        between = f"{display.number(m['ci_low'])} to {display.number(m['ci_high'])}" if known else ""
        unit = "" if m["unit"] == "1" else str(m["unit"])
        name = f"{m['quantity'].replace('_', ' ')}, {m['statistic'].replace('_', ' ')}"
        rows.append((str(m["estimator"]), name, display.number(m["value"]), between, unit, str(m["n"])))
    return rows


def _cell(value: Any) -> str:
    return value if isinstance(value, str) else str(value) if isinstance(value, int) else display.number(value)
