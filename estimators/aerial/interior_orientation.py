"""Interior orientation from images of a calibration wall: Brown's model with affinity and shear, with its covariance.

Kozempel 2012, 3.2: the source calibrates with a bundle adjustment over known object points. OpenCV's calibrateCamera is
the engine; it knows no shear and no covariance of what is correlated, so one adjustment of ours follows, with

    u = (f + b1) x_d + b2 y_d + c_x,   v = f y_d + c_y

where b1, b2 are the affinity and shear B1, B2 of (3.9) in pixels, and (x_d, y_d) Brown's distortion (k1, k2, k3, p1,
p2) of ideal coordinates. (The source corrects in the other direction, from distorted to ideal: `sim.camera`.)
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from estimators.aerial.resection import ImagePoints, initial_pose, linearise, moved
from estimators.estimate import EstimationFailed
from estimators.gauss_markov import sum_by
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray
NAMES = ("f", "b1", "b2", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
_ENGINE = cv2.CALIB_USE_INTRINSIC_GUESS
_LEAST_POINTS = 6
_ITERATIONS = 30
_CONVERGED = 1e-6
_SINGULAR = 1e-12
# A focal length, affinity, shear or principal point known worse than this share of the focal length is not determined.
_LEAST_PRECISION = 0.005
_ADVICE = ("Turn and tilt the camera between the images, by 30 degrees and more; use several distances.",)


@dataclass(frozen=True, eq=False)
class InteriorOrientation:
    """Camera with covariance: x (10,) and cov (10, 10) of `NAMES` (f, b1, b2, cx, cy in pixels), of the stated sigma.

    T_wc (m,) poses of the images in the frame of the wall; residuals (k, 2) [px], adjusted minus measured; images (m,)
    the index of each image that took part. undetermined names what these images do not give.
    """

    camera: Camera
    x: Float[Array, "10"]
    cov: Float[Array, "10 10"]
    T_wc: Pose
    images: tuple[int, ...]
    residuals: Float[Array, "k 2"]
    sigma_0: float
    redundancy: int
    undetermined: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_fields(self)

    @property
    def sigma(self) -> Float[Array, "10"]:
        return np.asarray(np.sqrt(np.diag(self.cov)))

    @property
    def correlation(self) -> Float[Array, "10 10"]:
        return np.asarray(self.cov / np.outer(self.sigma, self.sigma))


def calibrate(points: ImagePoints, X_w: Float[Array, "n 3"], nominal: Camera) -> InteriorOrientation | EstimationFailed:
    """Interior orientation from points of a wall, flat or not, whose coordinates X_w [m] are known.

    ``nominal`` starts the adjustment: the focal length of the data sheet will do. Images with fewer than six points
    take no part.
    """
    count = np.bincount(points.image) if len(points) else np.zeros(0, int)
    images = np.flatnonzero(count >= _LEAST_POINTS)
    if not len(images):
        return EstimationFailed(f"no image shows {_LEAST_POINTS} points of the wall", ("Measure more points.",))
    points = points.select(np.isin(points.image, images))
    points = ImagePoints(np.searchsorted(images, points.image), points.point, points.uv, points.sigma_px)
    redundancy = 2 * len(points) - len(NAMES) - 6 * len(images)
    if redundancy < 1:
        return EstimationFailed(f"{len(points)} points in {len(images)} images: fewer than the unknowns")
    start = _engine(points, X_w, nominal, len(images))
    if isinstance(start, EstimationFailed):
        return start
    return _adjusted(points, X_w, *start, images, redundancy)


def _engine(points: ImagePoints, X_w: Array, nominal: Camera, m: int) -> tuple[Camera, Pose] | EstimationFailed:
    """OpenCV's calibration (no shear), from the nominal camera."""
    poses = []
    for i in range(m):
        mine = points.image == i
        pose = initial_pose(nominal, X_w[points.point[mine]], points.uv[mine])
        if isinstance(pose, EstimationFailed):
            return pose
        poses.append(pose)
    X = [X_w[points.point[points.image == i]].astype(np.float32) for i in range(m)]
    uv = [points.uv[points.image == i].astype(np.float32) for i in range(m)]
    K = nominal.K.copy()
    K[0, 1] = 0.0
    try:
        _, K, distortion, r, t = cv2.calibrateCamera(
            X, uv, nominal.size_px, K, nominal.distortion.copy(), flags=_ENGINE
        )
    except cv2.error as error:
        return EstimationFailed(f"OpenCV's calibration failed: {error.err}")
    if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
        return EstimationFailed("OpenCV's calibration found no focal length", ("Turn the camera between images.",))
    R = np.stack([cv2.Rodrigues(a)[0] for a in r])
    return Camera(K, nominal.size_px, distortion.ravel()[:5]), Pose(R, np.stack(t)[:, :, 0]).inv()


def parameters(camera: Camera) -> Float[Array, "10"]:
    """The interior orientation of a camera as the vector of `NAMES`."""
    K, (k1, k2, p1, p2, k3) = camera.K, camera.distortion
    return np.array([K[1, 1], K[0, 0] - K[1, 1], K[0, 1], K[0, 2], K[1, 2], k1, k2, k3, p1, p2])


