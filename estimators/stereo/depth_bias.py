"""How triangulated points are weighted, and the systematic depth error that follows: Siegemund 2008, 4.1.2-4.1.3.

Weights from the observed points pull the object towards the camera (points seen too near count too much); weights from
the estimated points leave the bias of triangulation, which the second-order terms take away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from estimators.stereo.kernel import FAR_M, NEAR_M, Tiles, fill_fixed, fill_seen
from estimators.stereo.triangulation import information, second_order_bias
from sim.camera import StereoRig

Array = np.ndarray
Weights = Literal["observed", "averaged", "estimated"]


def averaged_covariance(C: Float[Array, "k 3 3"]) -> Float[Array, "k 3 3"]:
    """Covariances with the eigenvalues averaged over the window and their own eigenvectors, (4.1.16)-(4.1.18)."""
    values, V = np.linalg.eigh(C)
    return np.asarray((V * values.mean(axis=0)) @ np.swapaxes(V, 1, 2))


@dataclass(frozen=True, eq=False)
class ObservationModel:
    """What the adjustment takes for observed, and with which weight, at points Y: plain data.

    l (k, 3) triangulated points; W_uv (k, 4, 4) weights of the image coordinates [1/px²] of ``rig``, whose cameras have
    no distortion; W (k, 3, 3) weights that stay, None where they follow the points ("estimated").
    """

    rig: StereoRig
    l: Float[Array, "k 3"]
    W_uv: Float[Array, "k 4 4"]
    W: Float[Array, "k 3 3"] | None
    second_order: bool

    def __call__(self, Y: Float[Array, "k 3"]) -> tuple[Float[Array, "k 3"], Float[Array, "k 3 3"]]:
        """Corrected observations and weights at the current points Y; where Y is not in front of the cameras at the
        observed place.

        The definition; `kernel.fill_seen` and `kernel.reweight` compute the same.
        """
        place = self.l
        if self.W is None:
            depth_r = self.rig.T_rl.apply(Y)[:, 2]
            good = np.isfinite(Y).all(axis=1) & (Y[:, 2] > NEAR_M) & (depth_r > NEAR_M) & (Y[:, 2] < FAR_M)
            place = np.where(good[:, None], Y, self.l)
        W = information(self.rig, place, self.W_uv) if self.W is None else self.W
        observed = self.l - second_order_bias(self.rig, place, self.W_uv) if self.second_order else self.l
        return observed, W

    def fill(self, tiles: Tiles) -> None:
        """Lays the observations into the tiles of their window."""
        if self.W is None:
            K = np.stack([self.rig.left.K[:2, :2], self.rig.right.K[:2, :2]])
            fill_seen(tiles, self.l, self.W_uv, K)
        else:
            fill_fixed(tiles, self(self.l)[0], self.W)

    def select(self, rows: Bool[Array, "k"] | Int[Array, "r"]) -> ObservationModel:
        """The model of some observations; averaged weights stay what they are."""
        W = None if self.W is None else self.W[rows]
        return replace(self, l=self.l[rows], W_uv=self.W_uv[rows], W=W)


def observation_model(
    rig: StereoRig,
    l: Float[Array, "k 3"],
    C: Float[Array, "k 3 3"],
    W_uv: Float[Array, "k 4 4"],
    weights: Weights,
    second_order: bool,
) -> ObservationModel:
    """The model of triangulated points l with the covariance C at the observed place.

    "observed" and "averaged" weights come from C; "estimated" ones are evaluated at the current points before every
    iteration (4.1.3.3).

    Raises
        ValueError: a camera is distorted; `triangulation.undistorted` takes that off beforehand.
    """
    if rig.left.is_distorted or rig.right.is_distorted:
        raise ValueError("rig: expected cameras without distortion; use triangulation.undistorted")
    W = None if weights == "estimated" else np.linalg.inv(C if weights == "observed" else averaged_covariance(C))
    return ObservationModel(rig, l, W_uv, W, second_order)
