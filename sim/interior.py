"""Photogrammetric interior orientation (Kozempel 2012, 3.2) <-> `sim.camera.Camera`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from sim.camera import Camera

Array = np.ndarray
_ITERATIONS = 50


@dataclass(frozen=True)
class InteriorOrientation:
    """Brown's model as a calibration states it: x right, y up from the principal point, in one unit of length.

    The unit is that of ``pitch``: mm, or pixels with a pitch of 1. Unlike `Camera`, whose polynomial distorts ideal
    coordinates, this one corrects *measured* ones: ``x = x̄ + Δx(x̄, ȳ)``, (3.4)-(3.10). The other direction is iterated.

    principal_distance c; principal_point (x0, y0) seen from the centre of the sensor; pitch (d_x, d_y) of a sensor
    element; radial (K1, K2, K3), decentring (P1, P2), affinity B1 and shear B2.

    Two signs of the source do not fit its own frames and are taken as they must be: (3.2)-(3.3) lack the minus that a
    z axis against the view needs, and (3.12) adds an upward ȳ to a row that counts downward. Its pixels count from 1.
    """

    principal_distance: float
    pitch: tuple[float, float]
    size_px: tuple[int, int]
    principal_point: tuple[float, float] = (0.0, 0.0)
    radial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    decentring: tuple[float, float] = (0.0, 0.0)
    affinity: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("pitch", "principal_point", "radial", "decentring", "affinity"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"InteriorOrientation.{name}: expected finite numbers, got {getattr(self, name)}")
        if not (self.principal_distance > 0 and min(self.pitch) > 0):
            raise ValueError(
                "InteriorOrientation: expected a positive principal distance and pitch, "
                f"got {self.principal_distance} and {self.pitch}"
            )
        if not abs(self.affinity[0]) < 1:
            raise ValueError(f"InteriorOrientation.affinity: expected |B1| < 1, got {self.affinity[0]}")

    def correction(self, xy_measured: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Δ(x, y) of (3.4)-(3.10) at measured image coordinates."""
        d = np.asarray(xy_measured, float)
        x, y = d[..., 0], d[..., 1]
        (K1, K2, K3), (P1, P2), (B1, B2) = self.radial, self.decentring, self.affinity
        r2 = x * x + y * y
        radial = r2 * (K1 + r2 * (K2 + r2 * K3))
        dx = x * radial + (r2 + 2 * x * x) * P1 + 2 * x * y * P2 + x * B1 + y * B2
        dy = y * radial + 2 * x * y * P1 + (r2 + 2 * y * y) * P2
        return np.stack([dx, dy], axis=-1)

    def ideal(self, xy_measured: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Image coordinates of a perfect central projection: measured ones corrected, (3.4)."""
        return np.asarray(xy_measured + self.correction(xy_measured))

    def measured(self, xy_ideal: Float[Array, "*b 2"], iterations: int = _ITERATIONS) -> Float[Array, "*b 2"]:
        """Inverse of `ideal` by fixed-point iteration from the ideal coordinates; the source finds two enough."""
        xy = np.asarray(xy_ideal, float)
        for _ in range(iterations):
            xy = xy_ideal - self.correction(xy)
        return xy

    def to_pixels(self, xy_measured: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """(3.11)-(3.12), with rows downward and (0, 0) the centre of the first pixel."""
        xy = (np.asarray(xy_measured, float) + self.principal_point) / self.pitch
        return np.asarray(xy * [1.0, -1.0] + (np.array(self.size_px) - 1) / 2)

    def from_pixels(self, uv: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Measured image coordinates of pixels: inverse of `to_pixels`."""
        uv = (np.asarray(uv, float) - (np.array(self.size_px) - 1) / 2) * [1.0, -1.0]
        return np.asarray(uv * self.pitch - self.principal_point)

    def normalise(self, uv: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Pixels to (x/z, y/z) in our camera frame, (3.1) backward; what `Camera.normalise` does for its model."""
        return np.asarray(self.ideal(self.from_pixels(uv)) * [1.0, -1.0] / self.principal_distance)

    def camera(self) -> Camera:
        """The nearest `Camera`: B1 and B2 as K's f_x and skew, the polynomial fitted to the inverse over the image.

        Exact without radial and decentring terms, else to about a thousandth of the distortion (`misfit_px`).
        """
        (dx, dy), (B1, B2), c = self.pitch, self.affinity, self.principal_distance
        cx, cy = self.to_pixels(np.zeros(2))
        f = c / ((1 + B1) * dx)
        K = np.array([[f, B2 * f, cx], [0, c / dy, cy], [0, 0, 1.0]])
        uv = _grid(self.size_px)
        xy = self.normalise(uv)
        columns = [Camera(K, self.size_px, unit).distort(xy) - xy for unit in np.eye(5)]
        return Camera(K, self.size_px, _fit(columns, Camera(K, self.size_px).normalise(uv) - xy))

    @staticmethod
    def of_camera(camera: Camera, pitch: tuple[float, float] = (1.0, 1.0)) -> InteriorOrientation:
        """The nearest photogrammetric model: inverse of `InteriorOrientation.camera`, fitted likewise.

        Raises
            ValueError: pixels of the image without a ray (the lens model folds inside the image).
        """
        K, (w, h) = camera.K, camera.size_px
        c = float(K[1, 1] * pitch[1])
        point = (float(K[0, 2] - (w - 1) / 2) * pitch[0], float((h - 1) / 2 - K[1, 2]) * pitch[1])
        affinity = (c / float(K[0, 0] * pitch[0]) - 1, float(K[0, 1] / K[0, 0]))
        bare = InteriorOrientation(c, pitch, camera.size_px, point, affinity=affinity)
        uv = _grid(camera.size_px)
        ideal = camera.normalise(uv)
        if not np.isfinite(ideal).all():
            raise ValueError(f"camera.distortion: {camera.distortion.tolist()} folds the image before its corners")
        units = [replace(bare, radial=tuple(e[:3]), decentring=tuple(e[3:]), affinity=(0.0, 0.0)) for e in np.eye(5)]
        columns = [unit.correction(bare.from_pixels(uv) / c) for unit in units]
        k = _fit(columns, (ideal - bare.normalise(uv)) * [1.0, -1.0])
        K1, K2, K3, P1, P2 = (k / c ** np.array([2, 4, 6, 1, 1])).tolist()
        return replace(bare, radial=(K1, K2, K3), decentring=(P1, P2))

    def misfit_px(self, camera: Camera) -> float:
        """Greatest distance [px] over the image between a pixel and the camera's image of this model's ray there."""
        uv = _grid(self.size_px)
        xy = self.normalise(uv)
        rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=-1)
        return float(np.linalg.norm(camera.project(rays) - uv, axis=-1).max())


def _grid(size_px: tuple[int, int]) -> Array:
    """41 x 41 pixels from edge to edge of the image."""
    u, v = (np.linspace(-0.5, n - 0.5, 41) for n in size_px)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _fit(columns: list[Array], target: Array) -> Array:
    """Least-squares coefficients of a polynomial that is linear in them, from what each adds on the grid."""
    A = np.stack([column.ravel() for column in columns], axis=-1)
    return np.asarray(np.linalg.lstsq(A, target.ravel())[0])
