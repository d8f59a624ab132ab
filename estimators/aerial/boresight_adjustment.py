"""One adjustment over all images: camera poses, points, boresight and what else the images share.

Every image has its own six pose parameters, bound to navigation by its stated sigmas; without them the formal sigmas
are two to four times too small. Points are unknown too, with their stated sigma where they are ground control, with
none where they are tie points. Points are eliminated first (`gauss_markov.reduce_points`), the poses next; the small
system that remains is that of the boresight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from jaxtyping import Float

from estimators.aerial.boresight_model import GNSS_COLUMNS, Common, Navigation, navigation_equations
from estimators.aerial.resection import ImagePoints, linearise, moved
from estimators.estimate import EstimationFailed
from estimators.gauss_markov import Blocks, Reduced, SingularSystem, normal_blocks, reduce_points
from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray
_ITERATIONS = 40
# The last step, in sigmas of the estimates.
_CONVERGED = 1e-5
# Least eigenvalue of the common unknowns' normal matrix with unit diagonal: below it they are not determined at all.
_SINGULAR = 1e-10


@dataclass(frozen=True, eq=False)
class Block:
    """What is adjusted: measured points of a camera, navigation of its m exposures, and which unknowns are common.

    X_w (n, 3) points, known to sigma_X (n,) [m] (infinite: a tie point); weights (k,) of the measured points, 1 but
    for outliers; columns of `Common` that are estimated. A share of navigation's errors that is constant makes an
    unknown GNSS offset of known size, whether it is asked for or not.
    """

    camera: Camera
    points: ImagePoints
    X_w: Array
    sigma_X: Array
    weights: Array
    navigation: Navigation
    columns: list[int]

    @property
    def hidden(self) -> list[int]:
        """Columns that are estimated but were not asked for."""
        return [i for i in GNSS_COLUMNS if self.navigation.constant_share and i not in self.columns]

    def prior(self) -> Array:
        """Weights (c,) of the values zero of the estimated and the hidden columns."""
        size = self.navigation.constant_share * self.navigation.sigma_position_m**2
        return np.concatenate([np.zeros(len(self.columns)), 1 / size if self.hidden else []])


@dataclass(frozen=True, eq=False)
class Values:
    """Unknowns of the adjustment: camera poses (m,), points X (n, 3), common unknowns."""

    T_wc: Pose
    X: Array
    common: Common


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Where the adjustment ended. cov (c, c) of the common unknowns (boresight as rotation in body axes); residuals
    (k, 2) [px], adjusted minus measured; cost v'Wv of all that was observed."""

    values: Values
    cov: Float[Array, "c c"]
    residuals: Float[Array, "k 2"]
    cost: float
    iterations: int


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations after the points: poses (p = 6m) and common unknowns (c), and how the points follow."""

    reduced: Reduced
    N_pp: Array
    N_pg: Array
    N_gg: Array
    b_p: Array
    b_g: Array

    def solve(self) -> tuple[Array, Array, Array]:
        """Steps of the poses (m, 6) and the common unknowns (c,), covariance of the latter.

        Raises
            SingularSystem: the poses or the common unknowns are not determined.
        """
        d = np.sqrt(np.diag(self.N_pp))
        try:
            factor = scipy.linalg.cho_factor(self.N_pp / np.outer(d, d))
        except np.linalg.LinAlgError as error:
            raise SingularSystem("an image is not determined by its points and the navigation") from error
        h = scipy.linalg.cho_solve(factor, self.N_pg / d[:, None]) / d[:, None]
        N = self.N_gg - self.N_pg.T @ h
        scale = np.sqrt(np.diag(N))
        if not np.all(np.isfinite(scale) & (scale > 0)):
            raise SingularSystem("a common unknown is not observed")
        values, vectors = np.linalg.eigh(N / np.outer(scale, scale))
        if values[0] < _SINGULAR:
            raise SingularSystem("the common unknowns are not determined: the exposures do not separate them")
        cov = (vectors / values) @ vectors.T / np.outer(scale, scale)
        dg = cov @ (self.b_g - h.T @ self.b_p)
        dp = scipy.linalg.cho_solve(factor, self.b_p / d) / d - h @ dg
        return dp.reshape(-1, 6), dg, (cov + cov.T) / 2


def adjust(block: Block, start: Values) -> Adjusted | EstimationFailed:
    """Gauss-Newton from the start values; Kozempel 2012, 3.3 and 3.4.

    The covariance is that of the stated sigmas (variance factor 1).
    """
    values = start
    try:
        for iteration in range(1, _ITERATIONS + 1):
            system = _linearised(block, values)
            dp, dg, cov = system.solve()
            values = _stepped(block, values, system, dp, dg)
            if np.sqrt(dg @ np.linalg.solve(cov, dg) / len(dg)) < _CONVERGED:
                residuals = linearise(block.camera, values.T_wc[block.points.image], values.X[block.points.point]).uv
                return _finished(block, values, cov, residuals - block.points.uv, iteration)
    except SingularSystem as failure:
        return EstimationFailed(str(failure), ("More images, headings or heights separate the unknowns.",))
    except np.linalg.LinAlgError:
        return EstimationFailed("the rays of a point are nearly parallel", ("Exposures further apart.",))
    except _Lost:
        return EstimationFailed("points fall behind a camera", ("Give a better start.",))
    return EstimationFailed(f"no convergence in {_ITERATIONS} iterations", ("Give a better start.",))


class _Lost(Exception):
    """The values at hand project no finite coordinates."""


def _stepped(block: Block, values: Values, system: _System, dp: Array, dg: Array) -> Values:
    d = np.zeros(10)
    d[block.columns + block.hidden] = dg
    X = values.X + system.reduced.points(dp.ravel())
    return Values(moved(values.T_wc, dp), X, values.common.moved(d))


def _linearised(block: Block, values: Values) -> _System:
    points, m, n = block.points, len(values.T_wc), len(values.X)
    p = linearise(block.camera, values.T_wc[points.image], values.X[points.point])
    if not np.isfinite(p.uv).all():
        raise _Lost
    W = (block.weights / points.sigma_px**2)[:, None, None] * np.eye(2)
    blocks = _with_known_points(normal_blocks(p.A, p.B, W, points.uv - p.uv), block, values)
    reduced = reduce_points(points.image, points.point, blocks, m, n)
    e, W_nav = navigation_equations(values.T_wc, block.navigation, values.common), block.navigation.weights()
    columns, prior = block.columns + block.hidden, block.prior()
    G = e.G[:, :, columns]
    JW, GW = np.swapaxes(e.J, 1, 2) @ W_nav, np.swapaxes(G, 1, 2) @ W_nav
    return _System(
        reduced,
        reduced.S + scipy.linalg.block_diag(*(JW @ e.J)),
        (JW @ G).reshape(6 * m, -1),
        (GW @ G).sum(axis=0) + np.diag(prior),
        reduced.rhs - (JW @ e.r[:, :, None]).ravel(),
        -np.einsum("mci,mi->c", GW, e.r) - prior * values.common.values()[columns],
    )


def _with_known_points(blocks: Blocks, block: Block, values: Values) -> Blocks:
    """Adds what is known of the points themselves, each once: to its first measurement."""
    point, first = np.unique(block.points.point, return_index=True)
    weight = block.sigma_X[point] ** -2.0
    N_XX, b_X = blocks.N_XX.copy(), blocks.b_X.copy()
    N_XX[first] += weight[:, None, None] * np.eye(3)
    b_X[first] += weight[:, None] * (block.X_w - values.X)[point]
    return replace(blocks, N_XX=N_XX, b_X=b_X)


def _finished(block: Block, values: Values, cov: Array, residuals: Array, iterations: int) -> Adjusted:
    r = navigation_equations(values.T_wc, block.navigation, values.common).r
    known = np.isfinite(block.sigma_X)
    dX = (values.X - block.X_w)[known] / block.sigma_X[known, None]
    cost = np.sum(block.weights[:, None] * (residuals / block.points.sigma_px) ** 2) + np.sum(dX**2)
    cost += np.einsum("mi,mij,mj->", r, block.navigation.weights(), r)
    cost += np.sum(block.prior() * values.common.values()[block.columns + block.hidden] ** 2)
    asked = len(block.columns)
    cov = cov[:asked, :asked].copy()
    # A constant error of attitude is a boresight that is not the mounting's.
    cov[:3, :3] += block.navigation.constant_share * np.diag(block.navigation.sigma_rph**2)
    return Adjusted(values, cov, residuals, float(cost), iterations)
