"""Thermal images of a scene: apparent temperatures of the same ground, models and shadows, and an uncooled camera.

The source gives its camera's 320 x 240 pixels and 25 Hz (Kozempel 2012, 2.1); weather, surfaces and sensor are ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8, UInt16

from sim.aerial import thermal_kernels
from sim.aerial.materials import Season
from sim.aerial.paint_kernels import STEPS_PER_K, ZERO_K
from sim.aerial.scene import AerialScene, AerialWorld
from sim.aerial.traffic_state import VehicleStates
from sim.aerial.view import View, look, shadow_map, sheared
from sim.aerial_traffic import STATES
from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray
_AIR_K: dict[Season, float] = {"summer": 297.0, "autumn": 285.0, "winter": 268.0}
_CLEAR_SKY_K, _CLOUD_K = -45.0, -4.0
_EXTINCTION_1_M = 1.2e-4
# A running engine below its bonnet [K], and the speed at which the wind halves what the sun does to a car [m/s].
_ENGINE_K, _WIND_MPS = 25.0, 12.0
_PARKED = STATES.index("parked")
_CODES = (np.arange(1 << 16) / STEPS_PER_K - ZERO_K).astype(np.float32)


@dataclass(frozen=True)
class Weather:
    """The air's temperature [K], direct (across the beam) and diffuse light [kW/m2], the sky's temperature [K]."""

    air_K: float
    direct_kW_m2: float
    diffuse_kW_m2: float
    sky_K: float

    @staticmethod
    def of(world: AerialWorld) -> Weather:
        """That of the season and the sunlight.

        Light on level ground by Haurwitz (1945), 1.098 sin h exp(-0.057 / sin h), and below clouds by Kasten and
        Czeplak (1980), 1 - 0.75 n^3.4, where the share of skylight is the cloudiness n.
        """
        light = world.sunlight
        height = math.sin(math.radians(light.elevation_deg))
        level = 1.098 * height * math.exp(-0.057 / height) * (1 - 0.75 * light.sky**3.4)
        air = _AIR_K[world.season]
        sky = air + (1 - light.sky) * _CLEAR_SKY_K + light.sky * _CLOUD_K
        return Weather(air, level * (1 - light.sky) / height, level * light.sky, sky)

    def span_K(self) -> tuple[float, float]:
        """What a picture of 8 bits shows [K]: from water or snow to dark roofs in the sun; few bonnets are hotter."""
        return self.air_K - 8.0, self.air_K + 8.0 + 24.0 * (self.direct_kW_m2 + self.diffuse_kW_m2)


def render_thermal(
    scene: AerialScene, camera: Camera, T_wc: Pose, t_s: float = 0.0, samples: int = 2
) -> Float[Array, "h w"]:
    """Apparent temperatures [K] (h, w); ``samples`` squared per pixel.

    Only what stands casts shadows: the ground keeps its warmth below what passes.

    Raises
        ValueError: fewer than one sample.
    """
    if samples < 1:
        raise ValueError(f"samples: expected at least 1, got {samples}")
    seen = look(scene, camera, T_wc, t_s)
    spacing, weather = seen.spacing_m(camera), Weather.of(scene.world)
    level = scene.ground.level(spacing / samples)
    pool, slots = scene.ground.tiles(seen.bounds_m(), level, warmth=True)
    standing = seen.states.of(np.flatnonzero(seen.states.speed_mps == 0))
    frame, shadow = shadow_map(scene, seen, spacing, standing)
    sky = weather.sky_K - weather.air_K
    numbers = np.array([weather.direct_kW_m2, weather.diffuse_kW_m2, sky, _EXTINCTION_1_M])
    w, h = camera.size_px
    image = np.empty((h, w), np.float32)
    library = scene.library
    thermal_kernels.warm(
        T_wc.t, sheared(seen.ground, frame), seen.rays, pool, slots, scene.ground.grid(level), seen.triangles,
        seen.start, seen.entries, seen.vertex, seen.instances.paint.astype(np.float32), _engines(scene, seen),
        library.texels, library.warmth, library.textures, frame, shadow, numbers, _CODES, samples, image,
    )  # fmt: skip
    return image + np.float32(weather.air_K)


def _engines(scene: AerialScene, view: View) -> Float[Array, "n 4"]:
    """For every instance the engine's warmth [K], 0, 0 and the share of the sun's warmth that the wind leaves."""
    rows = np.tile(np.array([0, 0, 0, 1], np.float32), (len(view.instances), 1))
    cars = view.states.of(view.vehicles)
    first = len(view.instances) - len(cars)
    rows[first:, 0] = _ENGINE_K * _running(scene, cars)
    rows[first:, 3] = 1 / (1 + cars.speed_mps / _WIND_MPS)
    return rows


def _running(scene: AerialScene, cars: VehicleStates) -> Array:
    """Whether a vehicle's engine runs: it drives or queues."""
    traffic = scene.world.traffic
    if traffic is None:
        return np.zeros(len(cars), bool)
    of_traffic = cars.number < len(traffic)
    running = np.zeros(len(cars), bool)
    running[of_traffic] = traffic.state[cars.number[of_traffic]] != _PARKED
    return running


