"""Detection before the adjustment from the largest extent of the object, Siegemund 2008, 3.4.2.1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from estimators.gauss_markov import sum_by
from estimators.stereo.triangulation import FAR_M, information
from sim.camera import StereoRig

Array = np.ndarray


@dataclass(frozen=True)
class PriorKnowledge:
    """A track with a point farther from the cloud's centroid than S = S_0 + 2 sigma_Z is an outlier, (3.4.1)-(3.4.3).

    extent_m: S_0, the largest extent of the object. sigma_Z is that of a point on the optical axis at the distance of
    the centroid plus S_0: its projections (3.4.1), (3.4.2), the covariance of their triangulation.
    """

    extent_m: float = 5.0

    def threshold(self, rig: StereoRig, cov: Float[Array, "4 4"], distance_m: Float[Array, "m"]) -> Float[Array, "m"]:
        """S for centroids at these distances; cov of the image coordinates of a point [px²]."""
        p = np.multiply.outer(np.minimum(distance_m + self.extent_m, FAR_M), [0.0, 0.0, 1.0])
        C = np.linalg.inv(information(rig, p, np.tile(np.linalg.inv(cov), (len(p), 1, 1))))
        return np.asarray(self.extent_m + 2 * np.sqrt(C[:, 2, 2]))

    def __call__(
        self,
        rig: StereoRig,
        cov: Float[Array, "k 4 4"],
        frame: Int[Array, "k"],
        point: Int[Array, "k"],
        l: Float[Array, "k 3"],
    ) -> Bool[Array, "n"]:
        """Which tracks are inliers: frame (k,) in 0..m-1, point (k,) in 0..n-1, triangulated points l (k, 3).

        The centroid is that of all tracks in the frame, outliers included, as in the source.
        """
        m, n = int(frame.max()) + 1, int(point.max()) + 1
        centroid = sum_by(frame, l, m) / np.maximum(np.bincount(frame, minlength=m), 1)[:, None]
        S = self.threshold(rig, cov.mean(axis=0), np.linalg.norm(centroid, axis=1))
        far = np.linalg.norm(l - centroid[frame], axis=1) > S[frame]
        return np.asarray(np.bincount(point, far, n) == 0)
