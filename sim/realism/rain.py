"""Drops on the windscreen: small strong lenses, each showing the scene upside down, out of focus themselves."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from sim.camera import Camera
from sim.realism.windscreen import area_m2, defocus_px, laid_over, px_per_m
from sim.realism.wiper import Wiper, across_m
from sim.streams import stream

Array = np.ndarray
_DROPS_PER_M2_S = 4000  # heavy rain
_LIFE_S, _OLDEST_S = 3.0, 6.0  # then a drop has run off
_BIN_S = 0.25
_MEDIAN_M, _LOG_SPREAD, _LARGEST_M = 0.0012, 0.5, 0.004
_SEEN = 0.4  # a drop's rim shows what is this far off (tangent)
_SHRINK = 16


@dataclass(frozen=True, eq=False)
class Drops:
    """Drops before one camera: where, and how large [px]."""

    uv: Float[Array, "n 2"]
    radius_px: Float[Array, "n"]


def drops(
    camera: Camera, level: float, wiper: Wiper | None, offset_m: float, seed: int, run: int, side: str, t_s: float
) -> Drops:
    """The drops that have fallen before one camera and were neither wiped away nor have run off."""
    (w, h), scale = camera.size_px, px_per_m(camera)
    now = int(np.floor(t_s / _BIN_S))
    columns = []
    for k in range(now - round(_OLDEST_S / _BIN_S), now + 1):
        rng = stream(seed, run, f"camera/{side}/rain/{k}")
        n = rng.poisson(level * _DROPS_PER_M2_S * _BIN_S * area_m2(camera))
        fell = _BIN_S * (k + rng.uniform(size=n))
        gone = fell + np.minimum(rng.exponential(_LIFE_S, n), _OLDEST_S - _BIN_S)
        radius = np.minimum(_MEDIAN_M * np.exp(_LOG_SPREAD * rng.standard_normal(n)), _LARGEST_M) * scale
        columns.append(np.column_stack([rng.uniform(0, w, n), rng.uniform(0, h, n), radius, fell, gone]))
    u, v, radius, fell, gone = np.concatenate(columns).T
    uv = np.stack([u, v], axis=-1)
    there = (fell <= t_s) & (t_s < gone)
    if wiper is not None:
        there &= fell > wiper.wiped_s(across_m(camera, uv, offset_m), t_s)
    return Drops(uv[there], radius[there])


def rainy(light: Float[Array, "h w 3"], fallen: Drops, camera: Camera) -> Float[Array, "h w 3"]:
    """Light through drops.

    A drop of radius r shows the scene inverted about its middle and so much smaller that its rim sees 22 degrees away;
    the blur of the near windscreen makes small drops faint and soft.
    """
    h, w = light.shape[:2]
    blur = defocus_px(camera) / 2
    opacity = np.zeros((h, w), np.float32)
    source = np.zeros((h, w, 2), np.float32)
    for (u, v), r in zip(fallen.uv, fallen.radius_px, strict=True):
        reach = r + blur
        x = np.arange(max(0, int(u - reach)), min(w, int(u + reach) + 2), dtype=np.float32)
        y = np.arange(max(0, int(v - reach)), min(h, int(v + reach) + 2), dtype=np.float32)
        du, dv = x - u, (y - v)[:, None]
        profile = np.clip((reach - np.hypot(du, dv)) / (2 * min(r, blur)), 0, 1) * min(1.0, (r / blur) ** 2)
        part = (slice(int(y[0]), int(y[-1]) + 1), slice(int(x[0]), int(x[-1]) + 1))
        above = profile > opacity[part]
        opacity[part][above] = profile[above]
        magnified = _SEEN * float(camera.K[0, 0]) / reach
        source[part][above] = np.stack(np.broadcast_arrays(u - magnified * du, v - magnified * dv), axis=-1)[above]
    small = cv2.resize(light, (max(w // _SHRINK, 1), max(h // _SHRINK, 1)), interpolation=cv2.INTER_AREA)
    at = (source + np.float32(0.5)) * (np.array([small.shape[1] / w, small.shape[0] / h], np.float32)) - np.float32(0.5)
    refracted = cv2.remap(small, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return laid_over(light, opacity, np.asarray(refracted))
