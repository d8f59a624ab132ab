"""The calibration wall: what is known of the interior orientation, and what that means over the image (3.2).

Points of the study differ in the wall (flat, deep), the tilt and number of its images, and in whether corners were
measured with noise or found in photographs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from estimators.aerial.image_error import displacements, image_rays, unturned
from estimators.aerial.interior_orientation import NAMES, camera_of, parameters
from reports.claim import Claim, holds
from reports.consistency import band
from reports.studies import StudyResult
from sim.camera import Camera
from sim.interior import InteriorOrientation

Array = np.ndarray
SIZE_PX = (1024, 1024)
PIXELS = ("f", "b1", "b2", "cx", "cy")
_KEYS = ("depth_m", "tilt_deg", "images", "photographs")
_LEVEL = 0.95
_SOURCE_ORTHO_PX = 5.6
CORNERS_PX = (2.0, 20.0, 50.0, 100.0)
ITERATIONS = 8
ENOUGH_PX = 0.1
"""Error below which an iteration, and a calibration, is taken to be enough."""


def true_camera(result: StudyResult) -> Camera:
    """The camera of the study, the same at all points."""
    s: dict[str, Any] = dict(next(iter(result.scenarios.values())))
    cx, cy = (np.array(SIZE_PX) - 1) / 2 + s["principal_px"]
    k1, k2, k3 = s["radial"]
    return camera_of(np.array([s["focal_px"], *s["affinity_px"], cx, cy, k1, k2, k3, *s["decentring"]]), SIZE_PX)


def over_points(result: StudyResult) -> pd.DataFrame:
    """Pooled measures, a row per point: the point's settings, then the quantities."""
    settings = pd.DataFrame({p: {k: s[k] for k in _KEYS} for p, s in result.scenarios.items()}).T
    wide = result.metrics.pivot_table(index="point", columns="quantity", values="value", observed=True)
    return settings.join(wide).reset_index(drop=True)


def design_table(result: StudyResult) -> pd.DataFrame:
    """Every point: corners, f and principal point beside their formal sigmas, the error over the image, NEES."""
    rows = over_points(result)
    low, high = band(len(NAMES), result.runs, _LEVEL)
    return pd.DataFrame(
        {
            "wall": np.where(rows["depth_m"] > 0, "deep", "flat"),
            "corners": np.where(rows["photographs"].astype(bool), "photos", "measured"),
            "tilt [°]": rows["tilt_deg"],
            "images": rows["images"],
            "points": rows["points"].round().astype(int),
            "corner noise [px]": rows["corner_noise"],
            "f, RMS [px]": rows["f_error"],
            "f, sigma [px]": rows["f_sigma"],
            "principal p., RMS [px]": np.hypot(rows["cx_error"], rows["cy_error"]),
            "principal p., sigma [px]": np.hypot(rows["cx_sigma"], rows["cy_sigma"]),
            "image, RMS [px]": rows["image_error"],
            "largest, turned [px]": rows["largest_turned"],
            "NEES": rows["nees"],
            "95 % band": f"{low:.2f} … {high:.2f}",
        }
    )


def chosen(result: StudyResult, photographs: bool = True, deep: bool = False) -> str:
    """The name of the point with 12 images at 30 degrees.

    Raises
        ValueError: the study has none.
    """
    for point, s in result.scenarios.items():
        if s["photographs"] == photographs and (s["depth_m"] > 0) == deep and (s["tilt_deg"], s["images"]) == (30, 12):
            return str(point)
    raise ValueError("the study has no point with 12 images at 30 degrees")


def errors(result: StudyResult, point: str) -> Float[Array, "runs 10"]:
    """Errors of all parameters in every run that gave a result."""
    m = result.measures
    rows = m[m["point"] == point].pivot_table(index="run", columns="quantity", values="value", observed=True)
    return rows[[f"{name}_error" for name in NAMES]].dropna().to_numpy(float)


def parameters_table(result: StudyResult) -> pd.DataFrame:
    """Photographs of the flat wall: every parameter, its error and sigma, its share in sigmas, who it goes with."""
    point = chosen(result)
    m = result.metrics
    value = m[m["point"] == point].set_index("quantity")["value"]
    truth = parameters(true_camera(result))
    goes = dict.fromkeys(NAMES, "")
    for quantity in value.index[value.index.str.endswith("_correlation")]:
        a, b, _ = str(quantity).split("_")
        for one, other in ((a, b), (b, a)):
            goes[one] += (", " if goes[one] else "") + f"{other} {value[quantity]:+.2f}"
    rms, sigma = (np.array([value[f"{n}_{what}"] for n in NAMES]) for what in ("error", "sigma"))
    return pd.DataFrame(
        {
            "parameter": NAMES,
            "unit": ["px" if n in PIXELS else "1" for n in NAMES],
            "true": truth,
            "RMS error": rms,
            "formal sigma": sigma,
            "RMS / sigma": rms / sigma,
            "true / sigma": np.abs(truth) / sigma,
            "correlated with": [goes[n] for n in NAMES],
        }
    )


