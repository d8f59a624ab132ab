"""Where things appear in aerial images, how far away they are, and what hides what."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from sim.aerial import AerialScene, AerialWorld, Sunlight, VehicleStates, measure, render
from sim.aerial.ground import GroundPlan, PaintedGround, Strip
from sim.aerial.library import Instances, Library, Mesh, Texture, places, polygon
from sim.aerial.materials import Material
from sim.camera import Camera
from sim.meshes.shapes import SHAPES
from sim.pose import Pose, exp_so3
from sim.roads import RoadNetwork
from sim.terrain import ElevationGrid, relief

Array = np.ndarray
BOUNDS = (-60.0, -60.0, 60.0, 60.0)
# A frame of 25 m at 0.1 m, strongly distorted for its small field of view.
CAMERA = Camera(
    np.array([[4000, 0.6, 130], [0, 4004, 124], [0, 0, 1.0]]), (256, 250), np.array([-8, 50, 4e-2, -3e-2, 9])
)
T_WC = Pose(np.diag([1.0, -1, -1]) @ exp_so3(np.array([0.02, -0.015, 0.3])), np.array([1.0, -2.0, 420.0]))
DARK = Material(0.25, 0.25, 0.25, 0.0, 0.0, 0.0, 0.0)


def terrain() -> ElevationGrid:
    """Hills whose steepest slope is some 10 %."""
    return relief(BOUNDS, 15.0, np.random.default_rng(1), rms_m=1.0, wavelengths_m=(60.0, 120.0), height_m=20.0)


def markers(n: int = 5) -> Array:
    """Points on a grid inside the image's footprint, off the pixels' own grid."""
    x, y = np.meshgrid(np.linspace(-8.0, 8.0, n), np.linspace(-8.0, 8.0, n))
    centre = CAMERA.size_px[0] / 2, CAMERA.size_px[1] / 2
    ray = T_WC.R @ np.array([*CAMERA.normalise(np.array(centre)), 1.0])
    middle = terrain().intersect(T_WC.t, ray)[:2]
    return np.stack([x.ravel(), y.ravel()], axis=-1) + middle + np.random.default_rng(2).uniform(-0.1, 0.1, (n * n, 2))


def plate(size_m: float, z: float = 0.0) -> Mesh:
    """A level square, white, that looks up."""
    h = size_m / 2
    return polygon(np.array([[-h, -h, z], [h, -h, z], [h, h, z], [-h, h, z]]), np.full((4, 2), 0.5), 0)


def vehicle(xy: tuple[float, float] = (0.0, 0.0), n: int = 1) -> VehicleStates:
    """A parked sedan of the number 7, or none."""
    size = np.tile(SHAPES["sedan"].size_m, (n, 1))
    heading, speed = np.full(n, 0.4), np.zeros(n)
    return VehicleStates(
        np.full(n, 7), np.zeros(n, int), np.tile(xy, (n, 1)).astype(float), heading, speed, size, np.full((n, 3), 0.5)
    )


def scene(
    paint: tuple[object, ...] = (),
    meshes: tuple[Mesh, ...] = (),
    at: Array | None = None,
    states: VehicleStates | None = None,
) -> AerialScene:
    """A dark world with white markers and plates, lit from everywhere."""
    world = AerialWorld(
        terrain(), RoadNetwork.of([]), BOUNDS, sunlight=Sunlight(sky=1.0, visibility_m=1e9),
    )  # fmt: skip
    strip = Strip(shapely.box(*BOUNDS), 60)
    plan = GroundPlan(DARK, (), (strip,) if paint else (), (), paint, worn_paint=0.0)
    ground = PaintedGround(plan, BOUNDS, np.random.default_rng(0))
    library = Library.of(meshes or (plate(1.0),), [Texture(np.ones((2, 2, 4)), repeat=True)])
    n = 0 if at is None else len(at)
    standing = Instances(
        np.zeros(n, int),
        places(np.broadcast_to(np.eye(3), (n, 3, 3)), np.reshape(at if n else [], (-1, 3))),
        np.zeros((n, 3)),
    )
    none = np.zeros((0, 3), np.float32)
    return AerialScene(world, ground, library, standing, (), states or vehicle(n=0), none)


def centroids(image: Array, near: Array, radius: int = 10) -> Array:
    """Centroids of white patches on dark ground around points (n, 2), the same however worn the white is."""
    out = []
    for u, v in np.round(near).astype(int):
        part = image[v - radius : v + radius + 1, u - radius : u + radius + 1].mean(axis=2).astype(float)
        dark, white = np.quantile(part, 0.1), np.quantile(part, 0.9)
        w = np.clip((part - dark) / (white - dark) - 0.2, 0, 0.5)
        i, j = np.mgrid[-radius : radius + 1, -radius : radius + 1]
        out.append([u + np.sum(w * j) / w.sum(), v + np.sum(w * i) / w.sum()])
    return np.array(out)


@pytest.mark.parametrize("samples", [1, 2])
def test_painted_points_appear_where_the_camera_projects_them(samples: int) -> None:
    """Discs of 1.2 m on hilly ground, through a distorting lens."""
    xy = markers()
    true = CAMERA.project(T_WC.inv().apply(terrain().on_ground(xy)))
    image = render(scene(tuple(shapely.Point(p).buffer(0.6) for p in xy)), CAMERA, T_WC, samples=samples)
    error = centroids(image, true) - true
    assert np.abs(error.mean(axis=0)).max() < 0.04
    assert np.abs(error).max() < 0.1


def test_elevated_points_appear_where_the_camera_projects_them() -> None:
    """Plates of 0.8 m at different heights above ground."""
    xy = markers()
    up = np.random.default_rng(3).uniform(0.5, 30.0, len(xy))
    points = terrain().on_ground(xy) + up[:, None] * [0, 0, 1]
    true = CAMERA.project(T_WC.inv().apply(points))
    seen = CAMERA.contains(true) & (np.abs(true - 125) < 110).all(axis=1)
    image = render(scene((), (plate(0.8),), points), CAMERA, T_WC, samples=2)
    error = centroids(image, true[seen]) - true[seen]
    assert seen.sum() >= 12
    # Sampled at half pixels, an edge of eight pixels is off by 0.5 / sqrt(12 * 16) px at most two sigma.
    assert np.abs(error).max() < 0.1


def test_depth_is_that_of_the_ground_and_of_what_stands_on_it() -> None:
    at = np.array([[0.0, 0.0, 30.0]])
    truth = measure(scene((), (plate(6.0),), at), CAMERA, T_WC)
    u, v = np.meshgrid(np.arange(256.0), np.arange(250.0))
    ray = np.concatenate([CAMERA.normalise(np.stack([u, v], -1)), np.ones((250, 256, 1))], axis=-1)
    ground = terrain().intersect(T_WC.t, ray @ T_WC.R.T)
    depth = (ground - T_WC.t) @ T_WC.R[:, 2]
    bare = truth.instance == -1
    assert bare.any()
    # Linear between nodes 0.8 m apart: a crease of 15 % between cells of the hills is cut by 0.2 m * 15 %.
    assert np.abs(truth.depth - depth)[bare].max() < 0.03
    plate_ = truth.instance == -3
    assert plate_.any()
    level = T_WC.t[2] + truth.depth * (ray @ T_WC.R.T)[..., 2]
    np.testing.assert_allclose(level[plate_], 30.0, atol=5e-4)  # single precision of 1/depth


def test_what_reaches_into_the_image_from_far_outside_is_seen() -> None:
    """A plate of 400 m with corners at eight times the image's radius, where Brown's polynomial has folded back."""
    at = np.array([[0.0, 0.0, 30.0]])
    truth = measure(scene((), (plate(400.0),), at), CAMERA, T_WC)
    assert (truth.instance == -3).all()


def test_a_vehicle_is_seen_where_it_is_and_as_far_as_nothing_hides_it() -> None:
    middle = markers()[12]
    state = vehicle((float(middle[0]), float(middle[1])))
    box = plate(4.6, 1.4)
    free = measure(scene((), (box,), None, state), CAMERA, T_WC)
    own = free.instance == 7
    assert own.sum() == free.vehicles.pixels[0]
    assert free.vehicles.hidden[0] == pytest.approx(0.0, abs=0.02)
    above = terrain().on_ground(middle) + np.array([2.3, 0.0, 10.0])
    half = measure(scene((), (box,), above[None], state), CAMERA, T_WC)
    assert 0.05 < half.vehicles.hidden[0] < 0.95
    assert (half.instance == 7).sum() == half.vehicles.pixels[0] < free.vehicles.pixels[0]


def test_an_image_of_the_sky_and_one_beyond_the_ground_are_drawn() -> None:
    up = Pose(np.eye(3), np.array([0.0, 0.0, 400.0]))
    truth = measure(scene(), CAMERA, up)
    assert (truth.instance == -2).all()
    assert np.isnan(truth.depth).all()
    assert render(scene(), CAMERA, up).shape == (250, 256, 3)


def test_shadows_lie_where_the_sun_throws_them() -> None:
    """A plate 10 m above level-ish ground, the sun in the south at 45 degrees: its shadow lies 10 m to the north."""
    middle = np.array([*markers()[12], 0.0])
    ground = terrain().on_ground(middle[:2] + np.array([0.0, 5.0]))
    at = np.array([[middle[0], ground[1] - 10.0, ground[2] + 10.0]])
    base = scene((), (plate(2.0),), at)
    sun = Sunlight(azimuth_deg=180.0, elevation_deg=45.0, sky=0.2, visibility_m=1e9)
    world = AerialWorld(base.world.terrain, base.world.roads, BOUNDS, sunlight=sun)
    image = render(replace(base, world=world), CAMERA, T_WC, samples=2)
    u, v = np.round(CAMERA.project(T_WC.inv().apply(ground))).astype(int)
    lit = np.median(image)
    assert image[v, u].mean() < 0.6 * lit
    assert image[v - 3 : v + 4, u - 3 : u + 4].mean() < 0.7 * lit


def test_haze_takes_contrast_and_the_balance_tints() -> None:
    xy = markers()
    base = scene(tuple(shapely.Point(p).buffer(0.6) for p in xy))

    def contrast_and_tint(sun: Sunlight) -> tuple[float, float]:
        image = render(replace(base, world=replace(base.world, sunlight=sun)), CAMERA, T_WC).astype(float)
        return float(np.quantile(image, 0.99) - np.quantile(image, 0.1)), float(np.mean(image[..., 0] - image[..., 2]))

    clear = contrast_and_tint(Sunlight(sky=1.0, visibility_m=1e9))
    hazy = contrast_and_tint(Sunlight(sky=1.0, visibility_m=2000.0))
    warm = contrast_and_tint(Sunlight(sky=1.0, visibility_m=1e9, balance=(1.2, 1.0, 0.8)))
    assert hazy[0] < 0.8 * clear[0]
    assert warm[1] > clear[1] + 10


def test_supersampling_only_smooths() -> None:
    """One and nine samples per pixel agree in the mean, and no pixel of nine is lighter than the lightest of one."""
    at = np.array([[0.0, 0.0, 30.0]])
    one, nine = (render(scene((), (plate(6.0),), at), CAMERA, T_WC, samples=n).astype(float) for n in (1, 3))
    assert abs(one.mean() - nine.mean()) < 0.3
    assert nine.max() <= one.max() + 1
    assert len(np.unique(nine)) > len(np.unique(one))


def test_an_image_needs_samples() -> None:
    with pytest.raises(ValueError, match="samples"):
        render(scene(), CAMERA, T_WC, samples=0)
