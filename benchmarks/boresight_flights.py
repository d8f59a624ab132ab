"""Calibration flights with known truth: exposures over control points, navigation with errors, clicks with noise.

No images are rendered: this is the geometry of Kozempel 2012, 3.3, drawn anew for every run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.aerial.boresight import ControlPoints
from estimators.aerial.boresight_model import Common, Navigation
from estimators.aerial.resection import ImagePoints
from sim.angles import Mounting, body_rotation
from sim.camera import Camera
from sim.pose import Pose, exp_so3

Array = np.ndarray
# 0.20 m on the ground from 500 m: 2500 px (Kozempel 2012, 3.3: 5-6 px are 1.0-1.2 m; 0.30 m are 1.5 px).
ANTAR = Camera.simple((1024, 1024), 2500.0)
MOUNTING = Mounting(np.deg2rad([0.8, -1.1, 1.7]), np.array([0.12, -0.05, 0.08]))


@dataclass(frozen=True)
class Conditions:
    """A flight: for each of ``lines`` (heading [deg], height [m]) ``images`` exposures over ``gcps`` control points.

    sigma_* are injected and stated alike, but vibration_deg (per image and axis), which is only stated where
    ``vibration_stated``; ``is_exact`` states them and injects none. rate_dps is that of each axis,
    constant_share that of the variance of navigation that all images have in common. The clean
    conditions: post-processed navigation of Table 3.1 at its best.
    """

    lines: tuple[tuple[float, float], ...] = ((0.0, 500.0), (90.0, 500.0), (180.0, 500.0), (270.0, 500.0))
    images: int = 9
    gcps: int = 8
    sigma_rph_deg: tuple[float, float, float] = (0.008, 0.008, 0.015)
    sigma_gnss_m: float = 0.05
    sigma_px: float = 0.5
    sigma_gcp_m: float = 0.02
    vibration_deg: float = 0.0
    vibration_stated: bool = True
    speed_mps: float = 60.0
    relief_m: float = 10.0
    time_offset_s: float = 0.0
    gnss_offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rate_dps: float = 0.2
    constant_share: float = 0.0
    is_exact: bool = False


@dataclass(frozen=True, eq=False)
class Flight:
    """What an estimator gets (points, control, navigation, nominal) and what it should find (truth, T_wc, X_w)."""

    points: ImagePoints
    control: ControlPoints
    navigation: Navigation
    nominal: Mounting
    truth: Common
    T_wc: Pose
    X_w: Array


def fly(conditions: Conditions, rng: np.random.Generator, camera: Camera = ANTAR) -> Flight:
    """One run: exposures in turn over the lines, each with its own control points around the middle of all."""
    c = conditions
    heading, height = np.array([c.lines[i % len(c.lines)] for i in range(c.images)]).T
    truth = Common(MOUNTING, c.time_offset_s, np.array(c.gnss_offset_m))
    rph = np.column_stack([*np.deg2rad(rng.normal(0, 1.5, (2, c.images))), np.deg2rad(heading + rng.normal(0, 2))])
    velocity = c.speed_mps * np.column_stack([np.sin(rph[:, 2]), np.cos(rph[:, 2]), np.zeros(c.images)])
    rate = np.deg2rad(rng.normal(0, c.rate_dps, (c.images, 3)))
    noise = 0.0 if c.is_exact else 1.0
    position = np.column_stack([rng.normal(0, 10, (c.images, 2)), height + rng.normal(0, 3, c.images)])
    T_wb = Pose(body_rotation(rph, 0.0), position)
    T_wc = T_wb @ MOUNTING.T_bc
    X = _control(c, rng, camera, height.min())
    points = _clicks(c, rng, camera, T_wc, X, noise)
    vibration = np.deg2rad(c.vibration_deg) if c.vibration_stated else 0.0
    sigma_rph = np.hypot(np.deg2rad(c.sigma_rph_deg), vibration)
    sigma_true = np.hypot(np.deg2rad(c.sigma_rph_deg), np.deg2rad(c.vibration_deg))
    own, shared = noise * np.sqrt(1 - c.constant_share), noise * np.sqrt(c.constant_share)
    attitude = own * rng.normal(0, 1, (c.images, 3)) * sigma_true
    t = position - velocity * c.time_offset_s + truth.gnss_offset_w + own * rng.normal(0, c.sigma_gnss_m, (c.images, 3))
    if shared:
        attitude += shared * rng.normal(0, 1, 3) * sigma_true
        t += shared * rng.normal(0, c.sigma_gnss_m, 3)
    R = T_wb.R @ exp_so3(attitude) @ exp_so3(-rate * c.time_offset_s)
    sigmas = sigma_rph, np.full(3, c.sigma_gnss_m)
    navigation = Navigation(10.0 * np.arange(c.images), Pose(R, t), velocity, rate, *sigmas, c.constant_share)
    control = ControlPoints(X + rng.normal(0, noise * c.sigma_gcp_m, X.shape), c.sigma_gcp_m)
    nominal = Mounting(MOUNTING.boresight + np.deg2rad([0.5, 0.5, -0.8]), MOUNTING.lever_b)
    return Flight(points, control, navigation, nominal, truth, T_wc, X)


def _control(c: Conditions, rng: np.random.Generator, camera: Camera, height: float) -> Array:
    """Points spread over the middle of the ground that the lowest image sees."""
    half = 0.38 * height * camera.size_px[0] / camera.K[0, 0]
    n = max(60, 4 * c.gcps)
    return np.column_stack([rng.uniform(-half, half, (n, 2)), rng.uniform(0, c.relief_m, n)])


def _clicks(c: Conditions, rng: np.random.Generator, camera: Camera, T_wc: Pose, X: Array, noise: float) -> ImagePoints:
    """The first ``gcps`` points that every image sees, in an order of its own."""
    T_cw = T_wc.inv()
    uv = camera.project(np.einsum("mij,nj->mni", T_cw.R, X) + T_cw.t[:, None])
    chosen = [rng.permutation(np.flatnonzero(camera.contains(uv[i], 5.0)))[: c.gcps] for i in range(len(T_wc))]
    image = np.repeat(np.arange(len(T_wc)), [len(points) for points in chosen])
    index = (image, np.concatenate(chosen))
    return ImagePoints(*index, uv[index] + rng.normal(0, noise * c.sigma_px, (len(image), 2)), c.sigma_px)


# The source gives the camera alone: 36 mm x 24 mm on 4992 x 3328 pixels, 50 mm (Kozempel 2012, 2.2).
ARGOS = Camera.simple((4992, 3328), 6933.0)


@dataclass(frozen=True)
class TieConditions:
    """Overlapping exposures at 1400 m: each (heading [deg], metres ahead along its heading from the middle).

    ``points`` ground points that all images see; a share ``outliers`` of them is matched wrongly in one image, by up to
    outlier_px. Navigation as of a good post-processed system (Table 3.1 is ANTAR's). The nominal boresight is
    ``start_off_deg`` off in every angle.
    """

    exposures: tuple[tuple[float, float], ...] = ((0.0, -220.0), (0.0, 220.0), (180.0, 0.0))
    height_m: float = 1400.0
    points: int = 200
    outliers: float = 0.1
    outlier_px: float = 100.0
    sigma_px: float = 0.3
    sigma_rph_deg: tuple[float, float, float] = (0.004, 0.004, 0.010)
    sigma_gnss_m: float = 0.1
    relief_m: float = 40.0
    start_off_deg: float = 1.0


@dataclass(frozen=True, eq=False)
class TieFlight:
    """What an estimator gets (points, navigation, nominal) and what it should find (truth, X_w; wrong tie points)."""

    points: ImagePoints
    navigation: Navigation
    nominal: Mounting
    truth: Common
    X_w: Array
    wrong: Array


def fly_ties(conditions: TieConditions, rng: np.random.Generator, camera: Camera = ARGOS) -> TieFlight:
    """One run of overlapping exposures with tie points in all of them."""
    c, m = conditions, len(conditions.exposures)
    heading, ahead = np.array(c.exposures).T
    rph = np.column_stack([*np.deg2rad(rng.normal(0, 1.5, (2, m))), np.deg2rad(heading + rng.normal(0, 2))])
    direction = np.column_stack([np.sin(rph[:, 2]), np.cos(rph[:, 2]), np.zeros(m)])
    position = ahead[:, None] * direction + [0, 0, c.height_m] + rng.normal(0, 10, (m, 3))
    T_wb = Pose(body_rotation(rph, 0.0), position)
    T_cw = (T_wb @ MOUNTING.T_bc).inv()
    X = np.column_stack([rng.uniform(-700, 700, (20000, 2)), rng.uniform(0, c.relief_m, 20000)])
    uv = camera.project(np.einsum("mij,nj->mni", T_cw.R, X) + T_cw.t[:, None])
    seen = np.flatnonzero(camera.contains(uv, 10.0).all(axis=0))[: c.points]
    X, uv = X[seen], uv[:, seen] + rng.normal(0, c.sigma_px, (m, len(seen), 2))
    wrong = rng.permutation(len(seen))[: int(c.outliers * len(seen))]
    uv[rng.integers(0, m, len(wrong)), wrong] += rng.uniform(-c.outlier_px, c.outlier_px, (len(wrong), 2))
    image, point = (a.ravel() for a in np.indices((m, len(seen))))
    sigma_rph = np.deg2rad(c.sigma_rph_deg)
    T_nav = Pose(
        T_wb.R @ exp_so3(rng.normal(0, 1, (m, 3)) * sigma_rph), position + rng.normal(0, c.sigma_gnss_m, (m, 3))
    )
    navigation = Navigation(
        10.0 * np.arange(m), T_nav, 80 * direction, np.zeros((m, 3)), sigma_rph, np.full(3, c.sigma_gnss_m)
    )
    off = np.deg2rad(c.start_off_deg) * rng.choice([-1.0, 1.0], 3)
    nominal = Mounting(MOUNTING.boresight + off, MOUNTING.lever_b)
    return TieFlight(
        ImagePoints(image, point, uv.reshape(-1, 2), c.sigma_px), navigation, nominal, Common(MOUNTING), X, wrong
    )
