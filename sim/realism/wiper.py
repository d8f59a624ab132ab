"""One wiper blade that passes both cameras: out and back once per period, a dark bar out of focus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import erf

from sim.camera import Camera
from sim.realism.windscreen import defocus_px, px_per_m
from sim.streams import stream

Array = np.ndarray
_SPEED_MPS, _WIDTH_M, _TILT = 2.5, 0.012, 0.3
_OPACITY = 0.97
_MARGIN_M = 0.05


@dataclass(frozen=True)
class Wiper:
    """The blade's way over the windscreen, from ``low_m`` to ``high_m`` (right of the left camera) and back."""

    period_s: float
    start_s: float
    low_m: float
    high_m: float

    @staticmethod
    def before(camera: Camera, baseline_m: float, period_s: float, seed: int, run: int) -> Wiper:
        """A wiper that clears the view of both cameras; when its period begins follows from the seed."""
        w, h = camera.size_px
        reach = 0.5 * (w + _TILT * h) / px_per_m(camera) + _MARGIN_M
        start = stream(seed, run, "camera/wiper").uniform(0, period_s)
        return Wiper(period_s, float(start), -reach, baseline_m + reach)

    @property
    def speed_mps(self) -> float:
        """At least what brings the blade out and back within a period."""
        return max(_SPEED_MPS, 2 * (self.high_m - self.low_m) / self.period_s)

    def blade_m(self, t_s: float) -> float | None:
        """Where the blade is, None while it rests."""
        since = (t_s - self.start_s) % self.period_s
        sweep = (self.high_m - self.low_m) / self.speed_mps
        if since > 2 * sweep:
            return None
        return self.low_m + self.speed_mps * (sweep - abs(since - sweep))

    def wiped_s(self, x_m: Float[Array, "*b"], t_s: float) -> Float[Array, "*b"]:
        """When the blade was last at places on the windscreen, at most ``t_s``."""
        out = (x_m - self.low_m) / self.speed_mps
        back = (2 * self.high_m - self.low_m - x_m) / self.speed_mps
        passes = np.stack([out, back]) + self.start_s
        return np.asarray((passes + np.floor((t_s - passes) / self.period_s) * self.period_s).max(axis=0))


def across_m(camera: Camera, uv: Float[Array, "*b 2"], offset_m: float) -> Float[Array, "*b"]:
    """The blade's coordinate of pixels of a camera that stands ``offset_m`` right of the left one."""
    d = uv - camera.K[:2, 2]
    return np.asarray(offset_m + (d[..., 0] + _TILT * d[..., 1]) / px_per_m(camera))


def blade_opacity(
    camera: Camera, wiper: Wiper, offset_m: float, t_s: float, exposure_s: float
) -> Float[Array, "h w"] | None:
    """How much of each pixel the blade hides: a bar blurred by defocus and exposure; None where it is out of view."""
    blade = wiper.blade_m(t_s)
    if blade is None:
        return None
    w, h = camera.size_px
    u, v = np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32)
    # The blade's coordinate is a sum of a column's and a row's part.
    column = across_m(camera, np.stack([u, np.zeros_like(u)], axis=-1).astype(float), offset_m)
    row = v * (_TILT / px_per_m(camera))
    half = _WIDTH_M / 2
    blur = np.hypot(defocus_px(camera) / px_per_m(camera) / 4, wiper.speed_mps * exposure_s / np.sqrt(12))
    reach = half + 4 * blur
    if blade < column[0] + row[0] - reach or blade > column[-1] + row[-1] + reach:
        return None
    at = np.linspace(-reach, reach, 257)
    profile = 0.5 * _OPACITY * (erf((half - at) / (np.sqrt(2) * blur)) + erf((half + at) / (np.sqrt(2) * blur)))
    distance = (column[None] + row[:, None] - blade).ravel()
    opacity = np.interp(distance, at, profile, left=0, right=0)
    return np.asarray(opacity.reshape(h, w), np.float32)
