"""All forms of the Kalman filter do the same, keep what they promise, and refuse what is no filter's input."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter, rts_smoother
from scipy.linalg import block_diag

from estimators.kalman import FORMS, FormName, smooth, variances

Array = np.ndarray
NAMES = list(FORMS)
ROOTS: list[FormName] = ["potter", "carlson", "udu"]


def covariance(rng: np.random.Generator, *shape: int) -> Array:
    n = shape[-1]
    M = rng.standard_normal((*shape, n))
    return np.asarray(M @ np.swapaxes(M, -1, -2) + 0.1 * np.eye(n))


class Problem:
    """A random linear problem of some runs: n states, m measurements, s noises."""

    def __init__(self, seed: int, runs: tuple[int, ...] = (), n: int = 6, m: int = 8, s: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.x, self.P = rng.standard_normal((*runs, n)), covariance(rng, *runs, n)
        self.A, self.G = np.eye(n) + 0.2 * rng.standard_normal((n, n)), rng.standard_normal((n, s))
        self.q, self.H = rng.uniform(0.1, 1, s), rng.standard_normal((*runs, m, n))
        self.z, self.R = rng.standard_normal((*runs, m)), covariance(rng, m // 2, 2)

    def step(self, name: FormName) -> tuple[Array, Array, Array]:
        """State, covariance and NIS after a prediction and correlated measurements."""
        form = FORMS[name]
        x = self.x @ self.A.T
        F = form.predict(form.start(self.P), self.A, self.G, self.q)
        dz = self.z - (self.H @ x[..., None])[..., 0]
        c = form.correct(x, F, self.H, dz, self.R)
        return c.x, form.covariance(c.F), c.nis


@pytest.mark.parametrize("runs", [(), (4,), (2, 3)])
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("m", [8, 40])
def test_all_forms_agree(seed: int, m: int, runs: tuple[int, ...]) -> None:
    p = Problem(seed, runs, m=m)
    x, P, nis = p.step("plain")
    for name in NAMES[1:]:
        for found, expected in zip(p.step(name), (x, P, nis), strict=True):
            assert np.abs(found - expected).max() < 1e-10 * (1 + np.abs(expected).max()), name


@pytest.mark.parametrize("name", NAMES)
def test_a_filter_agrees_with_filterpy(name: FormName) -> None:
    p = Problem(7)
    peer = KalmanFilter(dim_x=6, dim_z=8)
    peer.x, peer.P, peer.F, peer.H = p.x[:, None].copy(), p.P.copy(), p.A, p.H
    peer.Q, peer.R = (p.G * p.q) @ p.G.T, block_diag(*p.R)
    peer.predict()
    peer.update(p.z[:, None])
    x, P, nis = p.step(name)
    assert np.abs(x - peer.x[:, 0]).max() < 1e-10
    assert np.abs(P - peer.P).max() < 1e-10
    assert abs(nis - float((peer.y.T @ peer.SI @ peer.y).item())) < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_a_filter_agrees_with_one_adjustment_of_all_measurements(name: FormName) -> None:
    """Without system noise the last state is that of a least-squares fit, the start a measurement like the others."""
    rng, form, n, m, steps = np.random.default_rng(3), FORMS[name], 4, 3, 6
    A, P0, x0 = np.eye(n) + 0.1 * rng.standard_normal((n, n)), covariance(rng, n), rng.standard_normal(n)
    H, R = rng.standard_normal((steps, m, n)), rng.uniform(0.5, 2, (steps, m))
    z = rng.standard_normal((steps, m))
    x, F = x0, form.start(P0)
    no_noise = (np.eye(n)[:, :1], np.zeros(1))
    rows, right, weight = [np.eye(n)], [x0], [np.linalg.inv(P0)]
    T = np.eye(n)
    for k in range(steps):
        x, F, T = A @ x, form.predict(F, A, *no_noise), A @ T
        c = form.correct(x, F, H[k], z[k] - H[k] @ x, variances(R[k]))
        x, F = c.x, c.F
        rows.append(H[k] @ T)
        right.append(z[k])
        weight.append(np.diag(1 / R[k]))
    N = sum(a.T @ w @ a for a, w in zip(rows, weight, strict=True))
    b = sum(a.T @ w @ l for a, w, l in zip(rows, weight, right, strict=True))
    assert np.abs(x - T @ np.linalg.solve(N, b)).max() < 1e-10
    assert np.abs(form.covariance(F) - T @ np.linalg.inv(N) @ T.T).max() < 1e-10


@pytest.mark.parametrize("name", NAMES)
def test_what_is_nan_or_far_off_is_left_out(name: FormName) -> None:
    p, form = Problem(1), FORMS[name]
    R, dz = variances(np.full(8, 0.5)), 0.1 * p.z
    clean = np.array([0, 1, 3, 4, 6, 7])
    c = form.correct(p.x, form.start(p.P), p.H[clean], dz[clean], R[clean], gate=5.0)
    assert c.used.all()
    dz[2], dz[5] = np.nan, 1e3
    found = form.correct(p.x, form.start(p.P), p.H, dz, R, gate=5.0)
    assert found.used.tolist() == [True, True, False, True, True, False, True, True]
    assert np.abs(found.x - c.x).max() < 1e-12
    assert np.abs(form.covariance(found.F) - form.covariance(c.F)).max() < 1e-12
    assert abs(found.nis - c.nis) < 1e-10


@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_covariance_is_refused(name: FormName) -> None:
    form, p = FORMS[name], Problem(2)
    with pytest.raises(ValueError, match="P: not positive definite, least eigenvalue -1"):
        form.start(np.diag([1.0, 2, -1, 1, 1, 1]))
    with pytest.raises(ValueError, match="P: expected a finite symmetric matrix"):
        form.start(p.P * np.where(np.eye(6) > 0, np.nan, 1))
    with pytest.raises(ValueError, match="R: block 3 is not positive definite"):
        form.correct(p.x, form.start(p.P), p.H, p.z, variances(np.array([1.0, 1, 1, 0, 1, 1, 1, 1])))
    with pytest.raises(ValueError, match=r"R: expected blocks \(..., k, b, b\) with k b = 8, got \(3, 2, 2\)"):
        form.correct(p.x, form.start(p.P), p.H, p.z, p.R[:3])


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_changed_in_place(name: FormName) -> None:
    form, p = FORMS[name], Problem(4, (3,))
    F = form.start(p.P)
    before = F.copy()
    form.correct(p.x, F, p.H, p.z, variances(np.ones(8)))
    form.predict(F, p.A, p.G, p.q)
    assert np.array_equal(F, before)


@pytest.mark.parametrize("name", ROOTS)
def test_roots_stay_positive_definite_in_single_precision_where_plain_does_not(name: FormName) -> None:
    """The source's range: a variance of 1e6 m², measured to 1e-4 (6.4.6), along nearly one direction."""
    kind = np.float32
    H = np.array([[1, 1, 1], [1, 1, 1.001], [1, 1.001, 1]], kind)
    R, x, P = variances(np.full(3, 1e-4, kind)), np.zeros(3, kind), np.eye(3, dtype=kind) * kind(1e6)

    def least(form_name: FormName) -> float:
        """Least eigenvalue after fifty corrections, in units of the largest; P is looked at in double precision."""
        form = FORMS[form_name]
        F = form.start(P)
        for _ in range(50):
            F = form.correct(x, F, H, np.zeros(3, kind), R).F
        assert F.dtype == kind
        values = np.linalg.eigvalsh(form.covariance(F.astype(float)))
        return float(values[0] / values[-1])

    assert least(name) > 0
    assert not least("plain") > 0


