"""Images of a flight as they were taken and as they are known: poses and cameras, without pictures.

Stated for the source's ANTAR: navigation of Table 3.1 at its worse end, and a camera that shakes by 0.08 degrees, which
explains the residuals of its calibration (Kozempel 2012, 3.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float, Int

from sim.angles import Mounting
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.camera_systems import CameraSystem, antar, argos
from sim.flight import Gusts, Shaking, Vibration, fly, true_camera_pose
from sim.flight_path import FlightLine
from sim.geodesy import Georeference
from sim.imu import ChannelErrors, NavigationErrors, navigation_solution, pos_av_410, stamps
from sim.pose import Pose
from sim.streams import stream

Array = np.ndarray
SYSTEMS: dict[str, CameraSystem] = {"antar": antar(), "argos": argos()}
SPEED_MPS = 60.0
ATTITUDE_DEG = (0.008, 0.008, 0.015)
"""Roll, pitch and heading of Table 3.1."""
FOCAL, K1 = 2e-4, 5e-4
"""What is not known of an interior orientation: focal length (relative) and k1; ours.

The principal point's error is none: a calibration of the boresight takes it up.
"""
# A lens that displaces a corner by 1.6 px (ANTAR) and 16 px (ARGOS); ours.
_LENS = np.array([-0.03, 0.01, 1e-4, -1e-4, 0.0])
# Berlin, where convergence and scale are not those of a central meridian.
_REFERENCE = Georeference(32633, (402000.0, 5809000.0, 0.0))


@dataclass(frozen=True)
class Uncertainty:
    """What is not known of a flight's images, one sigma each; 0 or False: it is known."""

    attitude: bool = True
    """Roll, pitch and heading of Table 3.1."""
    position: float = 0.3
    """GNSS [m], each axis."""
    synchronisation: float = 0.001
    """Jitter of the exposures' time stamps [s]."""
    boresight: tuple[float, float, float] = (0.027, 0.027, 0.03)
    """What a calibration leaves of omega, phi, kappa [deg]: 0.08 degrees over nine images."""
    vibration: float = 0.08
    """Of the camera against the body [deg], each axis."""
    interior: bool = True
    """Focal length and distortion."""
    clicks: float = 0.5
    """Of who measures a check point in an ortho image [px], each axis."""

    def only(self, source: str) -> Uncertainty:
        """This one source of error alone; "all" and "none" of them."""
        if source == "all":
            return self
        return KNOWN if source == "none" else replace(KNOWN, **{source: getattr(self, source)})


KNOWN = Uncertainty(False, 0.0, 0.0, (0.0, 0.0, 0.0), 0.0, False, 0.0)
SOURCES = tuple(f.name for f in fields(Uncertainty))


@dataclass(frozen=True, eq=False)
class Overflights:
    """n images: cameras and poses T_wc true and as stated, the pass of each, and how the body moved and was turned.

    velocity, rate (n, 3) in world axes [m/s], [rad/s]; R_wb (n, 3, 3).
    """

    camera: Camera
    stated_camera: Camera
    T_wc: Pose
    stated_T_wc: Pose
    line: Int[Array, "n"]
    velocity: Float[Array, "n 3"]
    rate: Float[Array, "n 3"]
    R_wb: Float[Array, "n 3 3"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def __len__(self) -> int:
        return len(self.line)


def overfly(
    system: str, lines: Sequence[FlightLine], images: int, uncertainty: Uncertainty, seed: int, run: int
) -> Overflights:
    """Images of the system's first head, so many from every line, evenly from its begin to its end."""
    head = SYSTEMS[system].heads[0]
    flight = fly(lines, seed, run, gusts=Gusts())
    begin, end = flight.line_s.T
    t_s = np.linspace(begin, end, images + 2, axis=1)[:, 1:-1].ravel()
    camera = Camera(head.camera.K, head.camera.size_px, _LENS)
    off = np.deg2rad(uncertainty.boresight) * stream(seed, run, f"{system}/boresight").standard_normal(3)
    true = Mounting(head.mounting.boresight + off, head.mounting.lever_b)
    shaking = Shaking.draw(Vibration(np.deg2rad(uncertainty.vibration)), system, seed, run)
    errors = _navigation(uncertainty)
    solution, _ = navigation_solution(flight.trajectory, _REFERENCE, errors, seed, run, within_s=flight.line_s)
    stamped = stamps(t_s, errors, system, seed, run)
    return Overflights(
        camera,
        _stated(camera, stream(seed, run, f"{system}/interior")) if uncertainty.interior else camera,
        true_camera_pose(flight.trajectory, true, shaking, t_s),
        solution.pose(stamped, _REFERENCE) @ head.mounting.T_bc,
        np.repeat(np.arange(len(lines)), images),
        flight.trajectory.velocity(t_s),
        flight.trajectory.angular_rate(t_s),
        flight.trajectory.pose(t_s).R,
    )


def _navigation(uncertainty: Uncertainty) -> NavigationErrors:
    errors = pos_av_410(uncertainty.position)
    attitude = errors.attitude if uncertainty.attitude else ChannelErrors()
    return replace(errors, attitude=attitude, jitter_s=uncertainty.synchronisation)


def _stated(camera: Camera, rng: np.random.Generator) -> Camera:
    K, lens = camera.K.copy(), camera.distortion.copy()
    K[[0, 1], [0, 1]] *= 1 + FOCAL * rng.standard_normal()
    lens[0] += K1 * rng.standard_normal()
    return Camera(K, camera.size_px, lens)