@dataclass(frozen=True)
class ThermalSensor:
    """An uncooled microbolometer camera: its lens's blur, noise (NETD), and the fixed pattern its correction leaves.

    It converts ``range_K`` to 14 bits. ``pattern`` is the number of its pattern: another camera has another.
    """

    blur_px: float = 0.7
    netd_K: float = 0.08
    pattern_K: float = 0.06
    range_K: tuple[float, float] = (233.0, 393.0)
    pattern: int = 0

    def __post_init__(self) -> None:
        for name in ("blur_px", "netd_K", "pattern_K"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"ThermalSensor.{name}: expected >= 0, got {getattr(self, name)}")
        if not 0 < self.range_K[0] < self.range_K[1] <= 655:
            raise ValueError(f"ThermalSensor.range_K: expected 0 < low < high <= 655, got {self.range_K}")


def sense(kelvin: Float[Array, "h w"], sensor: ThermalSensor, rng: np.random.Generator) -> UInt16[Array, "h w"]:
    """What the camera reports of apparent temperatures [K]: hundredths of a kelvin."""
    sharp = np.asarray(kelvin, np.float32)
    lens = cv2.GaussianBlur(sharp, (0, 0), sensor.blur_px) if sensor.blur_px > 0 else sharp
    signal = lens + sensor.pattern_K * _pattern(lens.shape, sensor.pattern)
    signal += np.float32(sensor.netd_K) * rng.standard_normal(signal.shape, np.float32)
    low, high = sensor.range_K
    step = (high - low) / ((1 << 14) - 1)
    codes = np.clip(np.rint((signal - low) / step), 0, (1 << 14) - 1)
    return np.asarray(np.rint(100 * (low + step * codes)), np.uint16)


@lru_cache(maxsize=4)
def _pattern(shape: tuple[int, int], number: int) -> Float[Array, "h w"]:
    """Fixed pattern of unit deviation: pixels and, weaker, columns."""
    rng = np.random.default_rng(number)
    return np.asarray(0.8 * rng.standard_normal(shape) + 0.6 * rng.standard_normal(shape[1]), np.float32)


def grey(centikelvin: UInt16[Array, "h w"], span_K: tuple[float, float]) -> UInt8[Array, "h w"]:
    """The picture of 8 bits, black to white over a span of temperatures [K].

    Raises
        ValueError: a span that is none.
    """
    low, high = span_K
    if not low < high:
        raise ValueError(f"span_K: expected low < high, got {span_K}")
    return np.asarray(np.clip(np.rint((centikelvin / 100 - low) * (255 / (high - low))), 0, 255), np.uint8)
