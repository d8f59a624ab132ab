"""The smoother of Rauch, Tung and Striebel: what all measurements say of every state, backwards over a filter's run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Smoothed:
    """States dx (k, ..., n) as corrections of the filtered ones, and covariances P (k, ..., n, n)."""

    dx: Float[Array, "k ... n"]
    P: Float[Array, "k ... n n"]


def smooth(
    difference: Float[Array, "k ... n"],
    P: Float[Array, "k ... n n"],
    A: Float[Array, "k ... n n"],
    P_predicted: Float[Array, "k ... n n"],
) -> Smoothed:
    """C = P A' P*^-1; dx_k = C (d_k+1 + dx_k+1), P_k + C (P_k+1 - P*_k+1) C' from the last time backwards.

    At each time: the filtered covariance P, the transition A and the covariance predicted from the time before, and
    ``difference`` d, filtered minus predicted state; A, d and the prediction of the first time are not used. States are
    corrections, so that those on a manifold need no sum.
    """
    dx, smoothed = np.zeros_like(difference), np.array(P)
    for k in range(len(P) - 2, -1, -1):
        C = np.swapaxes(np.linalg.solve(P_predicted[k + 1], A[k + 1] @ P[k]), -1, -2)
        dx[k] = (C @ (difference[k + 1] + dx[k + 1])[..., None])[..., 0]
        rest = P[k] + C @ (smoothed[k + 1] - P_predicted[k + 1]) @ np.swapaxes(C, -1, -2)
        smoothed[k] = (rest + np.swapaxes(rest, -1, -2)) / 2
    return Smoothed(dx, smoothed)