@pytest.mark.parametrize("name", ROOTS)
def test_a_weak_measurement_does_not_drown_in_strong_ones(name: FormName) -> None:
    """One direction measured 1e6 times better than the other: in single precision the other keeps its variance.

    Rounding of the strong rows leaves 4e-4 of error; all rows compressed by one orthogonal transformation, 2.5e-3.
    """
    kind, form, rng = np.float32, FORMS[name], np.random.default_rng(0)
    rows = np.repeat(np.array([[1, 0.7], [0.7, -1]]), 5, axis=0)
    H = (rows * rng.uniform(0.5, 1.5, (10, 1))).astype(kind)
    sigma = np.repeat(np.array([1e-6, 1], kind), 5)
    c = form.correct(np.zeros(2, kind), form.start(np.eye(2, dtype=kind) * 100), H, 0 * sigma, variances(sigma**2))
    P = form.covariance(c.F.astype(float))
    weak = np.array([0.7, -1]) / np.hypot(0.7, 1)
    expected = 1 / (0.01 + np.sum((H[5:].astype(float) @ weak) ** 2))
    assert abs(weak @ P @ weak / expected - 1) < 1e-3
    assert np.linalg.eigvalsh(P)[0] > 0


@pytest.mark.parametrize("name", NAMES)
def test_many_measurements_are_compressed_without_loss(name: FormName) -> None:
    """As with a gate so wide that it lets all pass, which uses one scalar after the other, and as without what is NaN.

    Two of the states are not measured at all.
    """
    form, p = FORMS[name], Problem(6, (3,), m=60)
    H, F = p.H * np.array([1, 0, 1, 1, 0, 1]), form.start(p.P)
    dz = p.z.copy()
    dz[:, 7] = np.nan
    whole, one_by_one = (form.correct(p.x, F, H, dz, p.R, gate) for gate in (np.inf, 1e6))
    without = form.correct(p.x, F, np.delete(H, [6, 7], 1), np.delete(p.z, [6, 7], 1), np.delete(p.R, 3, 0))
    assert (~whole.used).nonzero()[1].tolist() == [6, 7] * 3
    assert np.array_equal(whole.used, one_by_one.used)
    for other in (one_by_one, without):
        assert np.abs(whole.x - other.x).max() < 1e-11
        assert np.abs(form.covariance(whole.F) - form.covariance(other.F)).max() < 1e-11
        assert np.abs(whole.nis / other.nis - 1).max() < 1e-11


