"""OpenGL resources on pyrender's classes: triangles, textures, shader programs and framebuffers.

To be imported only once `sim.render.context` has an OpenGL context.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
from OpenGL import GL
from pyrender import Primitive, Sampler, Texture
from pyrender.shader_program import ShaderProgramCache

from sim.model import Surface

Array = np.ndarray
_INSTANCE = 8  # attribute of shaders/truth.vert; the instances' matrices take 4 to 7


class SurfaceBuffer(Primitive):  # type: ignore[misc]  # pyrender has no types
    """The triangles of one `Surface`, drawn any number of times in one call."""

    def __init__(self, surface: Surface) -> None:
        uv = np.zeros((len(surface.vertices), 2)) if surface.uv is None else surface.uv
        super().__init__(
            positions=surface.vertices,
            normals=surface.normals,
            texcoord_0=uv,
            color_0=np.column_stack([surface.color, surface.gloss]).astype(np.float32),
            indices=surface.faces,
            poses=np.eye(4)[None],
        )
        self._count = 3 * len(surface.faces)
        self._add_to_context()
        self._bind()
        ids = GL.glGenBuffers(1)
        self._buffers.insert(2, ids)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, ids)
        GL.glVertexAttribPointer(_INSTANCE, 1, GL.GL_FLOAT, GL.GL_FALSE, 0, ctypes.c_void_p(0))
        GL.glEnableVertexAttribArray(_INSTANCE)
        GL.glVertexAttribDivisor(_INSTANCE, 1)

    def draw(self, T_anchor_item: Array, instance: Array) -> None:
        """Draws with each of the matrices (n, 4, 4) and instance ids (n,)."""
        matrices = np.ascontiguousarray(np.swapaxes(T_anchor_item, -1, -2), np.float32)
        ids = np.ascontiguousarray(instance, np.float32)
        self._bind()
        for buffer, data in zip(self._buffers[1:3], (matrices, ids), strict=True):
            GL.glBindBuffer(GL.GL_ARRAY_BUFFER, buffer)
            GL.glBufferData(GL.GL_ARRAY_BUFFER, data.nbytes, data, GL.GL_STREAM_DRAW)
        GL.glDrawElementsInstanced(GL.GL_TRIANGLES, self._count, GL.GL_UNSIGNED_INT, None, len(ids))


class SurfaceTexture(Texture):  # type: ignore[misc]  # pyrender has no types
    """An sRGB image, decoded to linear light when sampled, and one mipmap level sharper than usual if so wished."""

    def __init__(self, image: Array, repeat: bool, sharpen: bool) -> None:
        wrap = GL.GL_REPEAT if repeat else GL.GL_CLAMP_TO_EDGE
        super().__init__(sampler=Sampler(wrapS=wrap, wrapT=wrap), source_channels="RGB")
        self._texid = GL.glGenTextures(1)
        self._bind()
        data = np.ascontiguousarray(image[::-1])
        h, w = data.shape[:2]
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_SRGB8, w, h, 0, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, data)
        GL.glGenerateMipmap(GL.GL_TEXTURE_2D)
        _filter(GL.GL_LINEAR_MIPMAP_LINEAR, GL.GL_LINEAR, self.sampler.wrapS)
        if sharpen:
            GL.glTexParameterf(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_LOD_BIAS, -1.0)


def _filter(minify: int, magnify: int, wrap: int) -> None:
    for key, value in (
        (GL.GL_TEXTURE_MIN_FILTER, minify),
        (GL.GL_TEXTURE_MAG_FILTER, magnify),
        (GL.GL_TEXTURE_WRAP_S, wrap),
        (GL.GL_TEXTURE_WRAP_T, wrap),
    ):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, key, value)


def float_texture(image: Array, repeat: bool = False) -> int:
    """Texture of three numbers (h, w, 3) float32, also beyond 1, row 0 at v = 0."""
    texture = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    h, w = image.shape[:2]
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGB16F, w, h, 0, GL.GL_RGB, GL.GL_FLOAT, np.ascontiguousarray(image))
    GL.glGenerateMipmap(GL.GL_TEXTURE_2D)
    _filter(GL.GL_LINEAR_MIPMAP_LINEAR, GL.GL_LINEAR, GL.GL_REPEAT if repeat else GL.GL_CLAMP_TO_EDGE)
    return texture


class Programs:
    """The shaders of this package, compiled once per combination of defines, and their uniforms."""

    def __init__(self) -> None:
        self._cache = ShaderProgramCache(shader_dir=str(Path(__file__).parent / "shaders"))
        self._locations: dict[tuple[int, str], int] = {}

    def use(self, vertex: str, fragment: str, defines: tuple[str, ...] = (), **uniforms: Any) -> None:
        """Binds a program and sets its uniforms: int, float, or arrays (2,), (3,), (4, 4)."""
        program = self._cache.get_program(vertex, fragment, defines=dict.fromkeys(defines, 1))
        if not program._in_context():
            program._add_to_context()
        program._bind()
        for name, value in uniforms.items():
            self._set(program._program_id, name, value)

    def _set(self, program: int, name: str, value: Any) -> None:
        key = (program, name)
        if key not in self._locations:
            self._locations[key] = GL.glGetUniformLocation(program, name)
        location = self._locations[key]
        if isinstance(value, int):
            GL.glUniform1i(location, value)
        elif isinstance(value, float):
            GL.glUniform1f(location, value)
        else:
            value = np.ascontiguousarray(value, np.float32)
            setter = {(2,): GL.glUniform2fv, (3,): GL.glUniform3fv}
            if value.shape == (4, 4):
                GL.glUniformMatrix4fv(location, 1, GL.GL_TRUE, value)
            else:
                setter[value.shape](location, 1, value)

    def delete(self) -> None:
        self._cache.clear()


class Target:
    """A framebuffer without multisampling: one colour buffer and 24 bits of depth."""

    def __init__(self, size: tuple[int, int], color_format: int) -> None:
        self.size = size
        self._buffers = GL.glGenRenderbuffers(2)
        self._framebuffer = GL.glGenFramebuffers(1)
        self.bind()
        attachments = (
            (GL.GL_COLOR_ATTACHMENT0, color_format),
            (GL.GL_DEPTH_ATTACHMENT, GL.GL_DEPTH_COMPONENT24),
        )
        for buffer, (attachment, form) in zip(self._buffers, attachments, strict=True):
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, form, *size)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)
        status = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
        if status != GL.GL_FRAMEBUFFER_COMPLETE:
            raise RuntimeError(f"framebuffer of {size[0]} x {size[1]} pixels: OpenGL status {int(status):#x}")

    def bind(self) -> None:
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
        GL.glViewport(0, 0, *self.size)

    def read(self, components: int, kind: int) -> Array:
        """Pixels (h, w, channels) in the order they were drawn: row 0 is the framebuffer's lowest."""
        w, h = self.size
        dtype, channels = {GL.GL_UNSIGNED_BYTE: (np.uint8, 4), GL.GL_FLOAT: (np.float32, 2)}[kind]
        pixels = np.empty((h, w, channels), dtype)
        GL.glReadPixels(0, 0, w, h, components, kind, pixels)
        return pixels

    def delete(self) -> None:
        GL.glDeleteFramebuffers(1, [self._framebuffer])
        GL.glDeleteRenderbuffers(2, self._buffers)


