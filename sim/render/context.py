"""The process's one OpenGL context, made when first needed: EGL without a display, or OSMesa."""

from __future__ import annotations

import ctypes
import functools
import os
from typing import Any

_PACKAGES = "install the packages libegl1, libgl1 and libgl1-mesa-dri (Debian, Ubuntu)"


class RendererUnavailable(RuntimeError):
    """This machine cannot render; the message says which packages are missing."""


def _loads(*names: str) -> bool:
    for name in names:
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False


def _choose_platform() -> None:
    """Sets PYOPENGL_PLATFORM, unless the user has, to the first that this machine can load."""
    if "PYOPENGL_PLATFORM" in os.environ:
        return
    if _loads("libEGL.so.1"):
        os.environ["PYOPENGL_PLATFORM"] = "egl"
    elif _loads("libOSMesa.so.8", "libOSMesa.so.6"):
        os.environ["PYOPENGL_PLATFORM"] = "osmesa"
    else:
        raise RendererUnavailable(f"no OpenGL for rendering without a display: {_PACKAGES}")


@functools.cache
def context() -> Any:
    """pyrender's platform object with its context current.

    One for the whole process: ending any EGL context of a device ends the others too, so it lives as long as the
    process does, and renderers come and go in it.
    """
    _choose_platform()
    try:
        import pyglet

        pyglet.options["headless"] = True  # pyrender imports its viewer, which else wants libraries of a display
        if os.environ["PYOPENGL_PLATFORM"] == "osmesa":
            from pyrender.platforms.osmesa import OSMesaPlatform as Platform
        else:
            from pyrender.platforms.egl import EGLPlatform as Platform
        platform = Platform(64, 64)
        platform.init_context()
        platform.make_current()
    except Exception as error:  # EGL, OSMesa and their bindings each raise their own
        raise RendererUnavailable(
            f"OpenGL does not start on this machine ({type(error).__name__}: {error}): {_PACKAGES}"
        ) from error
    return platform
