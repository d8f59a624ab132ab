"""Where the object's frame lies: inner constraints and the three-point datum, Siegemund 2008, 3.1.7.

Moving the object frame alone changes no observation. The unknowns dp = (dX_1 .. dX_n, dr_1, dT_1 .. dr_m, dT_m) then
change along G, and six conditions H' dp = 0 on the points choose one of the equivalent solutions:

    inner         sum dX_i = 0, sum S(X_i) dX_i = 0                                         (3.1.35)-(3.1.37)
    three points  X_1 the origin, X_2 on the x axis, X_3 in the xy plane                    (3.1.39)-(3.1.41)

A covariance goes from one datum to another by the S-transformation C <- S C S', S = I - G (H'G)^-1 H'.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from estimators.gauss_markov import SingularSystem
from estimators.stereo.object_motion import null_space
from sim.pose import hat

Array = np.ndarray
_FLAT = 1e-6  # height over length below which a triangle is a line


def inner_conditions(X: Float[Array, "n 3"]) -> Float[Array, "p 6"]:
    """Coefficients (3n, 6) of the conditions that keep centroid and axes of the points, as printed in (3.1.37)."""
    H = np.zeros((len(X), 3, 6))
    H[:, :, :3], H[:, :, 3:] = np.eye(3), hat(X)
    return H.reshape(-1, 6)


def three_point_axes(X: Float[Array, "n 3"], three: Int[Array, "3"]) -> Float[Array, "3 3"]:
    """Axes (rows) of the frame of three points: x from X_1 to X_2, X_3 in the xy plane.

    Raises
        SingularSystem: the three points are collinear.
    """
    a, b = X[three[1]] - X[three[0]], X[three[2]] - X[three[0]]
    normal = np.cross(a, b)
    if not np.linalg.norm(normal) > _FLAT * max(a @ a, b @ b):
        raise SingularSystem("the points of the datum are collinear")
    e_x, e_z = a / np.linalg.norm(a), normal / np.linalg.norm(normal)
    return np.stack([e_x, np.cross(e_z, e_x), e_z])


def three_point_conditions(X: Float[Array, "n 3"], three: Int[Array, "3"]) -> Float[Array, "p 6"]:
    """Coefficients (3n, 6) of the conditions on three points, (3.1.41), along the axes they span.

    In their own frame these are the printed ones; in any other the points may not leave that frame either.

    Raises
        SingularSystem: the three points are collinear.
    """
    axes = three_point_axes(X, three)
    H = np.zeros((len(X), 3, 6))
    H[three[0], :, :3], H[three[1], :, 3:5], H[three[2], :, 5] = axes.T, axes[1:].T, axes[2]
    return H.reshape(-1, 6)


def choose_three(point: Int[Array, "k"], X: Float[Array, "n 3"]) -> Int[Array, "3"]:
    """The points of the datum: among those seen longest the two farthest apart and the one farthest from their line.

    As many lengths of track are admitted as it takes to span a triangle; point (k,) is that of each observation.

    Raises
        SingularSystem: all points are collinear.
    """
    seen = np.bincount(point, minlength=len(X))
    for least in np.unique(seen)[::-1]:
        among = np.flatnonzero(seen >= least)
        if len(among) < 3:
            continue
        three = among[_wide_triangle(X[among])]
        try:
            three_point_axes(X, three)
        except SingularSystem:
            continue
        return np.asarray(three)
    raise SingularSystem("the points are collinear")


def _wide_triangle(X: Array) -> Int[Array, "3"]:
    distance = cdist(X, X)
    first, second = np.unravel_index(np.argmax(distance), distance.shape)
    from_line = np.linalg.norm(np.cross(X - X[first], X[second] - X[first]), axis=1)
    return np.array([first, second, np.argmax(from_line)])


def three_point_frame(X: Float[Array, "n 3"], three: Int[Array, "3"]) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """Rotation Q and shift s with Q X + s in the frame of the three points, (3.1.39).

    Into the frame of other points, the finite form of the inner constraints, leads `object_motion.align`.

    Raises
        SingularSystem: the three points are collinear.
    """
    Q = three_point_axes(X, three)
    return Q, -Q @ X[three[0]]


def carried_frame(
    R_before: Float[Array, "c 3 3"],
    R_now: Float[Array, "c 3 3"],
    X_before: Float[Array, "p 3"],
    X_now: Float[Array, "p 3"],
) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """Rotation Q and shift s with Q X + s in the frame of the window before: turned by the poses R (c,) of their common
    frames, shifted by their common points X (p,).

    The shape of a far cloud is that of its depth noise. Laid on one another, such clouds turn: over the oncoming scene
    by 43 degrees, by the poses of the common frames 2.
    """
    Q = Rotation.from_matrix(np.swapaxes(R_before, 1, 2) @ R_now).mean().as_matrix()
    return Q, X_before.mean(axis=0) - Q @ X_now.mean(axis=0)


def in_frame(
    R: Float[Array, "m 3 3"],
    T: Float[Array, "m 3"],
    X: Float[Array, "n 3"],
    Q: Float[Array, "3 3"],
    s: Float[Array, "3"],
) -> tuple[Float[Array, "m 3 3"], Float[Array, "m 3"], Float[Array, "n 3"]]:
    """Poses and points with the object's coordinates Q X + s; what the camera sees, R X + T, stays."""
    R_new = R @ Q.T
    return R_new, T - R_new @ s, X @ Q.T + s


def full_null_space(R: Float[Array, "m 3 3"], X: Float[Array, "n 3"]) -> Float[Array, "u 6"]:
    """Changes G (3n + 6m, 6) of all unknowns that only move the object frame: turned by a, shifted by b,

    dX_i = S(X_i) a - b,  dr_t = R_t a,  dT_t = R_t b.
    """
    points = np.concatenate([hat(X), np.broadcast_to(-np.eye(3), (len(X), 3, 3))], axis=2)
    return np.concatenate([points.reshape(-1, 6), null_space(R)])


def s_transformation(G: Float[Array, "u g"], H: Float[Array, "u g"]) -> Float[Array, "u u"]:
    """S = I - G (H'G)^-1 H': carries changes of the unknowns, and by S C S' their covariance, into the datum H.

    Raises
        SingularSystem: the conditions do not fix the frame.
    """
    gram = H.T @ G
    if np.linalg.matrix_rank(gram) < gram.shape[1]:
        raise SingularSystem("the conditions of the datum do not fix the object's frame")
    return np.asarray(np.eye(len(G)) - G @ np.linalg.solve(gram, H.T))
