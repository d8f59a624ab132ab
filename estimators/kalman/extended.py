"""The extended filter: any form in the recursion loop of the 4-D approach (Dickmanns 2007, 6.4.2.3, steps 1-10).

Motion and measurement are given with their analytic Jacobians, as pure functions over any leading axes of runs:

    model = Model(transition, measurement)
    for step in run(form, model, start(form, 0.0, x, P), [(0.1, z1, R), (0.2, z2, R)], gate=4.0):
        step.estimate, step.used, step.nis

The covariance of an estimate is ``form.covariance(estimate.F)``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from estimators.kalman.forms import Form
from estimators.kalman.linear import Correction, check_blocks

Array = np.ndarray


@dataclass(frozen=True)
class Model:
    """What moves, and what is seen of it.

    transition(x, dt): the state x* (..., n) after ``dt`` seconds, its Jacobian A (..., n, n), and the noise of
        variances q (..., s) that enters by G (..., n, s), as (x*, A, G, q).
    measurement(x): the expected measurements h (..., m) and their Jacobian C (..., m, n); NaN where there is none, as
        of a point behind the camera.
    relinearised: every block of correlated measurements has its expectation and Jacobian from the state corrected by
        the blocks before, (6.34), at the price of as many evaluations; otherwise from the predicted state, (6.35).
    """

    transition: Callable[[Array, float], tuple[Array, Array, Array, Array]]
    measurement: Callable[[Array], tuple[Array, Array]]
    relinearised: bool = False


@dataclass(frozen=True, eq=False)
class Estimate:
    """State x (..., n) at time t in s, and its covariance F (..., n, n) in a form's way."""

    t: float
    x: Float[Array, "... n"]
    F: Float[Array, "... n n"]


@dataclass(frozen=True, eq=False)
class Step:
    """An estimate after its measurements: which of them were used (..., m), and their NIS (...)."""

    estimate: Estimate
    used: Bool[Array, "... m"]
    nis: Float[Array, "..."]


def start(form: Form, t: float, x: Float[Array, "... n"], P: Float[Array, "... n n"]) -> Estimate:
    """Steps 1 and 2.

    Raises
        ValueError: x or t is not finite; P is not finite, symmetric and positive definite.
    """
    if not (math.isfinite(t) and np.isfinite(x).all()):
        raise ValueError(f"t, x: expected a finite time and state, got {t}, {x}")
    return Estimate(t, x, form.start(P))


def predict(form: Form, model: Model, estimate: Estimate, t: float) -> Estimate:
    """Steps 4-6, to time t.

    Raises
        ValueError: time runs backwards, or is not finite.
    """
    if not (math.isfinite(t) and t >= estimate.t):
        raise ValueError(f"t: time runs from {estimate.t} s to {t} s; a filter goes forwards, sort what it is given")
    x, A, G, q = model.transition(estimate.x, t - estimate.t)
    return Estimate(t, x, form.predict(estimate.F, A, G, q))


def correct(
    form: Form,
    model: Model,
    estimate: Estimate,
    z: Float[Array, "... m"],
    R: Float[Array, "... k b b"],
    gate: float = math.inf,
) -> Step:
    """Steps 7-10, by measurements z of covariance R, in blocks of b that are correlated.

    What is NaN, or is not expected to be seen, is not used, nor what is beyond the gate, in standard deviations.

    Raises
        ValueError: a block of R is not positive definite; z, R and the model are not of the same length.
    """
    m, b = z.shape[-1], R.shape[-1]
    check_blocks(m, R)
    width = b if model.relinearised else m
    x, F, used, nis = estimate.x, estimate.F, [], np.zeros(z.shape[:-1], z.dtype)
    for first in range(0, m, width):
        rows = slice(first, first + width)
        c = _corrected(form, model, x, F, z, R[..., first // b : (first + width) // b, :, :], rows, gate)
        x, F, nis = c.x, c.F, np.asarray(nis + c.nis)
        used.append(c.used)
    return Step(Estimate(estimate.t, x, F), np.concatenate(used, axis=-1), nis)


def _corrected(
    form: Form, model: Model, x: Array, F: Array, z: Array, R: Array, rows: slice, gate: float
) -> Correction:
    """A correction by some of the measurements, all linearised at x."""
    h, C = model.measurement(x)
    if h.shape[-1] != z.shape[-1]:
        raise ValueError(f"z: expected {h.shape[-1]} measurements, as the model has, got {z.shape[-1]}")
    C = C[..., rows, :]
    dz = np.where(np.isfinite(C).all(axis=-1), z[..., rows] - h[..., rows], np.nan).astype(z.dtype)
    return form.correct(x, F, C, dz, R, gate)


def run(
    form: Form, model: Model, estimate: Estimate, measured: Iterable[tuple[float, Array, Array]], gate: float = math.inf
) -> Iterator[Step]:
    """The loop: prediction and correction for all times t with their measurements z and covariances R, as (t, z, R)."""
    for t, z, R in measured:
        step = correct(form, model, predict(form, model, estimate, t), z, R, gate)
        estimate = step.estimate
        yield step
