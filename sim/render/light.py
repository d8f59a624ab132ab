"""Sun, sky and haze of a scene, and the sky as a picture that is both seen behind the scene and mirrored in it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from sim.archive import freeze_fields
from sim.streams import stream
from sim.textures import noise

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Light:
    """Daylight. Colours are linear RGB; the eye of the camera multiplies all of them by ``exposure``.

    to_sun (3,): unit vector in world axes. ``haze_m``: distance at which 1/e of the light arrives, inf for clear air.
    ``clouds`` 0 (blue) .. 1 (overcast); their pattern follows from ``seed``. ``occlusion_m``: reach of the soft contact
    shadows. ``shadow_range_m``: shadows are drawn this far into the scene. Of `sim.render.surroundings`: ``mirrors`` in
    0..1, how strongly paint and glass mirror them; ``shade`` in 0..1, the share of the sun that they hide.
    """

    to_sun: Float[Array, "3"]
    sun: Float[Array, "3"]
    zenith: Float[Array, "3"]
    horizon: Float[Array, "3"]
    ground: Float[Array, "3"]
    exposure: float = 0.72
    haze_m: float = 900.0
    clouds: float = 0.45
    shadows: bool = True
    occlusion_m: float = 0.35
    shadow_range_m: float = 120.0
    mirrors: float = 0.0
    shade: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        freeze_fields(self)
        if not np.isclose(np.linalg.norm(self.to_sun), 1.0):
            raise ValueError(f"Light.to_sun: expected a unit vector, got {self.to_sun.tolist()}")
        if self.to_sun[2] <= 0:
            raise ValueError(f"Light.to_sun: the sun stands below the horizon, got {self.to_sun.tolist()}")

    @staticmethod
    def daylight(
        azimuth_deg: float = 125.0,
        elevation_deg: float = 40.0,
        strength: float = 1.0,
        ambient: float = 1.0,
        exposure: float = 0.72,
        haze_m: float = 900.0,
        clouds: float = 0.45,
        shadows: bool = True,
        mirrors: float = 0.0,
        shade: float = 0.0,
        seed: int = 0,
    ) -> Light:
        """A clear to cloudy day; azimuth clockwise from world +y, as headings are."""
        a, e = np.deg2rad([azimuth_deg, elevation_deg])
        to_sun = np.array([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)])
        return Light(
            to_sun=to_sun,
            sun=strength * np.array([2.35, 2.2, 1.95]),
            zenith=ambient * np.array([0.20, 0.40, 0.85]),
            horizon=ambient * np.array([0.92, 1.04, 1.16]),
            ground=ambient * np.array([0.26, 0.25, 0.22]),
            exposure=exposure,
            haze_m=haze_m,
            clouds=clouds,
            shadows=shadows,
            mirrors=mirrors,
            shade=shade,
            seed=seed,
        )

    @property
    def sky_light(self) -> Float[Array, "3"]:
        """Ambient light on a surface that faces up: the mean of the sky."""
        blue = 0.5 * (self.zenith + self.horizon)
        return np.asarray(blue + self.clouds * (0.9 - blue))


def sky_direction(size: int) -> Float[Array, "s s 3"]:
    """World directions of the sky picture's pixels; row 0 holds the smallest y.

    The whole sphere in Lambert's azimuthal projection, zenith in the middle:
    ``(u, v) = 1/2 + (x, y) / (2 sqrt(2 (1 + z)))``.
    """
    a = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(a, a)
    r2 = np.minimum(x * x + y * y, 1.0)
    scale = 2 * np.sqrt(np.maximum(1 - r2, 0))
    return np.stack([x * scale, y * scale, 1 - 2 * r2], axis=-1)


def _clouds(d: Array, light: Light) -> Array:
    """Density of the clouds 0..1 in the directions d (h, w, 3): a flat layer, lost in the haze at the horizon."""
    rng = stream(light.seed, 0, "sky/clouds")
    tiled = np.pad(noise((1024, 1024), 3.0, rng), ((0, 1), (0, 1)), mode="wrap")
    height = np.maximum(d[..., 2], 0.02) + 0.06
    at = (np.mod(d[..., :2] / height[..., None] * 120.0, 1024)).astype(np.float32)
    value = cv2.remap(tiled, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    threshold = 2.0 - 4.0 * light.clouds
    density = np.clip((value - threshold) / 1.6, 0, 1)
    return np.asarray(density * (2 - density) * np.clip(d[..., 2] / 0.10, 0, 1))


def sky_picture(light: Light, size: int = 1024) -> Float[Array, "s s 3"]:
    """Radiance of sky and ground in the layout of `sky_direction`, float32."""
    d = sky_direction(size)
    up = np.clip(d[..., 2:], 0, 1)
    sky = light.zenith + (light.horizon - light.zenith) * np.exp(-4.0 * up)
    toward_sun = np.clip(np.sum(d * light.to_sun, axis=-1, keepdims=True), 0, 1)
    glow = 0.25 * toward_sun**8 + 0.9 * toward_sun**96
    density = _clouds(d, light)[..., None]
    cloud = np.array([1.30, 1.29, 1.30]) * (0.85 + 0.35 * toward_sun**4) - 0.40 * density**2
    sky = sky + 0.85 * density * (cloud - sky) + glow * light.sun / 2.2
    below = np.clip(-d[..., 2:] / 0.10, 0, 1)
    ground = light.ground * (0.95 - 0.55 * np.clip(-d[..., 2:], 0, 1))
    return np.asarray(sky + below * (ground - sky), np.float32)
