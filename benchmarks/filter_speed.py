"""Time of one measurement update, 12 states and 90 scalar measurements, beside filterpy and Stone Soup (extra `peers`).

Points on a rigid body, measured in three correlated coordinates each; decorrelating them is part of our time. All take
their turn in the same loop, some updates each after one that is not timed; medians of many rounds, and ratios to the
peers. Then 100 independent runs at once, in one thread. Times are those of the processor, so that what else it does
does not count. With a gate the forms by scalars use every measurement in its turn, and compress nothing.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.filter_speed [--rounds N]
"""

from __future__ import annotations

import argparse
import datetime
import time
import warnings
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from estimators.kalman import FORMS, Form, FormName
from sim.pose import hat

Array = np.ndarray
STATES, POINTS, RUNS = 12, 30, 100
UPDATES, GATE = 5, 50.0
GATED: tuple[FormName, ...] = ("sequential", "udu")
Update = Callable[[], tuple[Array, Array]]


def problem(runs: int) -> tuple[Array, Array, Array, Array, Array]:
    """State (r, 12) (position, rotation, and their rates), covariance, Jacobian (r, 90, 12), blocks (30, 3, 3), z."""
    rng = np.random.default_rng(1)
    M = rng.standard_normal((runs, STATES, STATES))
    P = M @ np.swapaxes(M, 1, 2) + np.eye(STATES)
    X = rng.uniform(-2, 2, (runs, POINTS, 3))
    H = np.zeros((runs, POINTS, 3, STATES))
    H[..., :3], H[..., 3:6] = np.eye(3), -hat(X)
    B = 0.1 * rng.standard_normal((POINTS, 3, 3))
    R = B @ np.swapaxes(B, 1, 2) + 0.05 * np.eye(3)
    x = rng.standard_normal((runs, STATES))
    z = (H @ x[:, None, :, None])[..., 0] + 0.1 * rng.standard_normal((runs, POINTS, 3))
    return x, P, H, R, z


def ours(form: Form, x: Array, F: Array, H: Array, R: Array, z: Array, gate: float = np.inf) -> Update:
    """The update of one run or of many."""
    rows, measured = H.reshape(*x.shape[:-1], -1, STATES), z.reshape(*x.shape[:-1], -1)

    def update() -> tuple[Array, Array]:
        c = form.correct(x, F, rows, measured - np.matvec(rows, x), R, gate)
        return c.x, c.F

    return update


def _whole(R: Array) -> Array:
    whole = np.zeros((3 * POINTS, 3 * POINTS))
    for i, block in enumerate(R):
        whole[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    return whole


def filterpy(x: Array, P: Array, H: Array, R: Array, z: Array) -> Update:
    from filterpy.kalman import KalmanFilter

    peer = KalmanFilter(dim_x=STATES, dim_z=3 * POINTS)
    peer.H, peer.R = H.reshape(-1, STATES), _whole(R)
    measured = z.reshape(-1, 1)

    def update() -> tuple[Array, Array]:
        peer.x, peer.P = x[:, None], P
        peer.update(measured)
        return peer.x[:, 0], peer.P

    return update


def stonesoup(x: Array, P: Array, H: Array, R: Array, z: Array) -> Update:
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import GaussianStatePrediction
    from stonesoup.updater.kalman import KalmanUpdater

    class Model(LinearGaussian):  # type: ignore[misc]  # no stubs
        """A linear measurement with a given matrix."""

        def matrix(self, **_: Any) -> Array:
            return H.reshape(-1, STATES)

        @property
        def ndim_meas(self) -> int:
            return 3 * POINTS

    model = Model(ndim_state=STATES, mapping=tuple(range(3 * POINTS)), noise_covar=_whole(R))
    updater, now = KalmanUpdater(model), datetime.datetime(2026, 1, 1)
    detection = Detection(z.reshape(-1, 1), timestamp=now, measurement_model=model)

    def update() -> tuple[Array, Array]:
        prediction = GaussianStatePrediction(x[:, None], P, timestamp=now)
        posterior = updater.update(SingleHypothesis(prediction, detection))
        return np.asarray(posterior.state_vector)[:, 0].astype(float), np.asarray(posterior.covar)

    return update


def timed(updates: dict[str, Update], rounds: int) -> dict[str, float]:
    """Median seconds of the processor for an update of each, all in turn in every round."""
    seconds: dict[str, list[float]] = {name: [] for name in updates}
    for _ in range(rounds):
        for name, update in updates.items():
            update()
            started = time.process_time()
            for _ in range(UPDATES):
                update()
            seconds[name].append((time.process_time() - started) / UPDATES)
    return {name: float(np.median(s)) for name, s in seconds.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=60)
    rounds = parser.parse_args().rounds
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    x, P, H, R, z = problem(RUNS)
    single: dict[str, Update] = {}
    many: dict[str, Update] = {}
    for key, form in FORMS.items():
        single[key] = ours(form, x[0], form.start(P[0]), H[0], R, z[0])
        many[f"{key}, {RUNS} runs"] = ours(form, x, form.start(P), H, R, z)
    for key in GATED:
        form = FORMS[key]
        single[f"{key}, gate"] = ours(form, x[0], form.start(P[0]), H[0], R, z[0], GATE)
        many[f"{key}, gate, {RUNS} runs"] = ours(form, x, form.start(P), H, R, z, GATE)
    peers = {"filterpy": filterpy, "Stone Soup": stonesoup}
    for name, build in peers.items():
        try:
            single[name] = build(x[0], P[0], H[0], R, z[0])
        except ImportError as error:
            print(f"{name} is not installed ({error})")
    expected = single["joseph"]()
    for name, update in single.items():
        off = float(np.abs(update()[0] - expected[0]).max())
        assert off < 1e-9, (name, off)
    seconds = timed(single | many, rounds)
    seconds |= {name: seconds[name] / RUNS for name in many}
    known = [p for p in peers if p in seconds]
    print(f"{'':27s}{'us/update':>10s}" + "".join(f"{'x ' + p:>14s}" for p in known))
    for name, s in seconds.items():
        print(f"{name:27s}{1e6 * s:10.1f}" + "".join(f"{seconds[p] / s:14.1f}" for p in known))
    for package in ("numpy", "numba", "filterpy", "stonesoup"):
        try:
            print(package, version(package), end="  ")
        except PackageNotFoundError:
            print(package, "not installed", end="  ")
    print()


if __name__ == "__main__":
    main()
