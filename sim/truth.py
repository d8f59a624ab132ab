"""What only reports may know: true motion, shape, calibration and the label of every observation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from sim import archive
from sim.archive import freeze_fields
from sim.camera import StereoRig
from sim.pose import Pose

_FILE = "truth.npz"
INLIER = 0
# Pictures beside a truth. Depth in KITTI's 16-bit form: 1/256 m, 0 where unknown or beyond 256 m. Instance: 0 sky,
# 1 the static world, 2 and on the vehicles in the order of `Truth.bodies`.
DEPTH_SCALE = 256.0
STATIC_INSTANCE, FIRST_VEHICLE = 1, 2


@dataclass(frozen=True, eq=False)
class Labels:
    """One row per row of `Observations.tracks`, in the same order.

    kind (N,) 0 for an inlier, else 1 + index into ``kinds``; uv_true (N, 4) noise-free pixels of the track's material
    point (u_left, v_left, u_right, v_right), NaN where a tracked point has none; sigma_px (N,) standard deviation per
    coordinate: the injected one, or that of the tracked inliers.
    """

    kind: Int[np.ndarray, "n"]
    uv_true: Float[np.ndarray, "n 4"]
    sigma_px: Float[np.ndarray, "n"]
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True, eq=False)
class Body:
    """A vehicle in the scene: pose over the frames and bounding box in its frame v.

    T_wv (m,) poses; box_v (2, 3) lower and upper corner [m]; outline_v (k, 3) vertices of its surface, for drawing.
    """

    name: str
    T_wv: Pose
    box_v: Float[np.ndarray, "2 3"]
    outline_v: Float[np.ndarray, "k 3"]

    def __post_init__(self) -> None:
        freeze_fields(self)


@dataclass(frozen=True, eq=False)
class Truth:
    """The truth behind one `Observations`.

    t_s (m,); rig true calibration; T_wc (m,) true left camera poses, ego_omega_w (m, 3) its angular rate [rad/s] and
    ego_velocity_w (m, 3) its velocity [m/s]; bodies: all vehicles, ``bodies[target]`` the observed one with
    velocity_w (m, 3) of the reference point [m/s], omega_w (m, 3) [rad/s], reference_v (3,) the reference point (middle
    of the rear axle, system F of Siegemund 2008, 3.8) in the vehicle frame; track (k,) identifiers and point_v (k, 3)
    the material point of every track in the vehicle frame (NaN for tracks that are not on the target); visible_points
    (m,) points measured in each frame, or, for a front end, as many as could be tracked there.
    """

    t_s: Float[np.ndarray, "m"]
    rig: StereoRig
    T_wc: Pose
    ego_velocity_w: Float[np.ndarray, "m 3"]
    ego_omega_w: Float[np.ndarray, "m 3"]
    bodies: tuple[Body, ...]
    target: int
    velocity_w: Float[np.ndarray, "m 3"]
    omega_w: Float[np.ndarray, "m 3"]
    reference_v: Float[np.ndarray, "3"]
    track: Int[np.ndarray, "k"]
    point_v: Float[np.ndarray, "k 3"]
    labels: Labels
    visible_points: Int[np.ndarray, "m"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    @property
    def T_cv(self) -> Pose:
        """Pose of the target in the left camera frame, (m,)."""
        return self.T_wc.inv() @ self.bodies[self.target].T_wv

    def points_c(self, frames: Int[np.ndarray, "f"], tracks: Int[np.ndarray, "p"]) -> Float[np.ndarray, "f p 3"]:
        """True camera coordinates of the material points of the given tracks at the given frames [m]."""
        rows = np.searchsorted(self.track, tracks)
        T = self.T_cv
        return np.asarray(np.einsum("fab,pb->fpa", T.R[frames], self.point_v[rows]) + T.t[frames][:, None])

    def reference_velocity_c(self) -> Float[np.ndarray, "m 3"]:
        """Velocity of the reference point relative to the left camera, in its axes at t [m/s], (m, 3).

        d/dt R_cw (p_w - t_wc) = R_cw (v_w - v_ego - omega_ego x (p_w - t_wc)).
        """
        p_w = self.bodies[self.target].T_wv.apply(self.reference_v)
        relative = self.velocity_w - self.ego_velocity_w - np.cross(self.ego_omega_w, p_w - self.T_wc.t)
        return np.asarray(np.einsum("mba,mb->ma", self.T_wc.R, relative))

    def relative_omega_c(self) -> Float[np.ndarray, "m 3"]:
        """Angular rate of the target relative to the left camera, in its axes [rad/s], (m, 3)."""
        return np.asarray(np.einsum("mba,mb->ma", self.T_wc.R, self.omega_w - self.ego_omega_w))

    def save(self, folder: Path) -> None:
        archive.save(folder / _FILE, self)

    @staticmethod
    def load(folder: Path) -> Truth:
        f = archive.load(folder / _FILE)
        bodies = tuple(Body(b["name"], Pose(**b["T_wv"]), b["box_v"], b["outline_v"]) for b in f.pop("bodies"))
        labels = f.pop("labels")
        labels["kinds"] = tuple(labels["kinds"])
        return Truth(
            rig=StereoRig.from_fields(f.pop("rig")),
            T_wc=Pose(**f.pop("T_wc")),
            bodies=bodies,
            labels=Labels(**labels),
            **f,
        )
