"""Where each side of a vehicle lies on its one texture: flank (shared by both), top (mirrored), front, rear, wheel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sim.textures import Board

Array = np.ndarray
_MARGIN_M = 0.06
_SIGNS = {"side": (1, -1), "top": (1, 1), "front": (1, -1), "rear": (-1, -1), "wheel": (1, -1), "white": (1, 1)}


@dataclass(frozen=True)
class Atlas:
    """Layout in metres from the texture's top-left corner, ``scale`` px/m; x counts from the rear bumper here."""

    size_m: tuple[float, float, float]
    wheel_m: float
    width_px: int = 2048

    @property
    def scale(self) -> float:
        """Texels per metre."""
        L, W, H = self.size_m
        wide = max(L + 2 * _MARGIN_M, 2 * W + 2.4 * self.wheel_m + 5 * _MARGIN_M)
        high = 2 * H + W / 2 + 4 * _MARGIN_M
        return self.width_px / max(wide, high)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the texture."""
        _, W, H = self.size_m
        rows = (2 * H + W / 2 + 4 * _MARGIN_M) * self.scale
        return (self.width_px if rows > self.width_px / 2 else self.width_px // 2), self.width_px

    def origins(self) -> dict[str, tuple[float, float]]:
        """Origin of each chart [m on the texture]: where its coordinates are zero."""
        _, W, H = self.size_m
        row = 3 * _MARGIN_M + H + W / 2
        return {
            "side": (_MARGIN_M, _MARGIN_M + H),
            "top": (_MARGIN_M, 2 * _MARGIN_M + H),
            "front": (_MARGIN_M + W / 2, row + H),
            "rear": (2 * _MARGIN_M + 1.5 * W, row + H),
            "wheel": (3 * _MARGIN_M + 2 * W + 1.2 * self.wheel_m, row + 1.2 * self.wheel_m),
            "white": (3 * _MARGIN_M + 2 * W + 0.1, row + 2.4 * self.wheel_m + 0.1),
        }

    def board(self, chart: str, image: Float[Array, "h w 3"]) -> Board:
        """Drawing board of a chart: side (x, z), top (x, |y|), front and rear (y, z), wheel (x, z)."""
        a, b = self.origins()[chart]
        sa, sb = _SIGNS[chart]
        x0, y0, x1, y1 = (max(round(e * self.scale), 0) for e in self._extent(chart))
        origin = (a * self.scale - x0, b * self.scale - y0)
        return Board(image[y0:y1, x0:x1], origin, (sa * self.scale, sb * self.scale))

    def _extent(self, chart: str) -> tuple[float, float, float, float]:
        """Left, top, right, bottom of a chart with half its margin [m on the texture]."""
        L, W, H = self.size_m
        a, b = self.origins()[chart]
        left, up, right, down = {
            "side": (0.0, H, L, 0.0),
            "top": (0.0, 0.0, L, W / 2),
            "front": (W / 2, H, W / 2, 0.0),
            "rear": (W / 2, H, W / 2, 0.0),
            "wheel": (1.2 * self.wheel_m,) * 4,
            "white": (0.08,) * 4,
        }[chart]
        m = _MARGIN_M / 2
        return a - left - m, b - up - m, a + right + m, b + down + m

    def uv(self, chart: str, points: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
        """Texture coordinates of chart coordinates [m]."""
        px = np.asarray(points, float) * _SIGNS[chart] + self.origins()[chart]
        rows, columns = self.shape
        return np.stack([px[..., 0] * self.scale / columns, 1 - px[..., 1] * self.scale / rows], axis=-1)

    def project(
        self, corners: Float[Array, "f 3 3"], normals: Float[Array, "f 3"], rear_m: float
    ) -> Float[Array, "f 3 2"]:
        """Texture coordinates of body faces, each on the chart it faces; ``rear_m`` is the rear overhang."""
        x, y, z = corners[..., 0] + rear_m, corners[..., 1], corners[..., 2]
        flat: dict[str, tuple[Bool[Array, " f"], Array]] = {
            "top": (normals[:, 2] > -2, np.stack([x, np.abs(y)], -1)),
            "side": ((np.abs(normals[:, 1]) > 0.55) | (normals[:, 2] < -0.5), np.stack([x, z], -1)),
            "front": (normals[:, 0] > 0.70, np.stack([y, z], -1)),
            "rear": (normals[:, 0] < -0.70, np.stack([y, z], -1)),
        }
        uv = np.zeros((*corners.shape[:2], 2))
        for chart, (chosen, points) in flat.items():
            uv[chosen] = self.uv(chart, points[chosen])
        return uv