def camera_of(x: Float[Array, "10"], size_px: tuple[int, int]) -> Camera:
    """Inverse of `parameters`.

    Raises
        ValueError: a focal length that is not positive.
    """
    f, b1, b2, cx, cy, k1, k2, k3, p1, p2 = x
    K = np.array([[f + b1, b2, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])
    return Camera(K, size_px, np.array([k1, k2, p1, p2, k3]))


def interior_jacobian(camera: Camera, p_c: Float[Array, "k 3"]) -> Float[Array, "k 2 10"]:
    """d(u, v) / d(`NAMES`) of points in the camera frame."""
    x, y = (p_c[:, :2] / p_c[:, 2:]).T
    xd, yd = camera.distort(np.stack([x, y], axis=1)).T
    r2 = x * x + y * y
    J = np.zeros((len(x), 2, 10))
    J[:, 0, 0], J[:, 1, 0] = xd, yd
    J[:, 0, 1], J[:, 0, 2] = xd, yd
    J[:, 0, 3] = J[:, 1, 4] = 1.0
    radial = np.stack([r2, r2**2, r2**3], axis=1)
    d = np.zeros((len(x), 2, 5))
    d[:, 0, :3], d[:, 1, :3] = x[:, None] * radial, y[:, None] * radial
    d[:, 0, 3], d[:, 1, 3] = 2 * x * y, r2 + 2 * y * y
    d[:, 0, 4], d[:, 1, 4] = r2 + 2 * x * x, 2 * x * y
    J[:, :, 5:] = camera.K[:2, :2] @ d
    return J


def _adjusted(
    points: ImagePoints, X_w: Array, camera: Camera, T_wc: Pose, images: Array, redundancy: int
) -> InteriorOrientation | EstimationFailed:
    """Gauss-Newton over interior orientation and poses; the poses are eliminated image by image."""
    for _ in range(_ITERATIONS):
        p = linearise(camera, T_wc[points.image], X_w[points.point])
        if not np.isfinite(p.uv).all():
            return EstimationFailed("points of the wall fall behind a camera", ("Give a better nominal camera.",))
        G = interior_jacobian(camera, T_wc[points.image].inv().apply(X_w[points.point])) / points.sigma_px
        A, dl = p.A / points.sigma_px, (points.uv - p.uv) / points.sigma_px
        m = len(images)
        N_pp, N_pg = (sum_by(points.image, np.swapaxes(A, 1, 2) @ D, m) for D in (A, G))
        b_p = sum_by(points.image, np.einsum("kij,ki->kj", A, dl), m)
        h = np.linalg.solve(N_pp, np.concatenate([N_pg, b_p[:, :, None]], axis=2))
        N = np.einsum("kij,kil->jl", G, G) - np.einsum("mij,mil->jl", N_pg, h[:, :, :10])
        b = np.einsum("kij,ki->j", G, dl) - np.einsum("mij,mi->j", N_pg, h[:, :, 10])
        scale = np.sqrt(np.diag(np.einsum("kij,kil->jl", G, G)))
        values, vectors = np.linalg.eigh(N / np.outer(scale, scale))
        if values[0] < _SINGULAR * values[-1]:
            return EstimationFailed("the images do not determine the interior orientation", _ADVICE)
        cov = (vectors / values) @ vectors.T / np.outer(scale, scale)
        dx = cov @ b
        x = parameters(camera) + dx
        if not (x[0] > 0 and x[0] + x[1] > 0):
            return EstimationFailed("the images do not determine the focal length", _ADVICE)
        camera = camera_of(x, camera.size_px)
        T_wc = moved(T_wc, h[:, :, 10] - h[:, :, :10] @ dx)
        if np.sqrt(dx @ b) < _CONVERGED:
            sigma_0 = float(np.sqrt(np.sum(dl**2) / redundancy))
            said = _undetermined(camera, cov)
            v, seen = -dl * points.sigma_px, tuple(images.tolist())
            return InteriorOrientation(camera, x, (cov + cov.T) / 2, T_wc, seen, v, sigma_0, redundancy, said)
    return EstimationFailed(f"no convergence in {_ITERATIONS} iterations", _ADVICE)


def _undetermined(camera: Camera, cov: Array) -> tuple[str, ...]:
    sigma = np.sqrt(np.diag(cov))[:5]
    return tuple(name for name, s in zip(NAMES, sigma, strict=False) if s > _LEAST_PRECISION * camera.K[1, 1])


def detect_board(
    images: list[UInt8[Array, "h w"]], board: cv2.aruco.CharucoBoard, sigma_px: float
) -> tuple[ImagePoints, Float[Array, "n 3"]]:
    """Corners of a board of squares with coded markers, by OpenCV, and where they are on the wall.

    Every corner is known by its id, so the image may cut the board off; what is not found is missing. OpenCV stops at a
    tenth of a pixel, in a window that may reach into the markers: what it found is refined in one that does not.
    """
    X = np.asarray(board.getChessboardCorners(), float)
    detector = cv2.aruco.CharucoDetector(board)
    image, point, uv = [], [], []
    for i, picture in enumerate(images):
        corners, ids, _, _ = detector.detectBoard(picture)
        if ids is not None and len(ids):
            image.append(np.full(len(ids), i))
            point.append(np.ravel(ids).astype(int))
            uv.append(_refined(picture, np.reshape(corners, (-1, 2)).astype(np.float32), board))
    if not image:
        return ImagePoints(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), sigma_px), X
    return ImagePoints(np.concatenate(image), np.concatenate(point), np.concatenate(uv), sigma_px), X


def _refined(picture: UInt8[Array, "h w"], uv: Float[Array, "n 2"], board: cv2.aruco.CharucoBoard) -> Array:
    """Corners to a thousandth of a pixel, in windows that end within the white around the markers."""
    if len(uv) < 2:
        return uv.astype(float)
    distance = np.linalg.norm(uv[:, None] - uv, axis=-1) + np.diag(np.full(len(uv), np.inf))
    white = (board.getSquareLength() - board.getMarkerLength()) / (2 * board.getSquareLength())
    half = max(int(white * distance.min()) - 1, 2)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-3)
    found = cv2.cornerSubPix(picture, uv.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), stop)
    return np.asarray(found.reshape(-1, 2), float)
