"""Thermal images: what is warm and what is cold, the same geometry as in colour, and the camera's noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.aerial import AerialScene, AerialWorld, Sunlight, VehicleStates, build, buildings, measure, render
from sim.aerial.heads import picture
from sim.aerial.presets import motorway_world
from sim.aerial.thermal import ThermalSensor, Weather, grey, render_thermal, sense
from sim.camera import Camera
from sim.camera_systems import Head, antar, argos
from sim.meshes import VEHICLE_KINDS
from sim.pose import Pose

Array = np.ndarray
FINE = Camera.simple((320, 240), 2000.0)


@pytest.fixture(scope="module")
def world() -> AerialWorld:
    return motorway_world(1, jam=True, duration_s=2.0, length_m=1400.0)


@pytest.fixture(scope="module")
def summer(world: AerialWorld) -> AerialScene:
    return build(world)


@pytest.fixture(scope="module")
def winter(world: AerialWorld) -> AerialScene:
    return build(replace(world, season="winter"))


def above(scene: AerialScene, xy: Array, height_m: float = 300.0) -> Pose:
    return Pose(np.diag([1.0, -1, -1]), scene.world.terrain.on_ground(xy) + np.array([0, 0, height_m]))


def on_road(scene: AerialScene) -> Pose:
    road = scene.world.roads.edges[0]
    return above(scene, road.at(np.array(road.length_m / 2))[0])


def at(image: Array, T_wc: Pose, scene: AerialScene, xy: Array) -> float:
    u, v = np.round(FINE.project(T_wc.inv().apply(scene.world.terrain.on_ground(xy)))).astype(int)
    return float(image[v, u])


def road_and_grass(scene: AerialScene) -> tuple[float, float]:
    """Medians over the bare asphalt at the lanes' edges, and over the embankment beside it."""
    road = scene.world.roads.edges[0]
    T_wc = on_road(scene)
    image = render_thermal(scene, FINE, T_wc, samples=2)
    p, d = road.at(road.length_m / 2 + np.linspace(-15.0, 15.0, 61))
    n = np.stack([-d[:, 1], d[:, 0]], axis=-1)
    asphalt, grass = (
        float(np.median([at(image, T_wc, scene, x) for x in p + side * (road.width_m / 2 + off) * n]))
        for side, off in ((-1, -1.0), (-1, 3.0))
    )
    return asphalt, grass


def test_asphalt_in_the_sun_is_warmer_than_grass(summer: AerialScene) -> None:
    asphalt, grass = road_and_grass(summer)
    air = Weather.of(summer.world).air_K
    assert air < grass < air + 8
    assert air + 10 < asphalt < air + 25


def test_snow_is_below_zero_and_the_swept_road_is_warmer(summer: AerialScene, winter: AerialScene) -> None:
    road, verge = road_and_grass(winter)
    assert verge < 273.15
    assert road > verge + 1.5
    assert road < road_and_grass(summer)[0] - 20


def test_snow_lies_on_roofs_too() -> None:
    warm, cold = (buildings.textures(np.random.default_rng(1), season)[0] for season in ("summer", "winter"))
    np.testing.assert_array_equal(warm.texels, cold.texels)
    assert warm.warmth()[..., 1].mean() > 3 * cold.warmth()[..., 1].mean()


def one_car(scene: AerialScene, driving: bool) -> AerialScene:
    """The scene with one grey sedan of the jam, which is driving or parked, and nothing else that moves."""
    traffic = scene.world.traffic
    assert traffic is not None
    states = scene.vehicles(0.0)
    sedans = np.flatnonzero((states.kind == VEHICLE_KINDS.index("sedan")) & (states.speed_mps > 0))
    chosen = states.of(sedans[:1])
    number = int(chosen.number[0])
    if driving:
        only = traffic.of(np.array([number]))
        paint = np.full((1, 3), 0.3, np.float32)
        return replace(scene, world=replace(scene.world, traffic=only), paint=paint, parked=states.of(np.zeros(0, int)))
    still = VehicleStates(
        chosen.number, chosen.kind, chosen.xy_m, chosen.heading, np.zeros(1), chosen.size_m, np.full((1, 3), 0.3)
    )
    return replace(scene, world=replace(scene.world, traffic=None), parked=still)


def bonnet_and_roof(scene: AerialScene) -> tuple[float, float]:
    car = scene.vehicles(0.0)
    T_wc = above(scene, car.xy_m[0], 150.0)
    image = render_thermal(scene, FINE, T_wc, samples=2)
    ahead = np.array([np.sin(car.heading[0]), np.cos(car.heading[0])])
    length = car.size_m[0, 0]
    bonnet, roof = (car.xy_m[0] + share * length * ahead for share in (0.40, -0.08))
    return at(image, T_wc, scene, bonnet), at(image, T_wc, scene, roof)


