"""Figures of a flight: the mosaic with what flew over it, errors of places and orientation, roads in an ortho image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.patheffects import Normal, Stroke

from estimators.aerial.geotiff import read_geotiff
from estimators.aerial.orthorectification import ORTHOS, OrthoImages
from estimators.aerial.orthorectify import MapGrid, footprint
from estimators.aerial.road_mask import mask_of_ortho
from reports.figures.style import GREY, TRUTH, WIDTH_IN, color, legend, new_figure, styled
from reports.flights.errors import MEASURED, TRUE
from reports.flights.run import FlightRun

Array = np.ndarray
_KM = 1000.0
_CROP_PX = (900, 600)
# White on light ground, and in a legend on white.
_OUTLINED = (Stroke(linewidth=1.6, foreground="black"), Normal())
_ROAD, _CAR = "#FFD400", "#00E5FF"


@styled
def overview(run: FlightRun, picture: UInt8[Array, "h w 4"], orthos: OrthoImages, camera: str) -> Figure:
    """The mosaic of a camera (blue, green, red, alpha), the footprints of its images, and where the camera was."""
    own = [k for k, i in enumerate(orthos.image.tolist()) if run.observations.records[i].head == camera]
    grids = [orthos.map_grid(k) for k in own]
    left, right = min(g.x[0] for g in grids), max(g.x[-1] for g in grids)
    bottom, top = min(g.y[-1] for g in grids), max(g.y[0] for g in grids)
    shape = (top - bottom) / (right - left)
    figure = new_figure(min(WIDTH_IN * shape + 0.75, 8.0))
    ax = figure.subplots()
    rgba = np.concatenate([picture[:, :, 2::-1], picture[:, :, 3:]], axis=2)
    extent = (left / _KM, right / _KM, bottom / _KM, top / _KM)
    ax.imshow(rgba, extent=extent, interpolation="antialiased")
    _footprints(ax, run, orthos, own)
    at = run.truth.T_wc.t[orthos.image[own]] / _KM
    ax.plot(at[:, 0], at[:, 1], "o", color="white", mec="black", ms=4, mew=0.6, label="camera at exposure")
    ax.set(xlabel="x, grid east [km]", ylabel="y, grid north [km]", aspect="equal")
    ax.grid(False)
    legend(figure, [ax])
    return figure


def _footprints(ax: Axes, run: FlightRun, orthos: OrthoImages, own: list[int]) -> None:
    for n, k in enumerate(own):
        camera = run.observations.camera(int(orthos.image[k])).camera
        border = footprint(camera, orthos.T_wc[k], run.observations.terrain)[:, :2] / _KM
        label = "image by its measured orientation" if n == 0 else None
        line = Polygon(border, fill=False, ec="white", lw=0.7, path_effects=_OUTLINED, label=label)
        ax.add_patch(line)


@styled
def ortho_errors(errors: pd.DataFrame, size_px: tuple[int, int]) -> Figure:
    """Mean error by place in the image as vectors; root mean square by image, as measured and by the method alone."""
    figure = new_figure(3.4)
    field, series = figure.subplots(1, 2, width_ratios=(1.25, 1))
    measured = errors[errors["orientation"] == MEASURED]
    mean = measured.groupby(["u", "v"])[["dx", "dy"]].mean().reset_index()
    arrows = field.quiver(
        mean["u"], mean["v"], mean["dx"], -mean["dy"], angles="xy", color=color(0), width=0.005, zorder=3
    )
    rms = float(np.sqrt((measured["dx"] ** 2 + measured["dy"] ** 2).mean()))
    nice = float(f"{rms:.1g}") or 0.1
    field.quiverkey(arrows, 0.85, 1.04, nice, f"{nice:g} m", labelpos="E")
    field.set(xlim=(0, size_px[0]), ylim=(size_px[1], 0), aspect="equal", xlabel="column [px]", ylabel="row [px]")
    field.set_title("mean error, east and north")
    for i, orientation in enumerate((MEASURED, TRUE)):
        part = errors[errors["orientation"] == orientation]
        squared = (part["dx"] ** 2 + part["dy"] ** 2).groupby(part["image"]).mean()
        style = "o-" if i == 0 else "s--"
        series.plot(squared.index, squared.to_numpy() ** 0.5, style, color=color(i), ms=3.5, label=orientation)
    series.set(xlabel="image", ylabel="RMS of check points [m]", yscale="log")
    legend(figure, [series])
    return figure


@styled
def orientation(poses: pd.DataFrame, run: FlightRun) -> Figure:
    """Errors of the navigation solution at every image, with three standard deviations as stated."""
    navigation = run.observations.navigation
    rows = (
        (("roll", "pitch", "heading"), np.rad2deg(navigation.sigma_rph), "attitude error [deg]", 180 / np.pi),
        (("east", "north", "up"), navigation.sigma_position, "position error [m]", 1.0),
    )
    figure = new_figure(4.2)
    axes = figure.subplots(2, 3, sharex=True, sharey="row")
    for line, (names, sigma, title, unit) in zip(axes, rows, strict=True):
        for ax, name, s in zip(line, names, sigma, strict=True):
            ax.axhspan(-3 * s, 3 * s, color=GREY, alpha=0.15, lw=0, label="3 sigma as stated")
            ax.axhline(0, color=TRUTH, lw=0.7)
            ax.plot(poses["t_s"], unit * poses[name], "o", ms=3, color=color(0), label="measured minus true")
            ax.set_title(name)
        line[0].set_ylabel(title)
    for ax in axes[1]:
        ax.set_xlabel("time [s]")
    legend(figure, [axes[0, 0]])
    return figure


@styled
def roads(run: FlightRun, label: str, orthos: OrthoImages) -> Figure:
    """Part of an ortho image, full of vehicles, with the mask of the road map and the vehicles where they are."""
    row, at = _richest(run, orthos)
    record = run.observations.records[int(orthos.image[row])]
    path = run.folder / "estimates" / label / ORTHOS / Path(record.file).with_suffix(".tif").name
    ortho = read_geotiff(path, run.observations.georeference)
    grid, picture = _crop(ortho.grid, ortho.image, at)
    mask = mask_of_ortho(run.road_map, grid).mask
    figure = new_figure(WIDTH_IN * grid.rows / grid.columns + 0.55)
    ax = figure.subplots()
    half = grid.gsd_m / 2
    extent = (grid.x[0] - half, grid.x[-1] + half, grid.y[-1] - half, grid.y[0] + half)
    ax.imshow(picture if picture.shape[2] == 3 else picture[:, :, 0], cmap="gray", extent=extent)
    # An empty mask has no outline.
    if 0 < np.count_nonzero(mask) < mask.size:
        ax.contour(grid.x, grid.y, mask, [127], colors=_ROAD, linewidths=0.8)
    ax.plot([], [], color=_ROAD, lw=0.8, label="roads as the map has them, with their margins")
    _boxes(ax, run, int(orthos.image[row]), extent)
    ax.set(xlabel="x [m]", ylabel="y [m]", xlim=extent[:2], ylim=extent[2:])
    ax.grid(False)
    legend(figure, [ax])
    return figure


def _richest(run: FlightRun, orthos: OrthoImages) -> tuple[int, Array]:
    """The ortho image with most vehicles about one of them, and the place; the first one's middle without any."""
    first = orthos.map_grid(0)
    best = 0, 0, np.array([first.x.mean(), first.y.mean()])
    half = np.array(_CROP_PX) / 2 * (orthos.grid[0, 2])
    for row, image in enumerate(orthos.image.tolist()):
        xy = run.vehicles.loc[run.vehicles["image"] == image, ["x_m", "y_m"]].to_numpy(float)
        grid = orthos.map_grid(row)
        inner = xy[
            (xy[:, 0] > grid.x[0] + half[0]) & (xy[:, 0] < grid.x[-1] - half[0])
            & (xy[:, 1] > grid.y[-1] + half[1]) & (xy[:, 1] < grid.y[0] - half[1])
        ]  # fmt: skip
        for at in inner[::5]:
            count = int((np.abs(xy - at) < half).all(axis=1).sum())
            if count > best[0]:
                best = count, row, at
    return best[1], best[2]


