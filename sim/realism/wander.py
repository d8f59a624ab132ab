"""Smooth random functions of time and place that any frame can ask for alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

Array = np.ndarray
_WAVES = 16


@dataclass(frozen=True, eq=False)
class Wander:
    """A stationary Gaussian process of unit variance, correlation ``exp(-(dt/tau)²/2 - |dx|²/(2 lam²))``.

    Random waves (Rahimi and Recht 2007): ``sqrt(2/n) sum cos(omega t + k x + phi)``.
    """

    omega: Float[Array, "n"]
    k: Float[Array, "n 2"]
    phi: Float[Array, "n"]

    @staticmethod
    def draw(rng: np.random.Generator, tau_s: float, lam: float = np.inf) -> Wander:
        return Wander(
            rng.standard_normal(_WAVES) / tau_s,
            rng.standard_normal((_WAVES, 2)) / lam,
            rng.uniform(0, 2 * np.pi, _WAVES),
        )

    def at(self, t_s: float, x: ArrayLike = (0.0, 0.0)) -> Float[Array, "*b"]:
        """Value at a time and places (..., 2)."""
        phase = self.omega * t_s + self.phi + np.asarray(x, float) @ self.k.T
        return np.asarray(np.sqrt(2 / _WAVES) * np.cos(phase).sum(axis=-1))
