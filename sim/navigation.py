"""What a GNSS/inertial system hands out, and the metadata of each image: all that an estimator knows of the flight."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from jaxtyping import Float

from sim.angles import body_angles, body_rotation
from sim.archive import freeze_fields
from sim.camera_systems import CameraSystem, Exposures
from sim.geodesy import Georeference
from sim.pose import Pose, interpolate

Array = np.ndarray
# Beyond it an aircraft's turning is no longer linear between two records.
_LONGEST_STEP_S = 0.1


@dataclass(frozen=True, eq=False)
class NavigationSolution:
    """A post-processed trajectory (SBET, Kozempel 2012, 3.3) of the IMU's reference point, with *stated* sigmas.

    t_s (n,) the system's clock; geographic (n, 3) longitude [deg], latitude [deg], ellipsoidal height [m]; rph (n, 3)
    roll, pitch, *true* heading [rad]; velocity_ned (n, 3) [m/s]; sigma_position (east, north, up) [m]; sigma_rph [rad];
    sigma_velocity (north, east, down) [m/s].

    Raises
        ValueError: shapes that do not fit, values that are not finite, times that do not increase.
    """

    t_s: Float[Array, "n"]
    geographic: Float[Array, "n 3"]
    rph: Float[Array, "n 3"]
    velocity_ned: Float[Array, "n 3"]
    sigma_position: Float[Array, "3"]
    sigma_rph: Float[Array, "3"]
    sigma_velocity: Float[Array, "3"]

    def __post_init__(self) -> None:
        freeze_fields(self)
        for name in ("geographic", "rph", "velocity_ned"):
            value = getattr(self, name)
            if value.shape != (len(self.t_s), 3):
                raise ValueError(f"NavigationSolution.{name}: expected ({len(self.t_s)}, 3), got {value.shape}")
            if not np.isfinite(value).all():
                row = int(np.argwhere(~np.isfinite(value))[0, 0])
                raise ValueError(f"NavigationSolution.{name}: not finite in record {row} (t = {self.t_s[row]:.3f} s)")
        if not np.all(np.diff(self.t_s) > 0):
            raise ValueError("NavigationSolution.t_s: expected strictly increasing times")

    def __len__(self) -> int:
        return len(self.t_s)

    def pose(self, t_s: Float[Array, "*b"], reference: Georeference) -> Pose:
        """T_wb of the body in the world frame at times of this clock, linear between the two records about each.

        Raises
            ValueError: a time before the first or after the last record, or in a gap between records.
        """
        t = np.asarray(t_s, float)
        if t.size and not (self.t_s[0] <= t.min() and t.max() <= self.t_s[-1]):
            raise ValueError(
                f"NavigationSolution: {t.min():.3f}..{t.max():.3f} s is outside {self.t_s[0]:.3f}..{self.t_s[-1]:.3f} s"
            )
        before = np.clip(np.searchsorted(self.t_s, t, side="right") - 1, 0, len(self.t_s) - 2)
        step = self.t_s[before + 1] - self.t_s[before]
        if np.any(step > _LONGEST_STEP_S):
            where = t[step > _LONGEST_STEP_S][0]
            raise ValueError(f"NavigationSolution: {where:.3f} s lies in a gap of {step.max():.3f} s between records")
        fraction = (t - self.t_s[before]) / step
        return interpolate(self._record(before, reference), self._record(before + 1, reference), fraction)

    def _record(self, index: Array, reference: Georeference) -> Pose:
        p_w = reference.from_crs(self.geographic[index])
        return Pose(body_rotation(self.rph[index], reference.convergence(p_w)), p_w)


@dataclass(frozen=True)
class ImageRecord:
    """What an image file says of itself, as the source's cameras write it into the JPEG: plain values for any writer.

    t_s is the navigation system's stamp, time_utc the same as a date; position, roll, pitch and true heading are the
    navigation solution's for the IMU at the stamp. `dataclasses.asdict` is its JSON, `sim.exif` its EXIF.
    """

    file: str
    system: str
    head: str
    line: int
    burst: int
    t_s: float
    time_utc: str
    width_px: int
    height_px: int
    focal_px: float
    exposure_s: float
    longitude_deg: float
    latitude_deg: float
    height_m: float
    roll_deg: float
    pitch_deg: float
    heading_deg: float


def image_records(
    system: CameraSystem,
    exposed: Exposures,
    stamps_s: Float[Array, "n"],
    solution: NavigationSolution,
    reference: Georeference,
    *,
    start: datetime = datetime(2010, 6, 1, 10, 0, tzinfo=UTC),
    exposure_s: float = 1 / 1000,
) -> tuple[ImageRecord, ...]:
    """One record per exposure, from the navigation solution at its stamp; ``start`` is the date of time 0.

    Raises
        ValueError: a stamp outside the solution's time.
    """
    T_wb = solution.pose(stamps_s, reference)
    geographic = reference.to_crs(T_wb.t)
    rph_deg = np.rad2deg(body_angles(T_wb.R, reference.convergence(T_wb.t)))
    records = []
    for i, stamp in enumerate(stamps_s.tolist()):
        head = system.heads[exposed.head[i]]
        lon, lat, height = geographic[i].tolist()
        roll, pitch, heading = rph_deg[i].tolist()
        records.append(
            ImageRecord(
                file=f"{head.name}-{i:05d}",
                system=system.name,
                head=head.name,
                line=int(exposed.line[i]),
                burst=int(exposed.burst[i]),
                t_s=stamp,
                time_utc=(start + timedelta(seconds=stamp)).isoformat(timespec="microseconds"),
                width_px=head.camera.size_px[0],
                height_px=head.camera.size_px[1],
                focal_px=float(head.camera.K[1, 1]),
                exposure_s=exposure_s,
                longitude_deg=lon,
                latitude_deg=lat,
                height_m=height,
                roll_deg=roll,
                pitch_deg=pitch,
                heading_deg=heading % 360,
            )
        )
    return tuple(records)
