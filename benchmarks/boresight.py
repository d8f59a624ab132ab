"""Boresight over calibration flights of known truth: accuracy, honesty of the covariance, what can be separated.

Goals (Kozempel 2012, 3.3-3.4, and what this project asks of itself):

    clean           9 images x 8 control points at 500 m, ANTAR: 0.006 / 0.006 / 0.02 degrees, NEES in its 95 % band
    as the source   0.08 degrees vibration and 0.3 m GNSS: residual 4.5-6.5 px, scatter per image 0.05-0.12 degrees
    one height      a time offset is said to be inseparable from pitch
    two heights     and opposite headings, 2 x 9 images, 5 cm GNSS: the time offset to 4 ms
    no control      three images, started 1 degree off: 0.03 / 0.03 / 0.06 degrees; 5 m in position, 1 m in height

The band of NEES is that of the mean over the runs. "no own poses" is the clean flight adjusted as if navigation were
without error, the way that makes formal sigmas too small.

    python -m benchmarks.boresight [--runs N]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from benchmarks.boresight_flights import ANTAR, ARGOS, Conditions, Flight, TieConditions, fly, fly_ties
from estimators.aerial.boresight import (
    BoresightEstimate,
    BoresightPerImage,
    boresight_from_gcps,
    boresight_per_image,
)
from estimators.aerial.boresight_model import Extra, Navigation, unknowns
from estimators.aerial.boresight_ties import boresight_from_ties
from sim.streams import stream

Array = np.ndarray
CLEAN = Conditions()
DISTURBED = Conditions(vibration_deg=0.08, sigma_gnss_m=0.3)
ONE_HEIGHT = Conditions(lines=((0.0, 500.0), (180.0, 500.0)), images=18, time_offset_s=0.02)
TWO_HEIGHTS = Conditions(lines=((0.0, 500.0), (180.0, 1000.0)), images=18, time_offset_s=0.02)
STRIP = TieConditions(exposures=((0.0, -200.0), (0.0, 0.0), (0.0, 200.0)))


@dataclass(frozen=True, eq=False)
class Runs:
    """Results of all runs of one condition: errors (n, c) in degrees and seconds, formal sigmas (n, c), nees (n,)."""

    errors: Array
    sigmas: Array
    nees: Array
    estimates: Sequence[BoresightEstimate]
    failed: int
    ms: float


def collect(runs: int, one: Callable[[int], tuple[BoresightEstimate | None, Array]]) -> Runs:
    """One condition over all runs; ``one`` gives the estimate and the true values."""
    errors, sigmas, nees, estimates, failed = [], [], [], [], 0
    start = time.perf_counter()
    for run in range(runs):
        estimate, truth = one(run)
        if estimate is None:
            failed += 1
            continue
        e = estimate.x - truth
        unit = np.where(np.arange(len(e)) < 3, 180 / np.pi, 1.0)
        errors.append(e * unit)
        sigmas.append(np.sqrt(np.diag(estimate.cov)) * unit)
        nees.append(e @ np.linalg.solve(estimate.cov, e) / len(e))
        estimates.append(estimate)
    ms = 1e3 * (time.perf_counter() - start) / runs
    return Runs(np.array(errors), np.array(sigmas), np.array(nees), estimates, failed, ms)


def from_gcps(
    conditions: Conditions,
    runs: int,
    extra: Sequence[Extra] = (),
    believed: Callable[[Navigation], Navigation] = lambda navigation: navigation,
) -> Runs:
    """The adjustment with control points; ``believed`` changes what it is told of the navigation."""

    def one(run: int) -> tuple[BoresightEstimate | None, Array]:
        f = _flight(conditions, run)
        result = boresight_from_gcps(ANTAR, f.points, f.control, believed(f.navigation), f.nominal, extra)
        return result if isinstance(result, BoresightEstimate) else None, f.truth.values()[unknowns(extra)[0]]

    return collect(runs, one)


def from_ties(conditions: TieConditions, runs: int) -> tuple[Runs, Array]:
    """The adjustment without control, and root mean square errors of position and height [m] on the ground."""
    ground: list[list[float]] = []

    def one(run: int) -> tuple[BoresightEstimate | None, Array]:
        f = fly_ties(conditions, stream(7, run, "benchmark/ties"))
        result = boresight_from_ties(ARGOS, f.points, f.navigation, f.nominal)
        if not isinstance(result, BoresightEstimate):
            return None, f.truth.mounting.boresight
        d = (result.X_w - f.X_w)[np.isfinite(result.X_w[:, 0])]
        ground.append([np.mean(d[:, 0] ** 2 + d[:, 1] ** 2), np.mean(d[:, 2] ** 2)])
        return result, f.truth.mounting.boresight

    result = collect(runs, one)
    return result, np.sqrt(np.mean(ground, axis=0))


def scatter(conditions: Conditions, runs: int) -> list[float]:
    """Scatter of the boresight angles per image (Fig. 3.7) [deg], mean over the runs."""
    found = []
    for run in range(runs):
        f = _flight(conditions, run)
        per_image = boresight_per_image(ANTAR, f.points, f.control, f.navigation, f.nominal)
        if isinstance(per_image, BoresightPerImage):
            found.append(np.rad2deg(per_image.scatter))
    return [float(v) for v in np.stack(found).mean(axis=0)]


def _flight(conditions: Conditions, run: int) -> Flight:
    return fly(conditions, stream(7, run, "benchmark/boresight"))


def without_error(navigation: Navigation) -> Navigation:
    """Navigation that claims to be exact, to a thousandth of its sigmas."""
    return replace(navigation, sigma_rph=navigation.sigma_rph / 1e3, sigma_position_m=navigation.sigma_position_m / 1e3)


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _show(label: str, runs: Runs) -> None:
    rms, formal = _rms(runs.errors), _rms(runs.sigmas)
    dof = runs.errors.size
    low, high = (float(chi2.ppf(q, dof)) / dof for q in (0.025, 0.975))
    angles = " / ".join(f"{v:.4f}" for v in rms[:3])
    stated = " / ".join(f"{v:.4f}" for v in formal[:3])
    offset = f"   dt {1e3 * rms[3]:.2f} ms (formal {1e3 * formal[3]:.2f})" if len(rms) > 3 else ""
    print(f"{label:<15} {angles} deg (formal {stated}){offset}")
    print(
        f"{'':<15} NEES {runs.nees.mean():.3f} [{low:.3f}, {high:.3f}]   sigma_0 "
        f"{np.sqrt(np.mean([e.sigma_0**2 for e in runs.estimates])):.3f}   residual "
        f"{np.mean([e.rms_px for e in runs.estimates]):.2f} px   failed {runs.failed}   {runs.ms:.0f} ms a run"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=300)
    n = parser.parse_args().runs
    print(f"{n} runs each; root mean square errors of omega / phi / kappa")
    clean = from_gcps(CLEAN, n)
    _show("clean", clean)
    _show("no own poses", from_gcps(CLEAN, n, believed=without_error))
    _show("as the source", from_gcps(DISTURBED, n))
    print(f"{'':<15} scatter per image {' / '.join(f'{v:.3f}' for v in scatter(DISTURBED, n))} deg")
    one_height = from_gcps(ONE_HEIGHT, n, ["time_offset"])
    _show("one height", one_height)
    said = [e for e in one_height.estimates if any({"pitch", "time_offset"} <= set(g.names) for g in e.inseparable)]
    print(f"{'':<15} said of {len(said)} of {n}: {said[0].inseparable[0] if said else '-'}")
    two_heights = from_gcps(TWO_HEIGHTS, n, ["time_offset"])
    _show("two heights", two_heights)
    print(f"{'':<15} said to be inseparable: {sum(bool(e.inseparable) for e in two_heights.estimates)} of {n}")
    for label, conditions in (("no control", TieConditions()), ("  one strip", STRIP)):
        result, ground = from_ties(conditions, n)
        _show(label, result)
        print(f"{'':<15} on the ground {ground[0]:.2f} m in position, {ground[1]:.2f} m in height")


if __name__ == "__main__":
    main()
