"""The images of a flight, and what only drawing can tell: which vehicles and which control points they show."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from jaxtyping import Float, UInt8

from sim.aerial import AerialScene, AerialTruth, build, measure
from sim.aerial.heads import picture
from sim.archive import write_text
from sim.camera import Camera
from sim.exif import exif_block
from sim.flight_camera import FlightCamera
from sim.flight_observations import CONTROL, IMAGES, ROADS
from sim.flight_simulation import RUN, FlownFlight
from sim.flight_truth import VEHICLE_COLUMNS
from sim.meshes import VEHICLE_KINDS
from sim.navigation import ImageRecord
from sim.pose import Pose
from sim.roads.files import write_roads
from sim.scenario.flight import FlightScenario
from sim.streams import stream

Array = np.ndarray
# A control point is seen where the surface at its pixel is no nearer than itself by more.
_HIDDEN_M = 0.5
_MARGIN_PX = 5.0


def write_flight(spec: FlightScenario, flown: FlownFlight, scratch: Path, advance: Callable[[], None]) -> None:
    """Writes observations/ and truth/ of a flight below a folder; ``advance`` is called after every image."""
    observations, truth = flown.observations, flown.truth
    scene = build(flown.world)
    cameras = {c.name: c for c in truth.cameras}
    images = scratch / "observations" / IMAGES
    images.mkdir(parents=True)
    rows: list[pd.DataFrame] = []
    clicks: list[tuple[int, int, Array]] = []
    for i, record in enumerate(observations.records):
        head, T_wc, world_s = cameras[record.head], truth.T_wc[i], float(flown.world_s[i])
        _write_image(images / record.file, _picture(spec, scene, head, T_wc, world_s, i), record, spec)
        seen = measure(scene, head.camera, T_wc, world_s)
        rows.append(_vehicles(i, float(truth.t_s[i]), seen, head.camera, T_wc, flown))
        clicks += [(i, k, uv) for k, uv in _signals(seen, head.camera, T_wc, truth.control)]
        if spec.imaging.truth_images:
            _write_truth(scratch / "truth" / "images" / record.file, seen)
        advance()
    observations.save(scratch / "observations", flown.road_map)
    if len(truth.control):
        _write_clicks(scratch / "observations" / CONTROL, spec, flown, clicks)
    truth.save(scratch / "truth", pd.concat(rows, ignore_index=True))
    write_roads(flown.world.roads, observations.georeference, scratch / "truth" / ROADS)


def _picture(
    spec: FlightScenario, scene: AerialScene, head: FlightCamera, T_wc: Pose, world_s: float, image: int
) -> UInt8[Array, "h w *c"]:
    rng = stream(spec.seed, RUN, f"flight/sensor/{head.name}/{image}")
    return picture(scene, head.band, head.camera, T_wc, world_s, spec.imaging.samples, rng)


def _write_image(path: Path, image: Array, record: ImageRecord, spec: FlightScenario) -> None:
    """JPEG or PNG by the file's suffix, with the record as EXIF."""
    bgr = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    quality = spec.imaging.jpeg_quality
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if path.suffix == ".jpg" and quality else []
    exif = np.frombuffer(exif_block(record), np.uint8)
    if not cv2.imwriteWithMetadata(str(path), bgr, [cv2.IMAGE_METADATA_EXIF], [exif], options):
        raise OSError(f"{path}: cannot be written")


def _write_truth(path: Path, seen: AerialTruth) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path.with_suffix(".npz"), depth=seen.depth, instance=seen.instance)


def _vehicles(
    image: int, t_s: float, seen: AerialTruth, camera: Camera, T_wc: Pose, flown: FlownFlight
) -> pd.DataFrame:
    states = seen.vehicles.states
    xyz = flown.world.terrain.on_ground(states.xy_m)
    uv = camera.project(T_wc.inv().apply(xyz))
    columns: dict[str, Any] = {"image": image, "t_s": t_s, "vehicle": states.number}
    columns |= {"kind": [VEHICLE_KINDS[k] for k in states.kind]}
    columns |= {f"{axis}_m": xyz[:, k] for k, axis in enumerate("xyz")}
    columns |= {"heading_deg": np.rad2deg(states.heading) % 360, "speed_mps": states.speed_mps}
    columns |= {f"{name}_m": states.size_m[:, k] for k, name in enumerate(("length", "width", "height"))}
    columns |= {"u_px": uv[:, 0], "v_px": uv[:, 1], "pixels": seen.vehicles.pixels, "hidden": seen.vehicles.hidden}
    return pd.DataFrame(columns, index=range(len(states)))[list(VEHICLE_COLUMNS)]


def _signals(
    seen: AerialTruth, camera: Camera, T_wc: Pose, control: Float[Array, "n 3"]
) -> list[tuple[int, Float[Array, "2"]]]:
    """Control points that an image shows, and where."""
    if not len(control):
        return []
    p_c = T_wc.inv().apply(control)
    uv = camera.project(p_c)
    found = []
    for k in np.flatnonzero(camera.contains(uv, _MARGIN_PX) & (p_c[:, 2] > 0)):
        column, row = np.rint(uv[k]).astype(int)
        if seen.depth[row, column] > p_c[k, 2] - _HIDDEN_M:
            found.append((int(k), uv[k]))
    return found


def _write_clicks(path: Path, spec: FlightScenario, flown: FlownFlight, clicks: list[tuple[int, int, Array]]) -> None:
    """The list in ODM's form: points measured by DGPS, clicked with noise."""
    georeference, control = flown.observations.georeference, flown.truth.control
    rng = stream(spec.seed, RUN, "flight/clicks")
    dgps = stream(spec.seed, RUN, "flight/dgps").normal(0, spec.control.sigma_m, control.shape)
    grid = georeference.to_grid(control + dgps)
    lines = [f"EPSG:{georeference.epsg}"]
    for image, k, uv in clicks:
        u, v = uv + rng.normal(0, spec.control.sigma_px, 2)
        east, north, height = grid[k]
        name = flown.observations.records[image].file
        lines.append(f"{east:.4f} {north:.4f} {height:.4f} {u:.4f} {v:.4f} {name} P{k:03d}")
    write_text(path, "\n".join(lines) + "\n")