@pytest.mark.parametrize("name", ["sequential", "potter", "carlson", "udu"])
def test_runs_may_share_what_is_the_same(name: FormName) -> None:
    form, p = FORMS[name], Problem(8, m=20)
    x, z = p.x + np.arange(6)[:, None].reshape(2, 3, 1), np.tile(p.z, (2, 3, 1))
    shared = form.correct(x, form.start(p.P), p.H, z, p.R)
    F = np.broadcast_to(form.start(p.P), (2, 3, 6, 6))
    own = form.correct(x, F, np.broadcast_to(p.H, (2, 3, 20, 6)), z, np.broadcast_to(p.R, (2, 3, 10, 2, 2)))
    assert np.array_equal(shared.x, own.x)
    assert np.array_equal(shared.F, own.F)
    assert shared.used.shape == (2, 3, 20)
    assert shared.nis.shape == (2, 3)


def test_the_smoother_agrees_with_filterpy() -> None:
    p, form, steps = Problem(5, n=4, m=2, s=4), FORMS["joseph"], 7
    rng = np.random.default_rng(1)
    H, R, Q = p.H, variances(np.ones(2)), (p.G * p.q) @ p.G.T
    x, F = p.x, form.start(p.P)
    states, filtered, predicted, difference = [], [], [], []
    for _ in range(steps):
        x_predicted, F = p.A @ x, form.predict(F, p.A, p.G, p.q)
        predicted.append(F)
        c = form.correct(x_predicted, F, H, rng.standard_normal(2) - H @ x_predicted, R)
        x, F = c.x, c.F
        states.append(x)
        filtered.append(F)
        difference.append(x - x_predicted)
    found = smooth(np.array(difference), np.array(filtered), np.array([p.A] * steps), np.array(predicted))
    X, P, _, _ = rts_smoother(np.array(states), np.array(filtered), [p.A] * steps, [Q] * steps)
    assert np.abs(np.array(states) + found.dx - X).max() < 1e-10
    assert np.abs(found.P - P).max() < 1e-10