def _crop(grid: MapGrid, image: UInt8[Array, "h w c"], at: Array) -> tuple[MapGrid, UInt8[Array, "h w c"]]:
    columns, rows = min(_CROP_PX[0], grid.columns), min(_CROP_PX[1], grid.rows)
    middle = np.rint(grid.pixels(at)).astype(int)
    column = int(np.clip(middle[0] - columns // 2, 0, grid.columns - columns))
    row = int(np.clip(middle[1] - rows // 2, 0, grid.rows - rows))
    part = MapGrid(grid.x_m + column * grid.gsd_m, grid.y_m - row * grid.gsd_m, grid.gsd_m, columns, rows)
    return part, image[row : row + rows, column : column + columns]


def _boxes(ax: Axes, run: FlightRun, image: int, extent: tuple[float, float, float, float]) -> None:
    """Outlines of the vehicles of an image on the ground."""
    seen = run.vehicles[run.vehicles["image"] == image]
    xy, size = seen[["x_m", "y_m"]].to_numpy(float), seen[["length_m", "width_m"]].to_numpy(float)
    heading = np.deg2rad(seen["heading_deg"].to_numpy(float))
    ahead = np.stack([np.sin(heading), np.cos(heading)], axis=-1) * size[:, :1] / 2
    right = np.stack([np.cos(heading), -np.sin(heading)], axis=-1) * size[:, 1:] / 2
    corners = np.stack([xy + a * ahead + b * right for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))], axis=1)
    inside = (xy[:, 0] > extent[0]) & (xy[:, 0] < extent[1]) & (xy[:, 1] > extent[2]) & (xy[:, 1] < extent[3])
    for k, outline in enumerate(corners[inside]):
        label = "vehicles where they are" if k == 0 else None
        ax.add_patch(Polygon(outline, fill=False, ec=_CAR, lw=0.8, label=label))
