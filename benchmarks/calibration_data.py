"""The simulated calibration flight that ships with the project: files of clicked control points and of images.

    python -m benchmarks.calibration_data [--out FOLDER]      default: scenarios/data

Twelve exposures over a crossing near Munich, in turn from four directions at 500 m, eight clicks each. The conditions
are those under which the source's residuals come out (`benchmarks.boresight`): vibration of 0.08 degrees, positions to
0.3 m. Three clicks are wrong, one lies outside its image. The truth is `benchmarks.boresight_flights.MOUNTING`.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.boresight_flights import Conditions, Flight, fly
from estimators.aerial import gcp_file
from sim.angles import body_angles, rotation_map_from_navigation
from sim.geodesy import Georeference
from sim.streams import stream

Array = np.ndarray
CONDITIONS = Conditions(images=12, vibration_deg=0.08, sigma_gnss_m=0.3)
GEOREFERENCE = Georeference(32632, (691_600.0, 5_336_200.0, 560.0))
CLICKS, IMAGES = "boresight-gcps.txt", "boresight-images.csv"
# Clicks on the wrong object: which, and how far off [px].
_WRONG = {(1, 3): (31.0, -12.0), (6, 0): (-9.0, 22.0), (10, 5): (48.0, 40.0)}
_OUTSIDE = (4, 7)
COLUMNS = (
    *("file", "t_s", "longitude_deg", "latitude_deg", "height_m", "roll_deg", "pitch_deg", "heading_deg"),
    *("velocity_north_mps", "velocity_east_mps", "velocity_down_mps"),
    *("rate_forward_dps", "rate_right_dps", "rate_down_dps"),
)


def image_names(flight: Flight) -> list[str]:
    return [f"antar_{i + 1:02d}.jpg" for i in range(len(flight.navigation))]


def with_mistakes(flight: Flight) -> Flight:
    """The same with clicks on wrong objects, and one outside its image."""
    p, uv = flight.points, flight.points.uv.copy()
    first = np.searchsorted(p.image, np.arange(len(flight.navigation)))
    for (image, click), off in _WRONG.items():
        uv[first[image] + click] += off
    uv[first[_OUTSIDE[0]] + _OUTSIDE[1], 0] += 1024.0
    return replace(flight, points=replace(p, uv=uv))


def clicks(flight: Flight) -> gcp_file.GcpList:
    """What was clicked, with the surveyed coordinates of the points."""
    p, files = flight.points, image_names(flight)
    grid = GEOREFERENCE.to_grid(flight.control.X_w)[p.point]
    shown = {point: f"P{k + 1:02d}" for k, point in enumerate(np.unique(p.point).tolist())}
    return gcp_file.GcpList(
        f"EPSG:{GEOREFERENCE.epsg}",
        grid,
        p.uv,
        tuple(files[i] for i in p.image.tolist()),
        tuple(shown[point] for point in p.point.tolist()),
    )


def image_rows(flight: Flight) -> list[list[str]]:
    """Navigation of the exposures as a post-processing writes it: geographic, true headings."""
    n = flight.navigation
    convergence = GEOREFERENCE.convergence(n.T_wb.t)
    geographic = GEOREFERENCE.to_crs(n.T_wb.t)
    rph = np.rad2deg(body_angles(n.T_wb.R, convergence))
    rph[:, 2] %= 360
    R_nw = np.swapaxes(rotation_map_from_navigation(convergence), 1, 2)
    velocity = (R_nw @ n.velocity_w[..., None])[..., 0]
    values = (n.t_s[:, None], geographic, rph, velocity, np.rad2deg(n.rate_b))
    digits = [3, 9, 9, 3, *[4] * 3, *[3] * 3, *[3] * 3]
    rows = np.hstack(values).tolist()
    return [
        [name, *(f"{v:.{d}f}" for v, d in zip(row, digits, strict=True))]
        for name, row in zip(image_names(flight), rows, strict=True)
    ]


def write(flight: Flight, folder: Path) -> None:
    """Both files of a flight."""
    gcp_file.write(folder / CLICKS, clicks(flight))
    with (folder / IMAGES).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(image_rows(flight))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "scenarios" / "data")
    write(with_mistakes(fly(CONDITIONS, stream(1, 0, "calibration/example"))), parser.parse_args().out)


if __name__ == "__main__":
    main()
