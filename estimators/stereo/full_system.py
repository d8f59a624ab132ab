"""The linearised system of one window as a whole: observations, pseudo-observations, datum and conditions.

Rows of A: three per observation, then the pseudo-observations of 3.6 and 4.2.3. Columns of H: the datum (3.1.7), then
what the poses are not allowed. Its right side is zero: the start values meet the conditions, and no step leaves them.

The source puts all six conditions of the datum beside those of 3.6 and 4.2.13. These hold the object's frame in part
already; what is held twice holds the shape, not the frame. Here the datum closes only what they leave open.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Float, Int

from estimators.bordered import BorderedSystem, Sparse, block_diagonal, clean
from estimators.stereo.conditions import Conditions, PseudoObservations
from estimators.stereo.datum import full_null_space, inner_conditions, three_point_conditions
from estimators.stereo.object_motion import Problem, design
from sim.pose import hat

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Weighted:
    """A problem with the observations (k, 3) and the weights W (k, 3, 3) and P (q, q) of one iteration, 4.1.3.3."""

    problem: Problem
    observed: Float[Array, "k 3"]
    W: Float[Array, "k 3 3"]
    conditions: Conditions | None
    P: Float[Array, "q q"]

    def residuals(self, R: Array, T: Array, X: Array) -> Float[Array, "k 3"]:
        """v = R X + T - l."""
        return np.asarray(camera_points(self.problem, R, T, X) - self.observed)

    def known(self, R: Array, T: Array) -> PseudoObservations:
        """The pseudo-observations at some poses, those without weight left out."""
        if self.conditions is None:
            return PseudoObservations(np.zeros(0), np.zeros((0, 6 * len(R))), self.P, 0)
        all_ = self.conditions.pseudo_observations(R, T)
        used = all_.P.any(axis=1)
        return replace(all_, e=all_.e[used], J=all_.J[used], P=self.P)

    def cost(self, R: Array, T: Array, X: Array) -> float:
        """v'Wv + e'Pe, the system error (2.1.17)."""
        v, e = self.residuals(R, T, X), self.known(R, T).e
        return float(np.einsum("ka,kab,kb->", v, self.W, v) + e @ self.P @ e)


def camera_points(problem: Problem, R: Array, T: Array, X: Array) -> Float[Array, "k 3"]:
    """R_t X_i + T_t of every observation."""
    return np.asarray((R[problem.frame] @ X[problem.point][:, :, None])[:, :, 0] + T[problem.frame])


def weighted(
    problem: Problem,
    R: Float[Array, "m 3 3"],
    T: Float[Array, "m 3"],
    X: Float[Array, "n 3"],
    conditions: Conditions | None = None,
) -> Weighted:
    """The problem with the weights of this place."""
    observed, W = problem.model(camera_points(problem, R, T, X))
    P = np.zeros((0, 0)) if conditions is None else conditions.pseudo_observations(R, T).P
    used = P.any(axis=1)
    return Weighted(problem, observed, W, conditions, P[np.ix_(used, used)])


def linearise(
    w: Weighted,
    R: Float[Array, "m 3 3"],
    T: Float[Array, "m 3"],
    X: Float[Array, "n 3"],
    three: Int[Array, "3"] | None = None,
) -> BorderedSystem:
    """The system at poses and points, in our unknowns; three: the points of the datum, None for inner constraints."""
    n, m, known = len(X), len(R), w.known(R, T)
    points = Sparse((len(known.e), 3 * n))
    A = scipy.sparse.vstack([_observed_rows(w.problem, R, X), scipy.sparse.hstack([points, Sparse(known.J)])])
    W = scipy.sparse.block_diag([block_diagonal(w.W), known.P])
    dl = np.concatenate([-w.residuals(R, T, X).ravel(), -known.e])
    k = 3 * len(w.observed)
    tilts = 3 * m if w.conditions is not None and w.conditions.terms.axis_weight != 0 else 0
    rows = {
        "observations": slice(0, k),
        "smoothing": slice(k, len(dl) - tilts),
        "axis": slice(len(dl) - tilts, len(dl)),
    }
    H, conditions = _condition_columns(w.conditions, R, X, three)
    return BorderedSystem(clean(Sparse(A)), Sparse(W), dl, H, n, m, rows, conditions, k + known.count)


def about_camera(system: BorderedSystem, T: Float[Array, "m 3"]) -> BorderedSystem:
    """The system in the source's unknowns, T <- exp(dr) T + dT (3.1.33): rotations about the camera's centre.

    Its dT is ours plus S(T) dr; `about_object` takes that off, and the step is the same.
    """
    blocks = np.tile(np.eye(6), (system.m, 1, 1))
    blocks[:, 3:, :3] = -hat(T)
    Q = Sparse(scipy.sparse.block_diag([scipy.sparse.eye_array(3 * system.n), block_diagonal(blocks)]))
    return replace(system, A=clean(Sparse(system.A @ Q)), H=clean(Sparse(Q.T @ system.H)))


def about_object(dp: Float[Array, "u"], T: Float[Array, "m 3"]) -> Float[Array, "u"]:
    """A linear step in the source's unknowns as one in ours, T <- T + dT."""
    result = np.array(dp)
    d = result[-6 * len(T) :].reshape(-1, 6)
    d[:, 3:] -= np.cross(T, d[:, :3])
    return result


