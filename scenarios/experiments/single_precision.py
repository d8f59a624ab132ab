"""Which forms of the Kalman filter survive single precision, over the range of variances (Dickmanns 2007, 6.4.6).

The source names two causes of negative eigenvalues: measurements that are very good beside P*(0), and states that are
observed very differently well; its example has variances of 10^6 m² and 10^-4 rad², a range of 10^10.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from estimators.kalman import FORMS, Form, variances
from scenarios.experiments.steps import check_range, check_steps
from sim.streams import stream

Array = np.ndarray
_AXES = 3
_REFERENCE = FORMS["udu"]
# Why a form has no covariance any more: it refuses to go on, or nothing finite is left.
_BROKEN = (ValueError, np.linalg.LinAlgError)


class _Problem(NamedTuple):
    """Transition, noise input and its variances, P*(0), Jacobians (steps, m, n) and measurements (steps, m).

    All are rounded to single precision, so that both precisions solve the same problem.
    """

    A: Array
    G: Array
    q: Array
    P: Array
    H: Array
    z: Array

    def cast(self, dtype: type) -> _Problem:
        return _Problem(*(a.astype(dtype) for a in self))


class _Estimate(NamedTuple):
    x: Array
    P: Array


@dataclass(frozen=True)
class SinglePrecision:
    """A point in space with constant velocity, measured along random directions with variance 1; all forms."""

    range: float = 1e10
    """Variance of the start position over that of a measurement."""
    spread: float = 1.0
    """Variance of the start position over that of the start velocity, per step."""
    noise: float = 0.0
    """Variance that a step adds to the velocity, over that of a measurement."""
    measurements: int = 2
    """Scalar measurements of every step, each along a random direction."""
    steps: tuple[int, ...] = (1, 3, 10, 30, 100)
    """Numbers of steps after which the forms are compared."""

    def __post_init__(self) -> None:
        for name in ("range", "spread"):
            check_range(name, getattr(self, name), 1, 1e14)
        check_range("noise", self.noise, 0, 1e14)
        check_range("measurements", self.measurements, 1, 100)
        check_steps(self.steps)

    @property
    def cases(self) -> tuple[str, ...]:
        """The forms."""
        return tuple(FORMS)

    def __call__(self, seed: int, run: int) -> pd.DataFrame:
        """Rows of every form after the steps asked for.

        lost: whether the covariance was not positive definite after any step so far. least_variance: smallest ratio,
        over all directions of state space, of a variance to the one in double precision: 1 exact, negative lost.
        covariance_error: largest relative error of a variance. state_error: distance of the states in standard
        deviations of double precision. The last three infinite where nothing finite is left.
        """
        problem = self._problem(seed, run)
        reference = list(_filtered(_REFERENCE, problem))
        rows = []
        for name, form in FORMS.items():
            found = _filtered(form, problem.cast(np.float32))
            rows += [(name, *row) for row in self._compared(found, reference)]
        return pd.DataFrame(rows, columns=["estimator", "quantity", "t_s", "value"])

    def _problem(self, seed: int, run: int) -> _Problem:
        rng = stream(seed, run, "single_precision/problem")
        steps, n = self.steps[-1], 2 * _AXES
        A = np.eye(n) + np.eye(n, k=_AXES)
        G = np.eye(n)[:, _AXES:]
        H = np.zeros((steps, self.measurements, n))
        H[..., :_AXES] = rng.standard_normal((steps, self.measurements, _AXES))
        H /= np.linalg.norm(H, axis=-1, keepdims=True)
        P = np.diag(np.repeat([self.range, self.range / self.spread], _AXES))
        x = np.sqrt(P.diagonal()) * rng.standard_normal(n)
        noise = np.sqrt(self.noise) * rng.standard_normal((steps, _AXES))
        error = rng.standard_normal((steps, self.measurements))
        z = np.empty((steps, self.measurements))
        for k in range(steps):
            x = A @ x + G @ noise[k]
            z[k] = H[k] @ x + error[k]
        return _Problem(A, G, np.full(_AXES, self.noise), P, H, z).cast(np.float32).cast(np.float64)

    def _compared(
        self, found: Iterator[_Estimate | None], reference: list[_Estimate | None]
    ) -> Iterator[tuple[str, int, float]]:
        lost = False
        for k, true in enumerate(reference, 1):
            estimate = next(found, None)
            assert true is not None
            ratios = np.full(1, np.nan) if estimate is None else _ratios(estimate.P, true.P)
            lost |= not ratios.min() > 0
            if k in self.steps:
                yield "lost", k, float(lost)
                finite = estimate is not None and bool(np.isfinite(ratios).all() and np.isfinite(estimate.x).all())
                yield "least_variance", k, float(ratios.min()) if finite else -np.inf
                yield "covariance_error", k, float(np.abs(ratios - 1).max()) if finite else np.inf
                yield "state_error", k, _distance(estimate.x - true.x, true.P) if estimate and finite else np.inf


def _filtered(form: Form, p: _Problem) -> Iterator[_Estimate | None]:
    """State and covariance, in double precision, after every step; None as soon as the form refuses to go on."""
    x = np.zeros(len(p.A), p.A.dtype)
    R = variances(np.ones(p.z.shape[-1], p.A.dtype))
    with np.errstate(all="ignore"):
        try:
            F = form.start(p.P)
            for H, z in zip(p.H, p.z, strict=True):
                x, F = p.A @ x, form.predict(F, p.A, p.G, p.q)
                c = form.correct(x, F, H, z - H @ x, R)
                x, F = c.x, c.F
                yield _Estimate(x.astype(np.float64), form.covariance(F.astype(np.float64)))
        except _BROKEN:
            yield None


def _ratios(P: Array, reference: Array) -> Array:
    """Variances over those of a reference: the eigenvalues of P in its own axes; NaN where P is not finite."""
    if not np.isfinite(P).all():
        return np.full(len(P), np.nan)
    L = np.linalg.cholesky(reference)
    whitened = np.linalg.solve(L, np.linalg.solve(L, (P + P.T) / 2).T)
    return np.linalg.eigvalsh((whitened + whitened.T) / 2)


def _distance(dx: Array, P: Array) -> float:
    """Length of a difference of states in standard deviations."""
    return float(np.linalg.norm(np.linalg.solve(np.linalg.cholesky(P), dx)))
