"""What accuracy a rig reaches: a formula per quantity, fitted to the bounds of a study over rigs, and its efficiency.

One frame alone knows the depth of the centroid of n points, by the first order of 4.1.2.2, to

    D = Z² sigma sqrt(2) / (b f sqrt(n)).

From frame to frame the size of the object in the picture tells its distance, too, up to a common scale, and better by
S / b, with S [m] an effective half width of the object. Depth then has the mean of w frames for the scale and both for
the rest; the closing speed, a difference of two frames, has no part in the scale; the yaw rate comes from how points
nearer and farther shift against one another in the picture, whatever the base:

    depth            k D sqrt(1/w + (1 - 1/w) / (1 + (S/b)²))
    closing speed    k sqrt(2) rate D / sqrt(1 + (S/b)²)
    yaw rate         k rate sigma Z^p / (f sqrt(n))

The constants k, S, p are fitted to the bounds; what an estimator reaches is the bound over its efficiency. That ends
where a window does not know the depth of single points to some 0.5 m: the car's shape is lost, its turning with it, and
with that the velocity of its rear axle, some metres from the points. Only the depth of the centroid goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.optimize import least_squares

from reports.errors import SMOOTHED
from reports.studies import StudyResult

Array = np.ndarray


@dataclass(frozen=True)
class Rig:
    """Rigs and their scenes, numbers or arrays alike: base [m], focal length [px], noise sigma [px], distance Z of the
    points at the newest frame [m], number of tracks n, frames of the window w, frame rate [Hz]."""

    baseline_m: Any
    focal_px: Any
    sigma_px: Any
    distance_m: Any
    tracks: Any
    window: Any
    rate_hz: Any = 25.0

    @property
    def shape_noise_m(self) -> Any:
        """What a window knows of the depth of a single point: where it exceeds the object's, its shape is lost."""
        return self.one_frame_m * np.sqrt(self.tracks / self.window)

    @property
    def one_frame_m(self) -> Any:
        """D, what one frame alone knows of the depth of the points' centroid."""
        disparity = np.sqrt(2) * self.sigma_px / (self.baseline_m * self.focal_px)
        return self.distance_m**2 * disparity / np.sqrt(self.tracks)


@dataclass(frozen=True)
class Quantity:
    """A quantity and axis of the error table, its unit and the factor to it, the shape noise [m] up to which the bound
    is reached, and the formula of the bound, a function of a rig and two constants."""

    quantity: str
    axis: str
    unit: str
    factor: float
    reach_m: float
    constants: tuple[str, str]
    formula: Callable[[Rig, float, float], Any]


def _depth(rig: Rig, k: float, S: float) -> Any:
    alone = 1 / rig.window
    return k * rig.one_frame_m * np.sqrt(alone + (1 - alone) / (1 + (S / rig.baseline_m) ** 2))


def _closing_speed(rig: Rig, k: float, S: float) -> Any:
    return k * np.sqrt(2) * rig.rate_hz * rig.one_frame_m / np.sqrt(1 + (S / rig.baseline_m) ** 2)


def _yaw_rate(rig: Rig, k: float, p: float) -> Any:
    return k * rig.rate_hz * rig.sigma_px * rig.distance_m**p / (rig.focal_px * np.sqrt(rig.tracks))


QUANTITIES: dict[str, Quantity] = {
    "depth": Quantity("position", "z", "m", 1.0, np.inf, ("k", "S [m]"), _depth),
    "closing speed": Quantity("velocity", "z", "m/s", 1.0, 0.6, ("k", "S [m]"), _closing_speed),
    "yaw rate": Quantity("yaw_rate", "all", "deg/s", 180 / np.pi, 0.4, ("k", "p"), _yaw_rate),
}