def _observed_rows(problem: Problem, R: Array, X: Array) -> Sparse:
    """R_t at the point, [-S(R_t X_i), I] at the pose of every observation, (3k, 3n + 6m)."""
    k, n, m = len(problem.frame), len(X), len(R)
    R_k = R[problem.frame]
    values = np.concatenate([R_k, design(R_k, X[problem.point])], axis=2)
    columns = np.concatenate(
        [3 * problem.point[:, None] + np.arange(3), 3 * n + 6 * problem.frame[:, None] + np.arange(6)], axis=1
    )
    columns = np.repeat(columns, 3, axis=0).ravel()
    return Sparse((values.ravel(), columns, np.arange(0, 27 * k + 1, 9)), shape=(3 * k, 3 * n + 6 * m))


def _condition_columns(
    conditions: Conditions | None, R: Array, X: Array, three: Array | None
) -> tuple[Sparse, dict[str, slice]]:
    """H: the datum on the points, then what the poses are not allowed, rotations before translations."""
    p = 3 * len(X)
    datum = inner_conditions(X) if three is None else three_point_conditions(X, three)
    held = np.zeros((0, 6 * len(R)))
    if conditions is not None:
        G = full_null_space(R, X)[:p]
        datum = (G if three is None else datum @ np.linalg.inv(G.T @ datum)) @ conditions.terms.datum
        held = held if conditions.free is None else _held(conditions.free)
    turns = int(np.count_nonzero(held.reshape(len(held), len(R), 6)[:, :, :3].any(axis=(1, 2))))
    H = scipy.linalg.block_diag(datum, held.T)
    g = datum.shape[1]
    return Sparse(H), {"datum": slice(0, g), "axis": slice(g, g + turns), "tied": slice(g + turns, H.shape[1])}


def _held(free: Float[Array, "p f"]) -> Float[Array, "c p"]:
    """Conditions on the poses that leave exactly the changes ``free``, in the form of (3.6.4).

    Each gives one unknown by those that are free; first those of rotations.
    """
    p, c = free.shape[0], free.shape[0] - free.shape[1]
    _, upper, order = scipy.linalg.qr(np.eye(p) - free @ free.T, pivoting=True)
    rows = np.zeros((c, p))
    rows[:, order] = scipy.linalg.solve_triangular(upper[:c, :c], upper[:c])
    rows[np.abs(rows) < 1e-12] = 0
    held = order[:c]
    return np.asarray(rows[np.lexsort((held, held % 6 >= 3))])
