"""Clicks and images of a calibration in one world frame: its zone from the data, headings turned by the convergence."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimators.aerial import gcp_file
from estimators.aerial.boresight import ControlPoints
from estimators.aerial.boresight_model import Navigation
from estimators.aerial.boresight_observations import BoresightObservations
from estimators.aerial.resection import ImagePoints
from scenarios.calibration_images import KEY, ImageList, read_images
from sim.angles import body_rotation, rotation_map_from_navigation
from sim.geodesy import Georeference, ellipsoidal_height
from sim.pose import Pose, log_so3
from sim.scenario import ScenarioError

Array = np.ndarray
# Images this near in time tell each other's velocity and rate.
_NEAR_S = 0.5
# No aerial image sees ground further away.
_FAR_M = 50e3


def read_observations(spec: Any) -> BoresightObservations:
    """What the files of a calibration say.

    Raises
        ScenarioError: a file is wrong, or the files do not fit each other.
    """
    files, camera, stated = spec.calibration, spec.camera.build(), spec.stated
    images = read_images(files.images, files.head, spec.camera.size_px)
    georeference = Georeference.around(images.geographic[:, :2])
    try:
        p_w = georeference.from_crs(images.geographic)
    except ValueError as error:
        raise ScenarioError(f"{KEY}: {files.images}: {error}") from error
    gcp_list = _read_clicks(files.gcp_list)
    try:
        clicks = gcp_file.in_world(gcp_list, images.file, camera, georeference, stated.sigma_px)
    except ValueError as error:
        said = f"{error}; its projection is {gcp_list.crs[:60]!r}"
        raise ScenarioError(f"calibration.gcp_list: {files.gcp_list}: {said}") from error
    if not len(clicks.points):
        raise ScenarioError(
            f"calibration.gcp_list: {files.gcp_list}: none of its {len(gcp_list)} clicks can be used, the first: "
            f"{clicks.excluded[0]}"
        )
    X_w = clicks.X_w.copy()
    X_w[:, 2] = ellipsoidal_height(X_w[:, 2], files.undulation_m)
    _check_near(spec, p_w, X_w, clicks.names, gcp_list.crs)
    navigation, knows_motion = _navigation(images, p_w, georeference, spec)
    seen, image = np.unique(clicks.points.image, return_inverse=True)
    unseen = [name for i, name in enumerate(images.file) if i not in seen]
    return BoresightObservations(
        georeference,
        camera,
        tuple(images.file[i] for i in seen),
        clicks.names,
        ImagePoints(image, clicks.points.point, clicks.points.uv, stated.sigma_px),
        ControlPoints(X_w, stated.sigma_gcp_m),
        _of(navigation, seen),
        knows_motion[seen],
        spec.mounting.build(),
        (*clicks.excluded, *(f"{name}: no clicks in it" for name in unseen)),
    )


def _read_clicks(path: Any) -> gcp_file.GcpList:
    try:
        return gcp_file.read(path)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ScenarioError(f"calibration.gcp_list: cannot read {path}: {reason}") from error
    except gcp_file.GcpFileError as error:
        raise ScenarioError(f"calibration.gcp_list: {error}") from error


def _check_near(spec: Any, p_w: Array, X_w: Array, names: tuple[str, ...], crs: str) -> None:
    """Points under the images: those of another system are hundreds of kilometres away, or above the aircraft."""
    middle = np.median(p_w, axis=0)
    away = np.linalg.norm((X_w - middle)[:, :2], axis=1)
    k, path = int(np.argmax(away)), spec.calibration.gcp_list
    if away[k] > _FAR_M:
        raise ScenarioError(
            f"calibration.gcp_list: {path}: {names[k]} lies {away[k] / 1e3:.0f} km from the images of "
            f"{spec.calibration.images}; is its projection {crs[:60]!r}?"
        )
    k = int(np.argmax(X_w[:, 2]))
    if X_w[k, 2] > p_w[:, 2].max():
        raise ScenarioError(
            f"calibration.gcp_list: {path}: {names[k]} at {X_w[k, 2]:.1f} m lies above all images, the highest at "
            f"{p_w[:, 2].max():.1f} m"
        )


def _navigation(images: ImageList, p_w: Array, georeference: Georeference, spec: Any) -> tuple[Navigation, Array]:
    """One record per image, and which of them know their velocity and rate."""
    true = spec.calibration.heading == "true"
    convergence = georeference.convergence(p_w) if true else np.zeros(len(p_w))
    T_wb = Pose(body_rotation(images.rph, convergence), p_w)
    if images.velocity_ned is None or images.rate_b is None:
        velocity_w, rate_b, known = _by_differences(images.t_s, T_wb)
    else:
        velocity_w = (rotation_map_from_navigation(convergence) @ images.velocity_ned[..., None])[..., 0]
        rate_b, known = images.rate_b, np.ones(len(p_w), bool)
    stated = spec.stated
    sigmas = np.deg2rad(stated.sigma_attitude_deg), np.array(stated.sigma_position_m)
    try:
        return Navigation(images.t_s, T_wb, velocity_w, rate_b, *sigmas, stated.constant_share), known
    except ValueError as error:
        raise ScenarioError(f"{KEY}: {spec.calibration.images}: {error}") from error


def _by_differences(t_s: Array, T_wb: Pose) -> tuple[Array, Array, Array]:
    """Velocity in w and rate in b from the neighbours that are near in time, zero and unknown where none is."""
    i = np.arange(len(t_s))
    near = np.diff(t_s) <= _NEAR_S
    a, b = i - np.append(False, near), i + np.append(near, False)
    dt = (t_s[b] - t_s[a])[:, None]
    known = b > a
    dt[~known] = 1.0
    return (T_wb.t[b] - T_wb.t[a]) / dt, log_so3(np.swapaxes(T_wb.R[a], 1, 2) @ T_wb.R[b]) / dt, known


def _of(navigation: Navigation, rows: Array) -> Navigation:
    n = navigation
    motion = n.velocity_w[rows], n.rate_b[rows]
    return Navigation(n.t_s[rows], n.T_wb[rows], *motion, n.sigma_rph, n.sigma_position_m, n.constant_share)
