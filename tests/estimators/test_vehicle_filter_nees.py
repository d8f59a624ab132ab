"""Is the vehicle filter honest where its model holds? Motions drawn from the model itself, 100 independent runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.estimate import TrajectoryEstimate, WindowEstimate
from estimators.stereo.filter_state import Noise, State
from estimators.stereo.object_motion import align
from estimators.stereo.vehicle import level_camera
from estimators.stereo.vehicle_filter import VehicleFilter
from sim.camera import Camera, StereoRig
from sim.observations import Observations, Tracks
from sim.pose import Pose, log_so3, rot_z

Array = np.ndarray
RUNS, FRAMES, POINTS, DT_S, SIGMA_PX = 100, 14, 24, 0.04, 0.1
SETTLED = 4
# Two things are not of the model: it turns about the body's origin, which the filter puts elsewhere on the object, and
# its first step is linear in the turn. So what turns is small beside what shifts.
NOISE = Noise(longitudinal=2.0, lateral=0.5, vertical=0.2, yaw=0.05, tilt=0.02)
RIG = StereoRig.normal_case(Camera.simple((1024, 768), 1000.0), 0.3)
BAND = 0.025, 0.975


def drawn(rng: np.random.Generator) -> list[State]:
    """A car at 12 m that drives as the model says, in every frame; how it turns at first as the prior says."""
    omega = rng.normal(0, [POINT_STATES.tilt_rate_sigma_radps] * 2 + [POINT_STATES.yaw_rate_sigma_radps])
    X = rng.uniform([-2.2, -0.85, -0.7], [2.2, 0.85, 0.7], (POINTS, 3))
    k = np.arange(POINTS)
    states = [State(Pose(rot_z(1.2), np.array([-1.0, 12, 0])), np.array([*omega, 6, 0, 0]), X, k, k)]
    for _ in range(FRAMES - 1):
        G, q = NOISE.inputs(states[-1], np.array([0.0, 0, 1]), DT_S)
        d = G @ (np.sqrt(q) * rng.standard_normal(len(q)))
        states.append(states[-1].moved(DT_S).plus(np.concatenate([d, np.zeros(3 * POINTS)])))
    return states


def observed(states: list[State], rng: np.random.Generator) -> Observations:
    T_co = level_camera(FRAMES).inv() @ Pose.stack([s.T for s in states])
    uv = RIG.project(np.einsum("mab,nb->mna", T_co.R, states[0].X) + T_co.t[:, None]).reshape(-1, 4)
    uv = uv + SIGMA_PX * rng.standard_normal(uv.shape)
    frame, track = np.divmod(np.arange(len(uv)), POINTS)
    cov = np.broadcast_to(np.eye(4) * SIGMA_PX**2, (len(uv), 4, 4))
    return Observations(np.arange(FRAMES) * DT_S, RIG, Tracks(frame, track, uv[:, :2], uv[:, 2:], cov))


def errors(w: WindowEstimate, true: State) -> Array:
    """The functionals of `WindowEstimate.cov`, estimated minus true; the true motion is that at the instant."""
    T = level_camera(2).inv() @ Pose.stack([true.moved(-DT_S).T, true.T])
    X = true.X[w.track]
    Q, _ = align(X, w.X_o)
    R = w.T_co.R
    centre = w.T_co.apply(w.X_o.mean(axis=0)) - T.apply(X.mean(axis=0))
    rate = (log_so3(R[1] @ R[0].T) - log_so3(T.R[1] @ T.R[0].T)) / DT_S
    return np.concatenate([centre[1], log_so3(R[1] @ Q @ T.R[1].T), (centre[1] - centre[0]) / DT_S, rate])


def simulated(estimator: VehicleFilter) -> Any:
    """NEES of pose, of motion and of both (RUNS, 3) at the end, smoothed in the middle, and NIS with its degrees of
    freedom over all settled frames."""
    n, nis, dof = [], [], []
    for run in range(RUNS):
        rng = np.random.default_rng([2007, run])
        states = drawn(rng)
        estimate = estimator(observed(states, rng))
        assert isinstance(estimate, TrajectoryEstimate)
        assert not estimate.failures
        at = FRAMES // 2 if estimator.smooth else FRAMES - 1
        w = next(w for w in estimate.windows if w.frames[-1] == at)
        e = errors(w, states[at])
        n.append([e[p] @ np.linalg.solve(w.cov[p, p], e[p]) for p in (slice(0, 6), slice(6, 12), slice(0, 12))])
        settled = [w for w in estimate.windows if w.frames[-1] >= SETTLED]
        nis.append(sum(w.cost for w in settled))
        dof.append(sum(w.redundancy for w in settled))
    return np.array(n), np.sum(nis), np.sum(dof)


POINT_STATES = VehicleFilter(
    gate_sigma=np.inf,
    longitudinal_noise_mps2_sqrt_s=NOISE.longitudinal,
    lateral_noise_mps2_sqrt_s=NOISE.lateral,
    vertical_noise_mps2_sqrt_s=NOISE.vertical,
    yaw_noise_radps2_sqrt_s=NOISE.yaw,
    tilt_noise_radps2_sqrt_s=NOISE.tilt,
    yaw_rate_sigma_radps=0.1,
    tilt_rate_sigma_radps=0.02,
)
KINDS = {
    "points": POINT_STATES,
    "centroid": replace(POINT_STATES, state="centroid"),
    "from adjustment": replace(POINT_STATES, start="adjustment", start_frames=5),
    "smoothed": replace(POINT_STATES, smooth=True),
}


@pytest.mark.parametrize("kind", KINDS)
def test_nees_and_nis_lie_in_their_bands(kind: str) -> None:
    """95 % bands of 100 independent runs; innovations of different frames are independent, too."""
    nees, nis, dof = simulated(KINDS[kind])
    for found, k in zip(nees.mean(axis=0), (6, 6, 12), strict=True):
        low, high = chi2.ppf(BAND, k * RUNS) / RUNS
        assert low < found < high
    low, high = chi2.ppf(BAND, dof)
    assert low < nis < high
