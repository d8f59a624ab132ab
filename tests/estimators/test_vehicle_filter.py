"""The vehicle filter: exact where there is no noise, honest where there is, and its failures as values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.estimate import EstimationFailed, TrajectoryEstimate
from estimators.kalman import FORMS, FormName
from estimators.stereo.filter_state import Noise, State, transition
from estimators.stereo.vehicle_filter import VehicleFilter
from sim.pose import Pose, exp_so3

Array = np.ndarray
Maker = Callable[..., Any]
TWIST = np.array([0.01, 0.3, -0.02, 1.0, 0.1, -10.0])  # in camera axes: the object turns left and comes closer


def ctrv(make_scene: Maker, turn: float = 1.0, **kind: Any) -> Any:
    """A scene in which the filter's model holds exactly."""
    scene = make_scene(**kind)
    twist = TWIST * np.array([turn] * 3 + [1.0] * 3)
    return replace(scene, T_co=scene.T_co[0] @ Pose.exp(np.multiply.outer(scene.t_s, twist)))


def state(points: int = 3) -> State:
    rng = np.random.default_rng(5)
    T = Pose(exp_so3(rng.normal(0, 1, 3)), rng.normal(0, 10, 3))
    k = np.arange(points)
    return State(T, rng.normal(0, [0.1, 0.1, 0.8, 12, 1, 0.3]), rng.normal(0, 1, (points, 3)), k, k)


def test_errors_put_on_and_taken_off() -> None:
    s, d = state(), np.random.default_rng(1).normal(0, 0.3, 21)
    np.testing.assert_allclose(s.plus(d).minus(s), d, atol=1e-12)


@pytest.mark.parametrize("dt_s", [0.04, -0.1, 0.5])
def test_the_transition_is_the_derivative_of_the_motion(dt_s: float) -> None:
    s, h = state(0), 1e-6
    steps = np.eye(12) * h
    found = [(s.plus(d).moved(dt_s).minus(s.plus(-d).moved(dt_s))) / (2 * h) for d in steps]
    np.testing.assert_allclose(np.stack(found, axis=1), transition(s.twist, dt_s), atol=1e-7)


def test_noise_does_not_depend_on_the_frame_rate() -> None:
    """Two half steps add up to a whole one, but for what the twist turns meanwhile (none, here)."""
    s = State(Pose.identity(), np.zeros(6), np.empty((0, 3)), np.empty(0, int), np.empty(0, int))
    noise, up = Noise(3.0, 1.0, 0.3, 0.5, 0.1), np.array([0.0, 0, 1])

    def Q(dt_s: float) -> Array:
        G, q = noise.inputs(s, up, dt_s)
        return np.asarray(G * q @ G.T)

    A = transition(s.twist, 0.1)
    np.testing.assert_allclose(Q(0.2), A @ Q(0.1) @ A.T + Q(0.1), atol=1e-12)


@pytest.mark.parametrize("rig", ["normal", "general"])
@pytest.mark.parametrize(("turn", "tolerance_m"), [(0.0, 1e-7), (1.0, 3e-4)])
def test_without_noise_it_is_exact(make_scene: Maker, rig: str, turn: float, tolerance_m: float) -> None:
    """But for the first step's turn, taken as linear: (0.3 rad/s 0.04 s)² / 2 on a lever of 2.4 m is 0.17 mm."""
    scene = ctrv(make_scene, turn, points=40, frames=12, rig=rig)
    estimate = VehicleFilter()(scene.observe(0.0, stated_px=1e-3))
    assert isinstance(estimate, TrajectoryEstimate)
    assert len(estimate.windows) == 11
    assert not estimate.failures
    w = estimate.windows[-1]
    np.testing.assert_array_equal(w.track, np.arange(40))
    assert np.abs(w.T_co[-1].apply(w.X_o) - scene.points_c()[-1]).max() < tolerance_m


@pytest.mark.parametrize("form", FORMS)
def test_all_forms_give_the_same(make_scene: Maker, form: FormName) -> None:
    o = make_scene(points=12, frames=6).observe(0.2, 3)
    a, b = VehicleFilter()(o), VehicleFilter(form=form)(o)
    assert isinstance(a, TrajectoryEstimate)
    assert isinstance(b, TrajectoryEstimate)
    np.testing.assert_allclose(b.windows[-1].T_co.t, a.windows[-1].T_co.t, atol=1e-6)
    np.testing.assert_allclose(b.windows[-1].cov, a.windows[-1].cov, rtol=1e-4, atol=1e-9)