def iteration_errors(camera: Camera, corner_px: float) -> Float[Array, "n"]:
    """Largest error [px] over the image of the distorted coordinates after 0, 1, 2 ... iterations of 3.2.

    Of the camera's lens, its distortion scaled to so many pixels in the corner. The iteration starts from the ideal
    coordinates, which its step 0 keeps.
    """
    lens = InteriorOrientation.of_camera(camera)
    measured = lens.from_pixels(np.stack(np.meshgrid(*(np.linspace(-0.5, n - 0.5, 41) for n in SIZE_PX)), axis=-1))
    scale = corner_px / float(np.linalg.norm(lens.correction(measured), axis=-1).max())
    K1, K2, K3 = (scale * k for k in lens.radial)
    P1, P2 = (scale * p for p in lens.decentring)
    B1, B2 = (scale * b for b in lens.affinity)
    lens = replace(lens, radial=(K1, K2, K3), decentring=(P1, P2), affinity=(B1, B2))
    ideal = lens.ideal(measured)
    return np.array([np.linalg.norm(lens.measured(ideal, n) - measured, axis=-1).max() for n in range(ITERATIONS + 1)])


def iteration_table(result: StudyResult) -> pd.DataFrame:
    """Distortion in the corner: largest error left after so many iterations [px]."""
    camera = true_camera(result)
    rows = []
    for corner in sorted({*CORNERS_PX, round(own_corner_px(camera), 1)}):
        left = iteration_errors(camera, corner)
        rows.append(
            {
                "distortion in the corner [px]": corner,
                **{f"after {n} [px]": left[n] for n in (0, 1, 2, 3, 4, 6, 8)},
                f"enough for {ENOUGH_PX:g} px": _enough(left),
            }
        )
    return pd.DataFrame(rows)


def _enough(left: Float[Array, "n"]) -> str:
    below = np.flatnonzero(left < ENOUGH_PX)
    return f"{below[0]}" if len(below) else f"more than {ITERATIONS}"


def own_corner_px(camera: Camera) -> float:
    """The largest displacement by the camera's own lens [px]."""
    return float(np.linalg.norm(lens_field(camera), axis=1).max())


def lens_field(camera: Camera) -> Float[Array, "k 2"]:
    """What the whole distortion, affinity and shear included, does over the image [px]."""
    K = np.array([[camera.K[1, 1], 0, camera.K[0, 2]], [0, camera.K[1, 1], camera.K[1, 2]], [0, 0, 1.0]])
    rays = image_rays(camera)
    return -displacements(Camera(K, camera.size_px), camera, rays)


def reduced_field(camera: Camera) -> Float[Array, "k 2"]:
    """What is lost when only K1 and K2 are used, as by the source, after the rotation that a boresight takes [px]."""
    f, _, _, cx, cy, k1, k2, *_ = parameters(camera)
    wrong = camera_of(np.array([f, 0, 0, cx, cy, k1, k2, 0, 0, 0]), camera.size_px)
    rays = image_rays(camera)
    return unturned(camera, rays, displacements(wrong, camera, rays))


def left_field(result: StudyResult, point: str) -> Float[Array, "k"]:
    """What a calibration leaves over the image: RMS over the runs, each without its rotation [px]."""
    camera = true_camera(result)
    rays, x = image_rays(camera), parameters(camera)
    squares = [
        np.sum(unturned(camera, rays, displacements(camera_of(x + dx, camera.size_px), camera, rays)) ** 2, axis=1)
        for dx in errors(result, point)
    ]
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))


def claims(result: StudyResult) -> pd.DataFrame:
    """What 3.2 says of the interior orientation, what was found, and whether it holds."""
    camera, point = true_camera(result), chosen(result)
    clear = [n for n, share in zip(NAMES, parameters_table(result)["true / sigma"], strict=True) if share > 3]
    unclear = [n for n in NAMES if n not in clear]
    own = own_corner_px(camera)
    left = iteration_errors(camera, own)
    most = max(c for c in range(1, 40) if iteration_errors(camera, c)[2] < ENOUGH_PX)
    lost, kept = np.linalg.norm(reduced_field(camera), axis=1), left_field(result, point)
    rms = float(np.sqrt(np.mean(lost**2)))
    points = over_points(result)
    # Only there the stated noise is the true one.
    nees = points["nees"][~points["photographs"].astype(bool)].to_numpy(float)
    low, high = band(len(NAMES), result.runs, _LEVEL)
    inside = int(((nees >= low) & (nees <= high)).sum())
    rows: list[Claim] = [
        (
            "the parameters were determined by a bundle adjustment with known object points",
            f"from 12 photographs of a flat wall, to {float(np.median(kept)):.3f} px over the image; "
            f"NEES inside its 95 % band at {inside} of {len(nees)} points with measured corners",
            holds(inside >= 0.8 * len(nees) and bool(np.median(kept) < ENOUGH_PX), bool(np.median(kept) < 1)),
        ),
        (
            "K₁ to B₂ are parameters of the interior orientation and must be determined",
            f"more than three sigmas from zero: {', '.join(clear)}; not: {', '.join(unclear) or 'none'}",
            holds(not unclear, len(clear) >= 8),
        ),
        (
            "only two iterations are needed to correct the distortion of the lens used",
            f"after 0, 1 and 2 of them a lens of {own:.1f} px in the corner is off by {left[0]:.1f}, {left[1]:.2f} and "
            f"{left[2]:.4f} px; two leave less than {ENOUGH_PX:g} px up to {most} px in the corner",
            holds(bool(left[2] < ENOUGH_PX <= left[1]), bool(left[2] < ENOUGH_PX)),
        ),
        (
            "only K₁ and K₂ are used in what follows",
            f"with our lens that costs up to {lost.max():.2f} px, RMS {rms:.2f} px: less than the 5.6 px that the "
            f"source's ortho images are off (4.1.2), but {rms / np.sqrt(np.mean(kept**2)):.0f} times what a "
            "calibration leaves",
            holds(bool(lost.max() < 0.5), bool(lost.max() < _SOURCE_ORTHO_PX)),
        ),
    ]
    return pd.DataFrame(rows, columns=["the source says", "found here", "holds"])
