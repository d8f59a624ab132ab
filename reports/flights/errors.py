"""Errors of a flight against its truth: places in ortho images, orientation, what the road map covers."""

from __future__ import annotations

import numpy as np
import pandas as pd
import shapely
from jaxtyping import Float

from estimators.aerial.orthorectification import OrthoImages
from estimators.aerial.orthorectify import ground_points, placed
from reports.flights.run import FlightRun
from sim.angles import body_angles, omega_phi_kappa
from sim.roads import RoadNetwork

Array = np.ndarray
MEASURED, TRUE = "measured orientation", "true orientation"
# Check points across and down an image, and how far from its border.
CHECK_POINTS, _MARGIN = (9, 7), 0.03
_DRIVING_MPS = 0.5


def check_pixels(size_px: tuple[int, int]) -> Float[Array, "n 2"]:
    """Where in an image the check points are."""
    axes = (np.linspace(_MARGIN, 1 - _MARGIN, n) * (size - 1) for n, size in zip(CHECK_POINTS, size_px, strict=True))
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def ortho_errors(run: FlightRun, orthos: OrthoImages) -> pd.DataFrame:
    """Where ground points lie in the ortho images against where they are.

    Columns image, t_s, head, orientation (as measured, or with everything known as it is: what the method itself does
    wrong), u, v [px] in the image, x, y true place and dx, dy error [m], gsd_m. Points of the ground, whatever stands
    on it.
    """
    rows = []
    for row, image in enumerate(orthos.image.tolist()):
        true, known = run.true_camera(image), run.observations.camera(image)
        T_wc, grid = run.truth.T_wc[image], orthos.map_grid(row)
        uv = check_pixels(true.camera.size_px)
        ground = ground_points(true.camera, T_wc, run.truth.terrain, uv)[:, :2]
        for orientation, found in (
            (MEASURED, placed(known.camera, orthos.T_wc[row], run.observations.terrain, uv, orthos.method, grid)),
            (TRUE, placed(true.camera, T_wc, run.truth.terrain, uv, orthos.method, grid)),
        ):
            d = found - ground
            columns = {"u": uv[:, 0], "v": uv[:, 1], "x": ground[:, 0], "y": ground[:, 1], "dx": d[:, 0], "dy": d[:, 1]}
            whose = {"image": image, "t_s": float(run.truth.t_s[image]), "head": known.name}
            rows.append(pd.DataFrame(whose | {"orientation": orientation, "gsd_m": grid.gsd_m} | columns))
    return pd.concat(rows, ignore_index=True).dropna(ignore_index=True)


def pose_errors(run: FlightRun) -> pd.DataFrame:
    """Measured minus true orientation of every image.

    Columns image, t_s, head; roll, pitch, heading [rad] and east, north, up [m] of the navigation solution, those of a
    wrong time of exposure included; omega, phi, kappa [rad] of the camera, boresight and vibration included.
    """
    observations, truth = run.observations, run.truth
    stamps = np.array([r.t_s for r in observations.records])
    T_wb, T_wc = observations.navigation.pose(stamps, observations.georeference), observations.T_wc
    convergence = observations.georeference.convergence(truth.T_wb.t)
    rph = _wrapped(body_angles(T_wb.R, convergence) - body_angles(truth.T_wb.R, convergence))
    opk = _wrapped(omega_phi_kappa(T_wc.R) - omega_phi_kappa(truth.T_wc.R))
    position = T_wb.t - truth.T_wb.t
    names = ("roll", "pitch", "heading", "east", "north", "up", "omega", "phi", "kappa")
    values = np.concatenate([rph, position, opk], axis=1)
    whose = {
        "image": np.arange(len(observations)),
        "t_s": truth.t_s,
        "head": [r.head for r in observations.records],
    }
    return pd.DataFrame(whose | dict(zip(names, values.T, strict=True)))


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def covered_vehicles(run: FlightRun, orthos: OrthoImages) -> pd.DataFrame:
    """Whether the roads of a map cover the driving vehicles that an image shows, half of them at least.

    Columns image, vehicle; known: by the road map the estimators have, at the vehicle's place in the ortho image;
    true: by the roads as they are, at its true place.
    """
    seen = run.vehicles[(run.vehicles["speed_mps"] > _DRIVING_MPS) & (run.vehicles["hidden"] < 0.5)]
    seen = seen[seen["image"].isin(orthos.image)]
    placed_xy = np.full((len(seen), 2), np.nan)
    for row, image in enumerate(orthos.image.tolist()):
        own = (seen["image"] == image).to_numpy()
        if own.any():
            camera = run.observations.camera(image).camera
            uv = seen.loc[own, ["u_px", "v_px"]].to_numpy(float)
            placed_xy[own] = ground_points(camera, orthos.T_wc[row], run.observations.terrain, uv)[:, :2]
    return pd.DataFrame(
        {
            "image": seen["image"].to_numpy(),
            "vehicle": seen["vehicle"].to_numpy(),
            "known": _on_roads(run.road_map, placed_xy),
            "true": _on_roads(run.roads, seen[["x_m", "y_m"]].to_numpy(float)),
        }
    )


def _on_roads(network: RoadNetwork, xy: Float[Array, "n 2"]) -> Array:
    """Whether points lie on roads of the width that a mask has."""
    areas = [shapely.LineString(e.line_m).buffer(e.map_width_m / 2) for e in network.edges]
    hit = shapely.STRtree(areas).query(shapely.points(xy), predicate="intersects")[0]
    return np.isin(np.arange(len(xy)), hit)
