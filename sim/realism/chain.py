"""All disturbances of a camera's light in the order of its way: windscreen, scatter, gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from sim.camera import Camera
from sim.realism.contrast import rolling_contrast
from sim.realism.dirt import dirty, spots
from sim.realism.glare import glaring
from sim.realism.rain import drops, rainy
from sim.realism.steps import exposure_gain
from sim.realism.tone import to_image, to_light
from sim.realism.windscreen import laid_over
from sim.realism.wiper import Wiper, blade_opacity
from sim.scenario import Realism

Array = np.ndarray
_BLADE_LIGHT = np.full(3, 0.02, np.float32)


@dataclass(frozen=True, eq=False)
class Shot:
    """Who takes a picture and when: camera, "left" or "right", offset_m right of the left camera, base length, run.

    sun_c: unit vector to the sun in the camera frame; sun (3,): light of a white wall that faces it as far as the
    camera sees it.
    """

    camera: Camera
    side: str
    offset_m: float
    baseline_m: float
    seed: int
    run: int
    t_s: float
    sun_c: Float[Array, "3"]
    sun: Float[Array, "3"]


def disturbed(image: UInt8[Array, "h w 3"], realism: Realism, shot: Shot) -> UInt8[Array, "h w 3"]:
    """The image before the sensor as the disturbances leave it; without any the very same object."""
    if not realism.on_the_way:
        return image
    light = _through_windscreen(to_light(image), realism, shot)
    if realism.glare:
        light = glaring(light, realism.glare, shot.camera, shot.sun_c, shot.sun)
    if realism.contrast:
        light = rolling_contrast(light, realism.contrast, shot.seed, shot.run, shot.side, shot.t_s)
    if realism.exposure_step_ev:
        light = light * np.float32(exposure_gain(realism.exposure_step_ev, shot.seed, shot.run, shot.t_s))
    return to_image(light)


def _through_windscreen(light: Array, realism: Realism, shot: Shot) -> Array:
    camera, seed, run = shot.camera, shot.seed, shot.run
    wiper = Wiper.before(camera, shot.baseline_m, realism.wiper_s, seed, run) if realism.wiper_s else None
    if realism.dirt:
        light = dirty(light, spots(camera, realism.dirt, seed, run, shot.side))
    if realism.rain:
        fallen = drops(camera, realism.rain, wiper, shot.offset_m, seed, run, shot.side, shot.t_s)
        light = rainy(light, fallen, camera)
    if wiper is not None:
        blade = blade_opacity(camera, wiper, shot.offset_m, shot.t_s, realism.exposure_ms / 1000)
        light = light if blade is None else laid_over(light, blade, _BLADE_LIGHT)
    return light