def test_an_outlier_is_rejected_and_a_good_track_is_not(make_scene: Maker) -> None:
    o = make_scene(points=40, frames=15).observe(0.2, 4)
    uv = o.tracks.uv_right.copy()
    wrong = o.tracks.track == 7
    uv[wrong] += np.random.default_rng(0).choice([-1, 1], (wrong.sum(), 2)) * 8.0
    wild = type(o)(o.t_s, o.rig, type(o.tracks)(o.tracks.frame, o.tracks.track, o.tracks.uv_left, uv, o.tracks.cov))
    estimate = VehicleFilter()(wild)
    assert isinstance(estimate, TrajectoryEstimate)
    late = estimate.windows[3:]
    assert all(7 not in w.track for w in late)
    assert np.mean([list(w.rejected) == [7] for w in late]) > 0.6


POOR = VehicleFilter(start="poor", poor_position_m=1.0, poor_speed_mps=3.0, poor_yaw_rad=0.1)
KINDS = {
    "centroid": VehicleFilter(state="centroid"),
    "poor": POOR,
    "poor centroid": replace(POOR, state="centroid"),
    "adjustment": VehicleFilter(start="adjustment", start_frames=5),
    "smoothed": VehicleFilter(smooth=True),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_gives_sound_estimates(make_scene: Maker, kind: str) -> None:
    """With births, deaths and an empty frame: finite, positive, and the last position good to a few centimetres."""
    scene = ctrv(make_scene, points=40, frames=20)
    keep = np.ones((20, 40), bool)
    keep[8] = False
    keep[:6, 30:35], keep[14:, 35:] = False, False
    estimate = KINDS[kind](scene.observe(0.1, 2, keep=keep))
    assert isinstance(estimate, TrajectoryEstimate)
    assert [f.frame for f in estimate.failures] == [8]
    assert [w.frames[-1] for w in estimate.windows][-1] == 19
    for w in estimate.windows:
        assert np.isfinite(w.cov).all()
        assert np.linalg.eigvalsh(w.cov)[0] > 0
    w = estimate.windows[-1]
    error = w.T_co[-1].apply(w.X_o).mean(axis=0) - scene.points_c()[-1][w.track].mean(axis=0)
    assert np.linalg.norm(error) < (0.3 if "poor" in kind else 0.05)


def test_a_poor_start_is_poor_and_settles(make_scene: Maker) -> None:
    scene = ctrv(make_scene, points=40, frames=30)
    estimate = POOR(scene.observe(0.1, 2))
    assert isinstance(estimate, TrajectoryEstimate)
    error = [
        w.T_co[-1].apply(w.X_o)[:, 2].mean() - scene.points_c()[w.frames[-1]][w.track, 2].mean()
        for w in estimate.windows
    ]
    assert abs(error[0]) > 0.05
    assert abs(error[-1]) < abs(error[0]) / 2


def test_smoothing_changes_only_what_came_before(make_scene: Maker) -> None:
    """The last frame has no later ones; the first gains the most."""
    scene = ctrv(make_scene, points=20, frames=10)
    o = scene.observe(0.2, 7)
    filtered, smoothed = VehicleFilter()(o), VehicleFilter(smooth=True)(o)
    assert isinstance(filtered, TrajectoryEstimate)
    assert isinstance(smoothed, TrajectoryEstimate)
    np.testing.assert_allclose(smoothed.windows[-1].cov, filtered.windows[-1].cov, atol=1e-12)
    for a, b in zip(smoothed.windows[:-1], filtered.windows[:-1], strict=True):
        assert np.diag(a.cov)[6] < np.diag(b.cov)[6]


@pytest.mark.parametrize(
    ("key", "value"),
    [("gate_sigma", 0.0), ("yaw_noise_radps2_sqrt_s", -1.0), ("speed_sigma_mps", np.nan), ("start_frames", 1)],
)
def test_wrong_options_are_refused(key: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"VehicleFilter\.{key}"):
        VehicleFilter(**{key: value})


def test_a_lost_filter_says_so_in_every_frame(make_scene: Maker, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where rounding takes the covariance's definiteness, here by force, no further estimate is given."""
    form = FORMS["joseph"]

    def spoilt(P: Array, A: Array, G: Array, q: Array) -> Array:
        return np.asarray(form.predict(P, A, G, q) - 30.0 * np.eye(len(P)))

    monkeypatch.setitem(FORMS, "joseph", replace(form, predict=spoilt))
    result = VehicleFilter(form="joseph")(make_scene(points=12, frames=6).observe(0.2))
    assert isinstance(result, EstimationFailed)
    assert result.reason.startswith("the filter diverged at frame 1")
