"""Tie points: the same ground points in several overlapping images, whatever the headings.

Every other image is laid onto the one in the middle by the homography of a level ground, from approximate poses; what
then remains is a shift (phase correlation) and a field of small displacements (corners followed by Lucas and Kanade,
forth and back). All at reduced size: more accurate and a hundred times faster than SIFT at full size.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from estimators.aerial.resection import ImagePoints
from estimators.estimate import EstimationFailed
from sim.camera import Camera
from sim.pose import Pose

Array = np.ndarray
_WINDOW = (31, 31)
_LEVELS = 4
# Forth and back, in pixels of the reduced image.
_ROUND_TRIP_PX = 0.3
_QUALITY = 0.01
_LEAST_OVERLAP = 0.05
_LEAST_RESPONSE = 0.03


def match_ties(
    images: Sequence[UInt8[Array, "h w"]],
    camera: Camera,
    T_wc: Pose,
    ground_m: float,
    sigma_px: float = 0.3,
    count: int = 400,
    reduce: int = 2,
) -> ImagePoints | EstimationFailed:
    """Points of the image in the middle that others show, too: at most ``count``, numbered from 0; uv in full size.

    T_wc (m,) approximate poses (a degree off will do), ground_m the mean height of the ground, sigma_px what to state
    of the result, ``reduce`` the divisor of the image size at which points are followed.

    Raises
        ValueError: images that are not as many as poses, or not the camera's size.
    """
    if len(images) != len(T_wc):
        raise ValueError(f"images: expected as many as poses, {len(T_wc)}, got {len(images)}")
    sizes = {image.shape[::-1] for image in images}
    if sizes != {camera.size_px}:
        raise ValueError(f"images: expected {camera.size_px} as the camera's, got {sorted(sizes)}")
    middle = int(np.argmin(np.linalg.norm(T_wc.t[:, None] - T_wc.t, axis=2).sum(axis=1)))
    small = [_reduced(image, reduce) for image in images]
    corners = cv2.goodFeaturesToTrack(small[middle], 4 * count, _QUALITY, _spacing(small[middle], count))
    if corners is None:
        return EstimationFailed("the reference image has no corners", ("Better texture or contrast.",))
    reference = corners[:, 0].astype(float)
    image, point, uv = [np.full(len(reference), middle)], [np.arange(len(reference))], [_full(reference, reduce)]
    for i in (i for i in range(len(images)) if i != middle):
        H = _over_level_ground(camera, T_wc[middle], T_wc[i], ground_m)
        found, there = _follow(small[middle], small[i], _between_reduced(H, reduce), reference)
        image.append(np.full(len(found), i))
        point.append(found)
        uv.append(_full(there, reduce))
    return _chosen(np.concatenate(image), np.concatenate(point), np.concatenate(uv), count, sigma_px)


def _chosen(image: Array, point: Array, uv: Array, count: int, sigma_px: float) -> ImagePoints | EstimationFailed:
    """The points seen in most images, the strongest corners first."""
    seen = np.bincount(point)
    best = np.argsort(-seen, kind="stable")[:count]
    best = best[seen[best] >= 2]
    if not len(best):
        return EstimationFailed("the images have no points in common", ("More overlap, or better poses.",))
    number = np.full(len(seen), -1)
    number[best] = np.arange(len(best))
    keep = number[point] >= 0
    return ImagePoints(image[keep], number[point[keep]], uv[keep], sigma_px)


def _reduced(image: Array, reduce: int) -> Array:
    size = (image.shape[1] // reduce, image.shape[0] // reduce)
    whole = image[: size[1] * reduce, : size[0] * reduce]
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA))


def _full(uv: Array, reduce: int) -> Array:
    """Pixels of the reduced image in the full one: centres of areas, (0, 0) the centre of the first."""
    return np.asarray((uv + 0.5) * reduce - 0.5)


def _spacing(image: Array, count: int) -> float:
    """Least distance of corners, so that they spread over the whole image."""
    return float(np.sqrt(image.size / (4.0 * count)))


def _over_level_ground(camera: Camera, T_wa: Pose, T_wb: Pose, ground_m: float) -> Float[Array, "3 3"]:
    """Homography from pixels of a to pixels of b over the level ground; the lens distortion is only fitted."""
    w, h = camera.size_px
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(0, w - 1, 7), np.linspace(0, h - 1, 7)))
    uv = np.stack([u, v], axis=1)
    ray = np.column_stack([camera.normalise(uv), np.ones(len(uv))]) @ T_wa.R.T
    X = T_wa.t + ray * ((ground_m - T_wa.t[2]) / ray[:, 2])[:, None]
    p = T_wb.inv().apply(X)
    ideal = p[:, :2] / p[:, 2:] @ camera.K[:2, :2].T + camera.K[:2, 2]
    return np.asarray(cv2.findHomography(uv, ideal)[0])


def _between_reduced(H: Array, reduce: int) -> Array:
    up = np.array([[reduce, 0, (reduce - 1) / 2], [0, reduce, (reduce - 1) / 2], [0, 0, 1.0]])
    return np.asarray(np.linalg.inv(up) @ H @ up)


def _follow(a: Array, b: Array, H: Array, corners: Array) -> tuple[Array, Array]:
    """Which corners of a are found in b, and where there; H takes pixels of a to pixels of b."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    laid = cv2.warpPerspective(b, H, a.shape[::-1], flags=flags)
    mask = cv2.warpPerspective(np.full_like(b, 255), H, a.shape[::-1], flags=flags)
    none = np.zeros(0, int), np.zeros((0, 2))
    if np.mean(mask > 0) < _LEAST_OVERLAP:
        return none
    (dx, dy), response = _shift(a, laid, mask)
    if response < _LEAST_RESPONSE:
        return none
    start = corners.astype(np.float32)[:, None]
    there, ok = _tracked(a, laid, start, start + np.array([dx, dy], np.float32))
    back, ok_back = _tracked(laid, a, there, start.copy())
    there, trip = there[:, 0].astype(float), np.linalg.norm((back - start)[:, 0], axis=1)
    margin = _WINDOW[0] // 2 + 1
    inside = cv2.erode(mask, np.ones((2 * margin, 2 * margin), np.uint8), borderValue=0)
    row, column = np.rint(there[:, 1]).astype(int), np.rint(there[:, 0]).astype(int)
    on = (row >= 0) & (row < a.shape[0]) & (column >= 0) & (column < a.shape[1])
    on[on] = inside[row[on], column[on]] == 255
    found = np.flatnonzero(on & ok & ok_back & (trip < _ROUND_TRIP_PX))
    if not len(found):
        return none
    return found, cv2.perspectiveTransform(there[found][:, None], H)[:, 0]


def _tracked(a: Array, b: Array, start: Array, guess: Array) -> tuple[Array, Array]:
    """Points of a in b by Lucas and Kanade from a guess, and which were found."""
    flags = cv2.OPTFLOW_USE_INITIAL_FLOW
    there, ok, _ = cv2.calcOpticalFlowPyrLK(a, b, start, guess, winSize=_WINDOW, maxLevel=_LEVELS, flags=flags)
    return there, ok[:, 0] == 1


def _shift(a: Array, b: Array, mask: Array) -> tuple[tuple[float, float], float]:
    """Shift of b against a over their common part, by phase correlation, and its response (0 to 1)."""
    x, y, w, h = cv2.boundingRect(mask)
    window = np.s_[y : y + h, x : x + w]
    covered = mask[window] == 255
    first, second = (_levelled(image[window], covered) for image in (a, b))
    shift, response = cv2.phaseCorrelate(first, second, cv2.createHanningWindow((w, h), cv2.CV_32F))
    return (float(shift[0]), float(shift[1])), float(response)


def _levelled(image: Array, covered: Array) -> Array:
    """Grey values about their mean, zero where not covered."""
    return np.where(covered, image - image[covered].mean(), 0).astype(np.float32)
