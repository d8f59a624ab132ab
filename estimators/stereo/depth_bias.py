"""How triangulated points are weighted, and the systematic depth error that follows: Siegemund 2008, 4.1.2-4.1.3.

Weights from the observed points pull the object towards the camera (points seen too near count too much); weights from
the estimated points leave the bias of triangulation, which the second-order terms take away.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Float

from estimators.stereo.triangulation import FAR_M, information, second_order_bias
from sim.camera import StereoRig

Array = np.ndarray
Weights = Literal["observed", "averaged", "estimated"]


def averaged_covariance(C: Float[Array, "k 3 3"]) -> Float[Array, "k 3 3"]:
    """Covariances with the eigenvalues averaged over the window and their own eigenvectors, (4.1.16)-(4.1.18)."""
    values, V = np.linalg.eigh(C)
    return np.asarray((V * values.mean(axis=0)) @ np.swapaxes(V, 1, 2))


def observation_model(
    rig: StereoRig,
    l: Float[Array, "k 3"],
    C: Float[Array, "k 3 3"],
    W_uv: Float[Array, "k 4 4"],
    weights: Weights,
    second_order: bool,
) -> Callable[[Array], tuple[Array, Array]]:
    """The function ``Y -> (corrected observations, weights)`` of `object_motion.Problem`.

    l, C triangulated points and their covariance at the observed place; W_uv (k, 4, 4) weights of the image
    coordinates [1/px²]. "estimated" evaluates both at the current points Y, before every iteration (4.1.3.3);
    where Y is not in front of the cameras the observed place serves.
    """
    if weights != "estimated":
        W = np.linalg.inv(C if weights == "observed" else averaged_covariance(C))
        corrected = l - second_order_bias(rig, l, W_uv) if second_order else l
        return lambda _: (corrected, W)

    def model(Y: Array) -> tuple[Array, Array]:
        in_front = np.isfinite(Y).all(axis=1) & (Y[:, 2] > 0.1) & (rig.T_rl.apply(Y)[:, 2] > 0.1) & (Y[:, 2] < FAR_M)
        place = np.where(in_front[:, None], Y, l)
        return l - second_order_bias(rig, place, W_uv) if second_order else l, information(rig, place, W_uv)

    return model
