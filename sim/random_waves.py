"""Stationary Gaussian processes as sums of random waves: any time can be asked for alone, at any rate.

``x(t) = sigma sqrt(2/n) sum cos(omega_i t + phi_i)`` with frequencies drawn from the spectrum, one in each of n parts
of equal power, and uniform phases (Shinozuka and Deodatis 1991): mean square sigma², autocorrelation the spectrum's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from sim.archive import freeze

Array = np.ndarray
_WAVES = 256


@dataclass(frozen=True, eq=False)
class RandomWaves:
    """One process: its standard deviation, angular frequencies [rad/s] and phases [rad] (n,)."""

    sigma: float
    omega: Float[Array, "n"]
    phase: Float[Array, "n"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "omega", freeze(np.asarray(self.omega, float)))
        object.__setattr__(self, "phase", freeze(np.asarray(self.phase, float)))

    @staticmethod
    def dryden(rng: np.random.Generator, sigma: float, correlation_s: float, cutoff_hz: float) -> RandomWaves:
        """Dryden's transverse gusts, ``S(x) ~ (1 + 3 x²)/(1 + x²)²`` with x = omega correlation_s = omega L / V.

        Cut off where the aircraft no longer follows; without a cutoff the autocorrelation is exp(-t/T)(1 - t/2T).
        """
        if not (correlation_s > 0 and cutoff_hz > 0):
            raise ValueError(f"dryden: expected positive correlation_s and cutoff_hz, got {correlation_s}, {cutoff_hz}")
        # With x = tan(a) the cumulated spectrum is 2 a - sin(a) cos(a).
        a = np.linspace(0, np.arctan(2 * np.pi * cutoff_hz * correlation_s), 4097)
        power = 2 * a - np.sin(a) * np.cos(a)
        x = np.tan(np.interp(_strata(rng) * power[-1], power, a))
        return RandomWaves(sigma, x / correlation_s, rng.uniform(0, 2 * np.pi, _WAVES))

    @staticmethod
    def band(rng: np.random.Generator, sigma: float, low_hz: float, high_hz: float) -> RandomWaves:
        """White between two frequencies, nothing outside."""
        if not 0 <= low_hz < high_hz:
            raise ValueError(f"band: expected 0 <= low_hz < high_hz, got {low_hz}, {high_hz}")
        omega = 2 * np.pi * (low_hz + _strata(rng) * (high_hz - low_hz))
        return RandomWaves(sigma, omega, rng.uniform(0, 2 * np.pi, _WAVES))

    def __call__(self, t_s: ArrayLike) -> Float[Array, "*b"]:
        """Values at times of any shape."""
        t = np.asarray(t_s, float)
        out = np.zeros(t.shape)
        if self.sigma == 0:
            return out
        for omega, phase in zip(self.omega, self.phase, strict=True):
            out += np.cos(omega * t + phase)
        return np.asarray(self.sigma * np.sqrt(2 / len(self.omega)) * out)


def _strata(rng: np.random.Generator) -> Array:
    """One uniform number in each n-th of (0, 1)."""
    return (np.arange(_WAVES) + rng.uniform(size=_WAVES)) / _WAVES
