"""The picture that a head of a camera system takes of a scene: colour, grey or thermal, through its sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import UInt8

from sim.aerial.exposure import CAMERA, expose
from sim.aerial.renderer import render
from sim.aerial.scene import AerialScene
from sim.aerial.thermal import ThermalSensor, Weather, grey, render_thermal, sense
from sim.camera import Camera
from sim.pose import Pose
from sim.sensor import Sensor

Array = np.ndarray
BOLOMETER = ThermalSensor()
BANDS = ("rgb", "mono", "thermal")


def picture(
    scene: AerialScene,
    band: str,
    camera: Camera,
    T_wc: Pose,
    t_s: float,
    samples: int,
    rng: np.random.Generator,
    *,
    sensor: Sensor = CAMERA,
    thermal: ThermalSensor = BOLOMETER,
) -> UInt8[Array, "h w *c"]:
    """The image of 8 bits by a head's band: (h, w, 3) of "rgb", (h, w) of "mono" and "thermal".

    ``camera`` is the true one of the head, ``T_wc`` its true pose. Thermal images are grey over the span of the
    scene's weather, the same in every image.

    Raises
        ValueError: fewer than one sample, an unknown band.
    """
    if band not in BANDS:
        raise ValueError(f"band: expected one of {', '.join(BANDS)}, got {band!r}")
    if band == "thermal":
        kelvin = render_thermal(scene, camera, T_wc, t_s, samples)
        return grey(sense(kelvin, thermal, rng), Weather.of(scene.world).span_K())
    seen = render(scene, camera, T_wc, t_s, samples)
    return expose(seen, replace(sensor, grey=band == "mono"), rng)
