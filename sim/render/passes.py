"""The four drawing passes: light maps, surfaces, sky, and truth (depth and instance at exact pixel centres).

Own passes on pyrender's buffers and shader cache instead of its `Renderer`: that one spends 0.3 ms of Python per
primitive, always multisamples, draws no sky, knows no instances and takes depth at a multisample, not the pixel centre.
To be imported only once `sim.render.context` has an OpenGL context.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from OpenGL import GL

from sim.camera import Camera
from sim.model import Surface
from sim.render.gpu import DepthMap, Programs, SurfaceBuffer, SurfaceTexture, Target, float_texture
from sim.render.light import Light, sky_picture
from sim.render.placement import Batch
from sim.render.surroundings import TOWN_M, shade_axes, shade_pattern, town_plan
from sim.render.view import Eye
from sim.streams import stream

Array = np.ndarray
_SUN_MAP, _ZENITH_MAP = 3072, 768
_TO_UNIT = np.array([[0.5, 0, 0, 0.5], [0, 0.5, 0, 0.5], [0, 0, 0.5, 0.5], [0, 0, 0, 1.0]])
_NOWHERE = np.diag([0.0, 0, 0, 1.0])
_NOWHERE[:3, 3] = 2.0


@dataclass(frozen=True)
class LightMap:
    """A drawn light map: anchor frame to map coordinates (4, 4), and the width of the map [m]."""

    unit_from_anchor: Float[Array, "4 4"]
    width_m: float


class Passes:
    """Everything of a scene that lives in OpenGL, and the passes over it."""

    def __init__(self, surfaces: Sequence[Surface], light: Light) -> None:
        self._light = light
        self._programs = Programs()
        self._buffers = [SurfaceBuffer(s) for s in surfaces]
        images: dict[tuple[int, bool, bool], SurfaceTexture] = {}
        self._textures: list[SurfaceTexture | None] = []
        self._defines: list[tuple[str, ...]] = []
        for s in surfaces:
            flat = bool(np.mean(s.normals[:, 2] > 0.9) > 0.5)
            key = (id(s.texture), s.repeat, flat)
            if s.texture is not None and key not in images:
                images[key] = SurfaceTexture(s.texture, s.repeat, sharpen=not flat)
            self._textures.append(images.get(key))
            wanted = {
                "WITH_TEXTURE": s.texture is not None,
                "WITH_STRETCH": s.texture is not None and flat,
                "WITH_GLOSS": bool(s.gloss.any()),
                "WITH_SHADOWS": light.shadows,
                "WITH_MIRRORS": bool(s.gloss.any()) and light.mirrors > 0,
                "WITH_SHADE": light.shade > 0,
            }
            self._defines.append(tuple(name for name, yes in wanted.items() if yes))
        self._images = list(images.values())
        self._sky = float_texture(sky_picture(light))
        nothing = np.zeros((1, 1, 3), np.float32)
        town = town_plan(stream(light.seed, 0, "surroundings/town")) if light.mirrors > 0 else nothing
        shade = shade_pattern(stream(light.seed, 0, "surroundings/shade")) if light.shade > 0 else nothing
        self._town, self._shade = float_texture(town, repeat=True), float_texture(shade, repeat=True)
        self._empty = int(GL.glGenVertexArrays(1))
        self._sun_map, self._zenith_map = DepthMap(_SUN_MAP), DepthMap(_ZENITH_MAP)
        self._targets: dict[int, Target] = {}

    def sun(self, box: tuple[Array, float] | None, draws: Sequence[Batch]) -> LightMap:
        return self._light_map(self._sun_map, box, draws)

    def zenith(self, box: tuple[Array, float] | None, draws: Sequence[Batch]) -> LightMap:
        return self._light_map(self._zenith_map, box, draws)

    def _light_map(self, depth_map: DepthMap, box: tuple[Array, float] | None, draws: Sequence[Batch]) -> LightMap:
        if box is None:
            return LightMap(_NOWHERE, 1.0)
        clip, width = box
        depth_map.bind()
        _prepare(GL.GL_DEPTH_BUFFER_BIT)
        GL.glDisable(GL.GL_CULL_FACE)
        self._programs.use("depth.vert", "depth.frag", camera=clip)
        self._draw(draws)
        return LightMap(_TO_UNIT @ clip, width)

    def _draw(self, draws: Sequence[Batch]) -> None:
        for batch in draws:
            self._buffers[batch.surface].draw(batch.T_anchor_items, batch.instance)

    def color(self, eye: Eye, finer: int, draws: Sequence[Batch], maps: tuple[LightMap, LightMap] | None) -> Array:
        """Image (h finer, w finer, 4) uint8 as the eye's camera sees it; its fourth channel means nothing."""
        target = self._target(eye.camera, finer, GL.GL_RGBA8)
        target.bind()
        _prepare(GL.GL_DEPTH_BUFFER_BIT)
        used: set[tuple[str, ...]] = set()
        self._bind_maps()
        for batch in draws:
            texture = self._textures[batch.surface]
            defines = self._defines[batch.surface]
            uniforms = {} if defines in used else self._uniforms(eye, maps)
            used.add(defines)
            self._programs.use("surface.vert", "surface.frag", defines, **uniforms)
            if texture is not None:
                GL.glActiveTexture(GL.GL_TEXTURE0)
                texture._bind()
            self._draw([batch])
        self._draw_sky(eye)
        return target.read(GL.GL_RGBA, GL.GL_UNSIGNED_BYTE)

    def truth(self, eye: Eye, finer: int, draws: Sequence[Batch]) -> Array:
        """(h finer, w finer, 2) float32: depth along z [m] and instance at the pixel centres, 0 in the sky."""
        target = self._target(eye.camera, finer, GL.GL_RG32F)
        target.bind()
        GL.glClearColor(0, 0, 0, 0)
        _prepare(GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT)
        self._programs.use("truth.vert", "truth.frag", camera=eye.clip_from_anchor)
        self._draw(draws)
        return target.read(GL.GL_RG, GL.GL_FLOAT)

    def _uniforms(self, eye: Eye, maps: tuple[LightMap, LightMap] | None) -> dict[str, object]:
        light = self._light
        uniforms: dict[str, object] = {
            "camera": eye.clip_from_anchor,
            "eye": eye.center,
            "to_sun": light.to_sun,
            "sun": light.sun,
            "sun_glint": 20.0 * light.sun,
            "sky_light": light.sky_light,
            "ground_light": light.ground,
            "haze_per_m": float(np.log2(np.e) / light.haze_m),
            "haze_color": light.horizon,
            "exposure": light.exposure,
            "image": 0,
            "sky": 1,
            "sun_map": 2,
            "zenith_map": 3,
        }
        if light.mirrors > 0:
            place = np.append(np.mod((eye.center + eye.anchor)[:2], TOWN_M), eye.center[2] + eye.anchor[2])
            uniforms |= {"town": 4, "town_m": TOWN_M, "town_eye": place, "mirrors": float(light.mirrors)}
            uniforms |= {"front_light": light.sky_light + 0.25 * light.sun, "front_glint": 3.0 * light.sun}
        if light.shade > 0:
            axes = shade_axes(light.to_sun)
            uniforms |= {
                "shade": 5,
                "shade_share": float(light.shade),
                "shade_eye": np.mod(axes @ (eye.center + eye.anchor), 1.0),
            }
            uniforms |= {"shade_across": axes[0], "shade_along": axes[1]}
        if maps is not None:
            sun, zenith = maps
            texel = sun.width_m / _SUN_MAP
            uniforms |= {
                "sun_box": sun.unit_from_anchor,
                "zenith_box": zenith.unit_from_anchor,
                "sun_texel_m": texel,
                "occlusion_m": 0.5 * light.occlusion_m,
                "sun_step": _map_step(sun, max(0.02, 0.8 * texel)),
                "zenith_step": _map_step(zenith, light.occlusion_m),
            }
        return uniforms

    def _bind_maps(self) -> None:
        maps = (self._sky, self._sun_map.texture, self._zenith_map.texture, self._town, self._shade)
        for unit, texture in enumerate(maps, start=1):
            GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
            GL.glBindTexture(GL.GL_TEXTURE_2D, texture)

    def _draw_sky(self, eye: Eye) -> None:
        """Fills what no surface covers: a triangle over the whole image at the far end."""
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glDepthFunc(GL.GL_LEQUAL)
        ray_of_clip = eye.ray_of_clip()
        self._programs.use("sky.vert", "sky.frag", ray_of_clip=ray_of_clip, sky=1, exposure=self._light.exposure)
        GL.glBindVertexArray(self._empty)  # after `use`: compiling a program unbinds it
        GL.glDrawArrays(GL.GL_TRIANGLES, 0, 3)

    def _target(self, camera: Camera, finer: int, color_format: int) -> Target:
        size = (camera.size_px[0] * finer, camera.size_px[1] * finer)
        target = self._targets.get(color_format)
        if target is None or target.size != size:
            if target is not None:
                target.delete()
            target = self._targets[color_format] = Target(size, color_format)
        return target

    def delete(self) -> None:
        for texture in self._images:
            texture.delete()
        for buffer in self._buffers:
            buffer.delete()
        for target in self._targets.values():
            target.delete()
        self._sun_map.delete()
        self._zenith_map.delete()
        self._programs.delete()
        GL.glDeleteTextures([self._sky, self._town, self._shade])
        GL.glDeleteVertexArrays(1, [self._empty])


def _prepare(clear: int) -> None:
    """State of every pass. Faces count clockwise because images are drawn upside down."""
    GL.glDisable(GL.GL_BLEND)
    GL.glEnable(GL.GL_DEPTH_TEST)
    GL.glDepthMask(GL.GL_TRUE)
    GL.glDepthFunc(GL.GL_LESS)
    GL.glEnable(GL.GL_CULL_FACE)
    GL.glCullFace(GL.GL_BACK)
    GL.glFrontFace(GL.GL_CW)
    GL.glClear(clear)


def _map_step(light_map: LightMap, length_m: float) -> Float[Array, "2"]:
    """A length in metres along both axes of the map, in map coordinates."""
    return np.asarray(np.linalg.norm(light_map.unit_from_anchor[:2, :3], axis=-1) * length_m)
