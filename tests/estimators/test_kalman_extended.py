"""The extended filter: a car seen by a radar in range, bearing and range rate, as one recursion over any form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.kalman import FORMS, FormName, extended, variances
from estimators.kalman.extended import Model

Array = np.ndarray
NAMES = list(FORMS)
NOISE, SIGMA = 0.3, np.array([0.5, 0.02, 0.1])
P0 = np.diag([4.0, 4, 1, 1])


def transition(x: Array, dt: float) -> tuple[Array, Array, Array, Array]:
    """Constant velocity; white acceleration of spectral density NOISE², piecewise constant."""
    A = np.eye(4) + dt * np.eye(4, k=2)
    G = np.concatenate([dt**2 / 2 * np.eye(2), dt * np.eye(2)])
    return (A @ x[..., None])[..., 0], A, G, np.full(2, NOISE**2)


def measurement(x: Array) -> tuple[Array, Array]:
    """Range, bearing, range rate."""
    p, v = x[..., :2], x[..., 2:]
    r = np.linalg.norm(p, axis=-1)
    e = p / r[..., None]
    rate = np.sum(e * v, axis=-1)
    across = np.stack([-e[..., 1], e[..., 0]], axis=-1) / r[..., None]
    zero = np.zeros_like(p)
    C = np.stack(
        [
            np.concatenate([e, zero], axis=-1),
            np.concatenate([across, zero], axis=-1),
            np.concatenate([(v - rate[..., None] * e) / r[..., None], e], axis=-1),
        ],
        axis=-2,
    )
    return np.stack([r, np.arctan2(p[..., 1], p[..., 0]), rate], axis=-1), C


RADAR = Model(transition, measurement)


def drives(runs: int, steps: int, dt: float = 0.2) -> tuple[Array, Array, list[tuple[float, Array, Array]]]:
    """Truth (steps, r, 4), start (r, 4) wrong by P0, and the measurements of every time."""
    rng = np.random.default_rng(4)
    x = np.array([30.0, 5, -4, 2]) + rng.standard_normal((runs, 4))
    start = x + np.sqrt(P0.diagonal()) * rng.standard_normal((runs, 4))
    truth, measured = [], []
    for k in range(1, steps + 1):
        x, _, G, q = transition(x, dt)
        x = x + (rng.standard_normal((runs, 2)) * np.sqrt(q)) @ G.T
        truth.append(x)
        measured.append((k * dt, measurement(x)[0] + SIGMA * rng.standard_normal((runs, 3)), variances(SIGMA**2)))
    return np.array(truth), start, measured


@pytest.mark.parametrize("seed", range(5))
def test_jacobians_are_those_of_numerical_differences(seed: int) -> None:
    """Central differences of 1e-5: their error is 1e-10 of the third derivatives, rounding 1e-15 * 50 / 1e-5."""
    x = np.array([20.0, 5, -4, 2]) + np.random.default_rng(seed).standard_normal(4)
    step = 1e-5 * np.eye(4)
    C = (measurement(x + step)[0] - measurement(x - step)[0]).T / 2e-5
    A = (transition(x + step, 0.2)[0] - transition(x - step, 0.2)[0]).T / 2e-5
    assert np.abs(C - measurement(x)[1]).max() < 1e-8
    assert np.abs(A - transition(x, 0.2)[1]).max() < 1e-8


@pytest.mark.parametrize("name", NAMES)
def test_errors_and_innovations_are_as_large_as_the_filter_says(name: FormName) -> None:
    """Mean NEES and NIS of 200 runs inside their 99.9 % bands once settled."""
    form, runs = FORMS[name], 200
    truth, x, measured = drives(runs, 15)
    first = extended.start(form, 0.0, x, np.broadcast_to(P0, (runs, 4, 4)))
    *_, last = extended.run(form, RADAR, first, measured)
    error = truth[-1] - last.estimate.x
    P = form.covariance(last.estimate.F)
    nees = np.einsum("ri,rij,rj->r", error, np.linalg.inv(P), error)
    assert last.used.all()
    for mean, freedom in ((nees.mean(), 4), (last.nis.mean(), 3)):
        low, high = (chi2.ppf(p, freedom * runs) / runs for p in (0.0005, 0.9995))
        assert low < mean < high
    assert last.estimate.t == measured[-1][0]


@pytest.mark.parametrize("relinearised", [False, True])
def test_all_forms_agree_over_a_run(relinearised: bool) -> None:
    truth, x, measured = drives(3, 10)
    model = replace(RADAR, relinearised=relinearised)
    found = []
    for form in FORMS.values():
        first = extended.start(form, 0.0, x, np.broadcast_to(P0, (3, 4, 4)))
        *_, last = extended.run(form, model, first, measured)
        found.append((last.estimate.x, form.covariance(last.estimate.F), last.nis))
    for other in found[1:]:
        for a, b in zip(other, found[0], strict=True):
            assert np.abs(a - b).max() < 1e-9
    assert np.abs(found[0][0] - truth[-1]).max() < 3


def test_relinearised_measurements_are_nearer_after_a_start_far_off() -> None:
    """A start 10 m off at 30 m: a fifth or more of the error goes where the bearing is linearised after the range."""
    rng, form, runs = np.random.default_rng(2), FORMS["udu"], 2000
    x = np.tile([30.0, 5, -4, 2], (runs, 1))
    P = np.diag([100.0, 100, 1, 1])
    start = x + np.sqrt(P.diagonal()) * rng.standard_normal((runs, 4))
    sigma = np.array([0.01, 0.001, 0.1])
    z = measurement(x)[0] + sigma * rng.standard_normal((runs, 3))
    rms = []
    for relinearised in (False, True):
        model = replace(RADAR, relinearised=relinearised)
        first = extended.start(form, 0.0, start, np.broadcast_to(P, (runs, 4, 4)))
        step = extended.correct(form, model, first, z, variances(sigma**2))
        rms.append(np.sqrt(np.mean((step.estimate.x - x)[:, :2] ** 2)))
    assert rms[1] < 0.8 * rms[0], rms


@pytest.mark.parametrize("relinearised", [False, True])
def test_linear_measurements_need_no_relinearisation(relinearised: bool) -> None:
    rng, form = np.random.default_rng(3), FORMS["udu"]
    C, z = rng.standard_normal((6, 4)), rng.standard_normal(6)
    R = np.array([[[1, 0.5], [0.5, 1]]] * 3)
    first = extended.start(form, 0.0, np.zeros(4), P0)
    expected = form.correct(first.x, first.F, C, z, R)
    linear = Model(transition, lambda x: (C @ x, C), relinearised)
    found = extended.correct(form, linear, first, z, R)
    assert np.abs(found.estimate.x - expected.x).max() < 1e-12
    assert abs(found.nis - expected.nis) < 1e-12


@pytest.mark.parametrize("name", NAMES)
def test_what_is_not_seen_or_expected_is_left_out_and_counted(name: FormName) -> None:
    """A bearing that is NaN, a range rate that is infinite, a range that the model does not expect."""
    form = FORMS[name]
    _, x, measured = drives(1, 1)
    t, z, R = measured[0]
    first = extended.predict(form, RADAR, extended.start(form, 0.0, x[0], P0), t)
    cut = extended.correct(form, RADAR, first, np.array([z[0, 0], np.nan, np.inf]), R)
    assert cut.used.tolist() == [True, False, False]

    def behind(x: Array) -> tuple[Array, Array]:
        h, C = measurement(x)
        return h, np.where(np.arange(3)[:, None] == 0, np.nan, C)

    nothing = extended.correct(form, Model(transition, behind), first, np.array([z[0, 0], np.nan, np.nan]), R)
    assert not nothing.used.any()
    assert nothing.nis == 0
    assert np.array_equal(nothing.estimate.x, first.x)
    assert np.abs(form.covariance(nothing.estimate.F) - form.covariance(first.F)).max() < 1e-12


def test_what_no_filter_can_do_is_refused() -> None:
    form = FORMS["udu"]
    first = extended.start(form, 2.0, np.array([20.0, 5, -4, 2]), P0)
    z, R = np.array([20.0, 0.2, -3]), variances(SIGMA**2)
    for t in (1.9, np.nan, np.inf):
        with pytest.raises(ValueError, match=rf"t: time runs from 2\.0 s to {t} s; a filter goes forwards"):
            extended.predict(form, RADAR, first, t)
    with pytest.raises(ValueError, match="P: not positive definite, least eigenvalue -1"):
        extended.start(form, 0.0, first.x, np.diag([1.0, 1, 1, -1]))
    with pytest.raises(ValueError, match="t, x: expected a finite time and state"):
        extended.start(form, 0.0, first.x * np.nan, P0)
    with pytest.raises(ValueError, match="R: block 1 is not positive definite"):
        extended.correct(form, RADAR, first, z, variances(np.array([1.0, 0, 1])))
    with pytest.raises(ValueError, match="z: expected 3 measurements, as the model has, got 2"):
        extended.correct(form, RADAR, first, z[:2], R[:2])


def test_the_same_time_again_adds_no_noise() -> None:
    form = FORMS["udu"]
    first = extended.start(form, 2.0, np.array([20.0, 5, -4, 2]), P0)
    again = extended.predict(form, RADAR, first, 2.0)
    assert np.array_equal(again.x, first.x)
    assert np.abs(form.covariance(again.F) - P0).max() < 1e-12
