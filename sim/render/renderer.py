"""Colour, depth and instance images of a scene whose items stand in given poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import TracebackType
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Float, UInt8, UInt16

from sim.camera import Camera, StereoRig
from sim.pose import Pose
from sim.render.context import context
from sim.render.lens import Lens
from sim.render.light import Light
from sim.render.placement import Batch, Item, Placement, batches, inventory, outside, place
from sim.render.view import Eye, fit_light_box

if TYPE_CHECKING:
    from sim.render.passes import LightMap

Array = np.ndarray
PRODUCTS = frozenset({"color", "depth", "instance"})
_ZENITH = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class View:
    """What one camera sees; None where not asked for.

    color (h, w, 3) RGB as a display expects it, before the sensor; depth (h, w) along z [m], 0 in the sky, and
    instance (h, w), 0 in the sky, both at the exact pixel centres.
    """

    color: UInt8[Array, "h w 3"] | None
    depth: Float[Array, "h w"] | None
    instance: UInt16[Array, "h w"] | None


class Renderer:
    """A scene in the graphics memory: made once, then only the poses change. Use it in a ``with`` statement.

    Colour is drawn ``supersample`` times finer in each direction and averaged. All renderers of a process share one
    OpenGL context and must be used from one thread.

    Raises `RendererUnavailable` where the machine has no OpenGL.
    """

    def __init__(self, items: Sequence[Item], light: Light | None = None, supersample: int = 2) -> None:
        if supersample < 1:
            raise ValueError(f"supersample: expected at least 1, got {supersample}")
        self._context = context()
        from sim.render.passes import Passes  # imports OpenGL, which needs the context first

        self._context.make_current()
        self._light = Light.daylight() if light is None else light
        self._supersample = supersample
        self._inventory = inventory(items)
        self._passes = Passes(self._inventory.surfaces, self._light)
        self._closed = False

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Frees the scene's graphics memory."""
        if not self._closed:
            self._closed = True
            self._context.make_current()
            self._passes.delete()

    def render(
        self, camera: Camera, T_wc: Pose, T_w_items: Sequence[Pose], products: frozenset[str] = PRODUCTS
    ) -> View:
        """What one camera sees of the items in these poses (one per item, in their order)."""
        return self._render([(camera, T_wc)], T_w_items, products)[0]

    def render_stereo(
        self, rig: StereoRig, T_wc: Pose, T_w_items: Sequence[Pose], products: frozenset[str] = PRODUCTS
    ) -> tuple[View, View]:
        """Both images of one moment from one state: same levels of detail, shadows drawn once. ``T_wc``: the left's."""
        eyes = [(rig.left, T_wc), (rig.right, T_wc @ rig.T_rl.inv())]
        left, right = self._render(eyes, T_w_items, products)
        return left, right

    def _render(
        self, cameras: Sequence[tuple[Camera, Pose]], T_w_items: Sequence[Pose], products: frozenset[str]
    ) -> list[View]:
        if not products <= PRODUCTS:
            raise ValueError(f"products: expected some of {sorted(PRODUCTS)}, got {sorted(products)}")
        if self._closed:
            raise ValueError("Renderer: already closed")
        self._context.make_current()
        placement = place(self._inventory, T_w_items, cameras[0][1].t)
        lenses = [_lens(c, self._supersample) if c.is_distorted else None for c, _ in cameras]
        eyes = [
            Eye.at(camera if lens is None else lens.ideal, T_wc, placement.anchor, placement.corners)
            for (camera, T_wc), lens in zip(cameras, lenses, strict=True)
        ]
        maps = self._light_maps(eyes, placement) if "color" in products and self._light.shadows else None
        return [self._view(eye, lens, placement, maps, products) for eye, lens in zip(eyes, lenses, strict=True)]

    def _light_maps(self, eyes: Sequence[Eye], placement: Placement) -> tuple[LightMap, LightMap]:
        """Draws what the sun sees, and what the zenith sees for the soft shadows of the sky's light."""
        inv, corners = self._inventory, placement.corners
        casts = inv.casts[placement.rows]
        maps = []
        for draw, to_light in ((self._passes.sun, self._light.to_sun), (self._passes.zenith, _ZENITH)):
            box = fit_light_box(to_light, eyes, corners, casts, self._light.shadow_range_m)
            draws: list[Batch] = []
            if box is not None:
                clip = _homogeneous(corners) @ box[0].T
                draws = batches(inv, placement, casts & ~outside(clip), np.zeros(len(corners)))
            maps.append(draw(box, draws))
        sun, zenith = maps
        return sun, zenith

    def _view(
        self,
        eye: Eye,
        lens: Lens | None,
        placement: Placement,
        maps: tuple[LightMap, LightMap] | None,
        products: frozenset[str],
    ) -> View:
        clip = _homogeneous(placement.corners) @ eye.clip_from_anchor.T
        farthest = np.linalg.norm(placement.corners - eye.center, axis=-1).max(axis=-1)
        draws = batches(self._inventory, placement, ~outside(clip), farthest)
        color = depth = instance = None
        if "color" in products:
            fine = self._passes.color(eye, self._supersample, draws, maps)
            if lens is not None:
                fine = lens.bend(fine)
            w, h = fine.shape[1] // self._supersample, fine.shape[0] // self._supersample
            color = np.ascontiguousarray(cv2.resize(fine, (w, h), interpolation=cv2.INTER_AREA)[..., :3])
        if products & {"depth", "instance"}:
            if lens is None:
                truth = self._passes.truth(eye, 1, draws)
            else:
                truth = lens.pick(self._passes.truth(eye, self._supersample, draws))
            depth = np.ascontiguousarray(truth[..., 0]) if "depth" in products else None
            instance = truth[..., 1].astype(np.uint16) if "instance" in products else None
        return View(color, depth, instance)


def _homogeneous(points: Array) -> Array:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


@lru_cache(maxsize=4)
def _lens(camera: Camera, supersample: int) -> Lens:
    return Lens.of(camera, supersample)