class DepthMap:
    """A square depth texture that shaders compare against; outside it nothing is in shadow."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.texture = int(GL.glGenTextures(1))
        GL.glBindTexture(GL.GL_TEXTURE_2D, self.texture)
        GL.glTexImage2D(
            GL.GL_TEXTURE_2D, 0, GL.GL_DEPTH_COMPONENT24, size, size, 0, GL.GL_DEPTH_COMPONENT, GL.GL_UNSIGNED_INT, None
        )
        _filter(GL.GL_LINEAR, GL.GL_LINEAR, GL.GL_CLAMP_TO_BORDER)
        GL.glTexParameterfv(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_BORDER_COLOR, np.ones(4, np.float32))
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_COMPARE_MODE, GL.GL_COMPARE_REF_TO_TEXTURE)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_COMPARE_FUNC, GL.GL_LEQUAL)
        self._framebuffer = GL.glGenFramebuffers(1)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
        GL.glFramebufferTexture2D(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, GL.GL_TEXTURE_2D, self.texture, 0)
        GL.glDrawBuffer(GL.GL_NONE)
        GL.glReadBuffer(GL.GL_NONE)

    def bind(self) -> None:
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
        GL.glViewport(0, 0, self.size, self.size)

    def delete(self) -> None:
        GL.glDeleteFramebuffers(1, [self._framebuffer])
        GL.glDeleteTextures([self.texture])