@dataclass(frozen=True, eq=False)
class Fit:
    """The formula of a quantity with its constants; efficiency: bound over RMS error, of all points within reach
    together; deviation: RMS of the logarithm of bound over formula; scatter: the same of achieved over predicted within
    reach, the noise of finitely many runs included. table: what it is fitted to, a row per point."""

    quantity: Quantity
    constants: tuple[float, float]
    efficiency: float
    deviation: float
    scatter: float
    table: pd.DataFrame

    def bound(self, rig: Rig) -> Any:
        """In the unit of the error table."""
        return self.quantity.formula(rig, *self.constants)

    def achieved(self, rig: Rig) -> Any:
        """RMS error to be expected, in the unit of the error table; NaN out of reach."""
        return np.where(rig.shape_noise_m <= self.quantity.reach_m, self.bound(rig) / self.efficiency, np.nan)


def rigs(result: StudyResult) -> Rig:
    """The rigs and scenes of a study's points; the distance is that of the newest frames."""
    scenarios: list[Mapping[str, Any]] = [result.scenarios[str(p)] for p in result.points.index]
    newest = result.comparison[result.comparison["entity"] != SMOOTHED]
    distance = newest.groupby("point", observed=False)["distance_m"].mean()
    return Rig(
        baseline_m=np.array([s["rig"]["baseline_m"] for s in scenarios]),
        focal_px=np.array([s["rig"]["focal_px"] for s in scenarios]),
        sigma_px=np.array([s["measure"]["sigma_px"] for s in scenarios]),
        distance_m=distance.reindex(result.points.index).to_numpy(float),
        tracks=np.array([float(s["measure"]["points"]) for s in scenarios]),
        window=np.array([float(s["rig"]["frames"]) for s in scenarios]),
        rate_hz=np.array([s["rig"]["rate_hz"] for s in scenarios]),
    )


def fit(result: StudyResult, name: str) -> Fit:
    """Fits the formula of one of `QUANTITIES` to a study whose windows are as long as its sequences.

    Raises
        ValueError: fewer points than constants have an estimate.
    """
    q = QUANTITIES[name]
    c = result.comparison
    rows = c[(c["quantity"] == q.quantity) & (c["axis"] == q.axis) & (c["entity"] != SMOOTHED)]
    squares = rows[["error", "bound"]].pow(2).groupby(rows["point"], observed=False).mean()
    root = np.sqrt(squares.reindex(result.points.index).to_numpy(float))
    known = np.isfinite(root).all(axis=1)
    if known.sum() < 3:
        raise ValueError(f"{name}: {known.sum()} points have an estimate, expected 3 or more")
    rig = rigs(result)
    chosen = Rig(**{key: value[known] for key, value in vars(rig).items()})
    rms, bound = root[known].T

    def off(logarithms: Float[Array, "2"]) -> Float[Array, "n"]:
        return np.asarray(np.log(q.formula(chosen, *np.exp(logarithms)) / bound))

    found = least_squares(off, np.zeros(2))
    constants = (float(np.exp(found.x[0])), float(np.exp(found.x[1])))
    near = chosen.shape_noise_m <= q.reach_m
    efficiency = float(np.mean((rms / bound)[near] ** 2) ** -0.5)
    table = pd.DataFrame(vars(chosen)).assign(rms=rms, bound=bound, formula=q.formula(chosen, *constants), near=near)
    scatter = np.log(rms * efficiency / table["formula"])[near]
    return Fit(q, constants, efficiency, _root_mean(found.fun), _root_mean(scatter), table)


def _root_mean(v: Float[Array, "n"]) -> float:
    return float(np.sqrt(np.mean(np.square(v))))


def rig_table(result: StudyResult) -> pd.DataFrame:
    """The constants of every formula, how well it fits the bounds, and the efficiency: how near to them one comes."""
    rows = []
    for name, q in QUANTITIES.items():
        found = fit(result, name)
        constants = ", ".join(f"{n} = {v:.3g}" for n, v in zip(q.constants, found.constants, strict=True))
        row = {"quantity": name, "constants": constants, "deviation of the bounds [%]": 100 * found.deviation}
        row |= {"efficiency": found.efficiency, "deviation of the achieved [%]": 100 * found.scatter}
        rows.append(row | {"points": len(found.table), "within reach": int(found.table["near"].sum())})
    return pd.DataFrame(rows)