def test_a_driving_car_has_a_hot_bonnet_and_a_cool_roof(summer: AerialScene) -> None:
    hot, cool = bonnet_and_roof(one_car(summer, driving=True))
    parked, heated = bonnet_and_roof(one_car(summer, driving=False))
    assert hot > parked + 8
    assert hot > cool + 10
    assert abs(parked - heated) < 4
    assert heated > cool + 1  # the jam moves on: some wind


def test_shadows_are_cooler_and_keep_some_warmth(summer: AerialScene) -> None:
    """A parked car throws one on the asphalt, a driving one throws none."""
    there = one_car(summer, driving=False)
    T_wc = above(there, there.vehicles(0.0).xy_m[0], 150.0)
    gone = replace(there, parked=there.parked.of(np.zeros(0, int)))
    lit, dark = (render(s, FINE, T_wc, samples=2).astype(float).sum(axis=2) for s in (gone, there))
    shadow = (dark < 0.75 * lit) & (measure(there, FINE, T_wc).instance == -1)
    assert shadow.sum() > 100
    sunny, shaded, passed = (
        np.median(render_thermal(s, FINE, T_wc, samples=2)[shadow])
        for s in (gone, there, one_car(summer, driving=True))
    )
    assert shaded < sunny - 5
    assert shaded > Weather.of(summer.world).air_K + 1
    assert passed == pytest.approx(sunny, abs=0.1)


def test_clouds_take_the_contrast(summer: AerialScene) -> None:
    cloudy = replace(summer, world=replace(summer.world, sunlight=Sunlight(sky=1.0)))
    clear = np.subtract(*road_and_grass(summer))
    assert 3 < np.subtract(*road_and_grass(cloudy)) < 0.6 * clear  # what asphalt has stored stays


def test_the_geometry_is_that_of_the_colour_image(summer: AerialScene) -> None:
    """Edges of vehicles lie where their instances end: no pixel of a car is as the asphalt around it."""
    T_wc = on_road(summer)
    image, seen = render_thermal(summer, FINE, T_wc, 1.0, samples=1), measure(summer, FINE, T_wc, 1.0)
    cars = seen.instance >= 0
    assert cars.sum() > 300
    asphalt = road_and_grass(summer)[0]
    assert np.mean(np.abs(image[cars] - asphalt) > 2) > 0.8


def test_heads_give_their_bands_the_same_every_time(summer: AerialScene) -> None:
    T_wc = on_road(summer)
    mono, thermal = antar().heads
    (colour,) = argos().heads

    def taken(head: Head) -> Array:
        return picture(summer, head.band, FINE, T_wc, 1.0, 1, np.random.default_rng(3))

    assert taken(colour).shape == (240, 320, 3)
    for head in (mono, thermal):
        image = taken(head)
        assert image.shape == (240, 320)
        assert image.dtype == np.uint8
        np.testing.assert_array_equal(image, taken(head))
    assert abs(np.corrcoef(taken(mono).ravel(), taken(thermal).ravel())[0, 1]) < 0.9
    assert 40 < taken(thermal).mean() < 200


def test_the_sensor_has_its_noise_and_its_pattern() -> None:
    kelvin, sensor = np.full((240, 320), 300.0, np.float32), ThermalSensor()
    frames = np.stack([sense(kelvin, sensor, np.random.default_rng(k)) for k in range(40)]) / 100
    # 40 frames of 76800 pixels: the deviation to 0.1 %; 14 bits and hundredths add 4 % to its square.
    assert frames.std(axis=0).mean() == pytest.approx(0.08 * np.sqrt(39 / 40), rel=0.03)
    assert frames.mean(axis=0).std() == pytest.approx(np.hypot(0.06, 0.08 / np.sqrt(40)), rel=0.05)
    assert frames.mean() == pytest.approx(300.0, abs=0.02)
    other = sense(kelvin, replace(sensor, pattern=1), np.random.default_rng(0))
    assert np.mean(other != sense(kelvin, sensor, np.random.default_rng(0))) > 0.5


def test_a_grey_picture_is_linear_in_its_span() -> None:
    values = np.array([[28000, 29000, 30000, 31000, 32000]], np.uint16)
    np.testing.assert_array_equal(grey(values, (290.0, 310.0)), [[0, 0, 128, 255, 255]])
    with pytest.raises(ValueError, match="span_K"):
        grey(values, (300.0, 300.0))


def test_wrong_calls_are_refused(summer: AerialScene) -> None:
    with pytest.raises(ValueError, match="samples"):
        render_thermal(summer, FINE, on_road(summer), samples=0)
    with pytest.raises(ValueError, match="rgb, mono, thermal, got 'infrared'"):
        picture(summer, "infrared", FINE, on_road(summer), 0.0, 1, np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"ThermalSensor\.netd_K"):
        ThermalSensor(netd_K=-1.0)
    with pytest.raises(ValueError, match="range_K"):
        ThermalSensor(range_K=(300.0, 200.0))
