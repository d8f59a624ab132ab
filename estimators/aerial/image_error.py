"""What a wrong interior orientation does over the image: displacements of directions, with and without a rotation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from sim.camera import Camera
from sim.pose import hat

Array = np.ndarray


def image_rays(camera: Camera, count: int = 21) -> Float[Array, "k 3"]:
    """Directions of depth 1 of a grid of count x count pixels from corner to corner, row by row."""
    u, v = (np.linspace(-0.5, n - 0.5, count) for n in camera.size_px)
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return camera.unproject(uv, np.ones(len(uv)))


def displacements(wrong: Camera, camera: Camera, rays: Float[Array, "k 3"]) -> Float[Array, "k 2"]:
    """Where a wrong camera puts directions, minus where the camera does [px]."""
    return np.asarray(wrong.project(rays) - camera.project(rays))


def unturned(camera: Camera, rays: Float[Array, "k 3"], d: Float[Array, "k 2"]) -> Float[Array, "k 2"]:
    """What is left of displacements [px] when the small rotation is taken out that takes most: a boresight has it."""
    A = (camera.project_jacobian(rays) @ hat(rays)).reshape(-1, 3)
    return np.asarray((d.ravel() - A @ np.linalg.lstsq(A, d.ravel())[0]).reshape(-1, 2))
