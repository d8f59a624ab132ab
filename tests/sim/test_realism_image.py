"""What every disturbance on the way from the world to the sensor does to an image, and what it leaves alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.camera import Camera
from sim.model import Model
from sim.pose import Pose
from sim.realism import Shot, disturbed
from sim.realism.contrast import rolling_contrast, veil_density
from sim.realism.dirt import dirty, spots
from sim.realism.glare import glaring, sun_share
from sim.realism.rain import Drops, drops, rainy
from sim.realism.steps import exposure_gain
from sim.realism.tone import to_image, to_light
from sim.realism.wander import Wander
from sim.realism.wiper import Wiper, across_m, blade_opacity
from sim.scenario import Realism
from sim.streams import stream

Array = np.ndarray
SIZE = (320, 240)
CAMERA = Camera.simple(SIZE, 320.0)
BASELINE_M = 0.3
WHITE_SUN = np.array([1.7, 1.6, 1.4])
AHEAD = np.array([0.0, -np.sin(0.3), np.cos(0.3)])  # 17 degrees up
KEYS: dict[str, dict[str, Any]] = {
    "contrast": {"contrast": 0.7},
    "glare": {"glare": 0.5},
    "dirt": {"dirt": 0.8},
    "rain": {"rain": 0.8},
    "wiper": {"wiper_s": 0.8},
    "steps": {"exposure_step_ev": 2.0},
}


@pytest.fixture(scope="module")
def image() -> Array:
    """Coarse and fine structure of all grey values."""
    rng = np.random.default_rng(4)
    fine = rng.uniform(-45, 45, (240, 320, 3))
    coarse = cv2.resize(rng.uniform(60, 190, (6, 8, 3)), SIZE, interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.clip(fine + coarse, 0, 255), np.uint8)


def shot(side: str = "left", t_s: float = 0.9, **changes: Any) -> Shot:
    offset = 0.0 if side == "left" else BASELINE_M
    return replace(Shot(CAMERA, side, offset, BASELINE_M, 3, 0, t_s, AHEAD, WHITE_SUN), **changes)


def detail(image: Array) -> Array:
    """Image without what is coarser than a corner window."""
    grey = image.astype(np.float32)
    coarse: Array = cv2.GaussianBlur(grey, (0, 0), 4)
    return np.asarray(grey - coarse)


def same_share(a: Array, b: Array) -> float:
    return float(np.all(a == b, axis=-1).mean())


def test_tone_inverts_the_response_of_the_shaders() -> None:
    grey = np.tile(np.arange(256, dtype=np.uint8)[:, None, None], (1, 4, 3))
    light = to_light(grey)
    np.testing.assert_array_equal(to_image(light), grey)
    x = light.astype(float)
    toned = np.sqrt(np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1))  # surface.frag
    assert np.abs(255 * toned - grey).max() < 1e-3


def test_without_disturbances_the_very_same_image_comes_back(image: Array) -> None:
    assert disturbed(image, Realism(), shot()) is image
    drawn = Realism(reflections=1, shadows=1, exposure_ms=10, occluders=3)  # what is drawn acts before
    assert disturbed(image, drawn, shot()) is image


@pytest.mark.parametrize("setting", KEYS.values(), ids=KEYS)
def test_each_is_deterministic_in_seed_run_side_and_time_and_leaves_its_input(
    image: Array, setting: dict[str, Any]
) -> None:
    realism, before = Realism(**setting), image.copy()
    wiper = Wiper.before(CAMERA, BASELINE_M, 0.8, 3, 0)
    t_s = wiper.start_s - wiper.low_m / wiper.speed_mps if "wiper_s" in setting else 0.9  # the blade before the middle
    first = disturbed(image, realism, shot(t_s=t_s))
    np.testing.assert_array_equal(first, disturbed(image, realism, shot(t_s=t_s)))
    np.testing.assert_array_equal(image, before)
    assert first.shape == image.shape
    assert same_share(first, image) < 0.99
    if "glare" not in setting:  # nothing random in it
        assert not np.array_equal(first, disturbed(image, realism, shot(t_s=t_s, run=1)))
        assert not np.array_equal(first, disturbed(image, realism, shot(t_s=t_s, seed=4)))


@pytest.mark.parametrize("key", ["contrast", "glare", "dirt", "exposure_step_ev"])
def test_a_small_level_does_little_and_more_does_more(image: Array, key: str) -> None:
    def change(level: float) -> float:
        return float(
            np.abs(disturbed(image, Realism.model_validate({key: level}), shot()).astype(float) - image).mean()
        )

    assert change(1e-4) < 0.5
    assert change(0.1) < change(0.4) < change(1.0)


def test_wander_has_unit_variance_and_its_correlation() -> None:
    rng = np.random.default_rng(0)
    pairs = np.array([[w.at(0.3), w.at(0.7)] for w in (Wander.draw(rng, 0.4) for _ in range(4000))])
    assert np.abs(pairs.mean(axis=0)).max() < 3.5 / np.sqrt(4000)
    np.testing.assert_allclose(pairs.var(axis=0), 1, atol=3.5 * np.sqrt(2 / 4000))
    assert abs(np.mean(pairs[:, 0] * pairs[:, 1]) - np.exp(-0.5)) < 3.5 * np.sqrt(2 / 4000)


def test_local_contrast_falls_by_the_veils_density_and_rolls_on() -> None:
    rng = np.random.default_rng(1)
    light = rng.uniform(0.2, 0.6, (240, 320, 3)).astype(np.float32)
    veil = veil_density(1.0, 3, 0, 0.9, SIZE)
    out = rolling_contrast(light, 1.0, 3, 0, "left", 0.9)
    contrast = detail(out).std() / cv2.blur(out, (31, 31)).mean() / (detail(light).std() / light.mean())
    assert abs(contrast - (1 - veil).mean()) < 0.05
    assert veil.min() >= 0
    assert veil.max() <= 0.71
    later = [np.abs(veil_density(1.0, 3, 0, 0.9 + dt, SIZE) - veil).mean() for dt in (0.04, 0.4)]
    assert later[0] < 0.4 * later[1]


def test_the_cameras_share_the_veil_but_their_gains_differ_by_a_few_percent(image: Array) -> None:
    ratios = []
    for seed in range(40):
        left, right = (
            rolling_contrast(to_light(image), 1.0, seed, 0, side, 0.5).astype(float) for side in ("left", "right")
        )
        ratio = left / right
        assert ratio.std() < 1e-4
        ratios.append(np.log(ratio.mean()))
    assert 0.04 < np.std(ratios) < 0.11  # 0.05 sqrt(2) with 11 % of error from 40 samples


@given(st.floats(0.3, 1.2), st.floats(0.1, 1.0))
def test_the_veil_is_that_of_stiles_and_holladay(theta: float, level: float) -> None:
    """In the middle of a black image, by a sun ``theta`` above it: 10 E / theta² for the eye, and 3 level of it."""
    sun_c = np.array([0.0, -np.sin(theta), np.cos(theta)])
    out = glaring(np.zeros((240, 320, 3), np.float32), level, CAMERA, sun_c, np.ones(3))
    illuminance = np.pi * np.cos(theta)
    # Ghosts lie on the image's vertical axis: look beside it.
    beside = CAMERA.unproject(np.array([300.0, 119.5]), np.array(1.0))
    angle = np.rad2deg(np.arccos(beside @ sun_c / np.linalg.norm(beside)))
    np.testing.assert_allclose(out[119:121, 300].mean(axis=0), 3 * level * 10 * illuminance / angle**2, rtol=0.02)


def test_glare_takes_contrast_and_a_hidden_sun_or_one_behind_only_blooms(image: Array) -> None:
    light = to_light(image)
    free = glaring(light, 0.5, CAMERA, AHEAD, WHITE_SUN)
    hidden = glaring(light, 0.5, CAMERA, AHEAD, np.zeros(3))
    behind = glaring(light, 0.5, CAMERA, AHEAD * [1, 1, -1], WHITE_SUN)
    np.testing.assert_array_equal(hidden, behind)
    assert detail(to_image(free)).std() < 0.7 * detail(image).std()
    assert abs(hidden.mean() / light.mean() - 1) < 0.02  # what is scattered away comes in elsewhere
    assert free.mean() > 1.3 * light.mean()


def test_the_sun_shines_through_the_image_where_it_stands() -> None:
    grey = np.full((240, 320, 3), 60, np.uint8)
    sun_c = np.array([-0.15, -0.2, 1.0]) / np.linalg.norm([-0.15, -0.2, 1.0])
    out = disturbed(grey, Realism(glare=0.2), shot(sun_c=sun_c)).sum(axis=2)
    v, u = np.nonzero(out == out.max())
    assert np.abs(np.array([u.mean(), v.mean()]) - CAMERA.project(sun_c)).max() < 2
    assert out.max() == 3 * 255


def wall(width: float, bottom: float) -> Model:
    v = np.array([[-width, 0, bottom], [width, 0, bottom], [width, 0, 50], [-width, 0, 50]], float)
    return Model("wall", ((),), (), v, np.array([[0, 1, 2], [0, 2, 3]]), (2 * width, 0.1, 50.0 - bottom))


@pytest.mark.parametrize(("bottom", "share"), [(-1.0, 0.0), (30.0, 1.0), (12.0 * np.tan(0.3), 0.5)])
def test_things_hide_the_sun_by_the_share_of_its_disc(bottom: float, share: float) -> None:
    """A wall 12 m ahead that begins at a height; the camera's axes, z up for the wall."""
    T_cb = Pose(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0, 0, 12.0]))
    assert abs(sun_share([(wall(20.0, bottom), T_cb)], AHEAD) - share) < 0.25
    assert sun_share([(wall(20.0, -1.0), T_cb)], AHEAD * [1, 1, -1]) == 1.0
    assert sun_share([], AHEAD) == 1.0


def test_dirt_stands_still_covers_a_quarter_and_lies_elsewhere_for_the_other_camera(image: Array) -> None:
    covered = [float((spots(CAMERA, 1.0, seed, 0, "left") > 0.15).mean()) for seed in range(12)]
    assert 0.15 < np.mean(covered) < 0.4
    left, right = (spots(CAMERA, 1.0, 3, 0, side) for side in ("left", "right"))
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.4
    assert np.all(left >= spots(CAMERA, 0.5, 3, 0, "left") - 1e-6)  # a higher level adds spots
    realism = Realism(dirt=1.0)
    first, later = (disturbed(image, realism, shot(t_s=t)) for t in (0.2, 0.9))
    np.testing.assert_array_equal(first, later)
    clear = left < 1e-3
    out = dirty(to_light(image), left)
    np.testing.assert_array_equal(to_image(out)[clear], image[clear])
    assert detail(to_image(out))[left > 0.5].std() < 0.6 * detail(image)[left > 0.5].std()


def test_a_drop_shows_the_scene_upside_down_within_its_rim() -> None:
    """Sky above, road below: seen through a drop in the middle the road is above."""
    light = np.full((240, 320, 3), 1.0, np.float32)
    light[120:] = 0.1
    out = rainy(light, Drops(np.array([[160.0, 119.5]]), np.array([20.0])), CAMERA)
    assert out[105, 160].max() < 0.3
    assert out[134, 160].min() > 0.8
    far = np.hypot(*(np.indices((240, 320)) - np.array([119.5, 160.0])[:, None, None])) > 20 + 12
    np.testing.assert_array_equal(out[far], light[far])


def test_drops_stay_until_they_run_off_and_others_fall() -> None:
    camera = Camera.simple((1024, 768), 1000.0)
    fallen = [drops(camera, 1.0, None, 0.0, 1, 0, "left", t) for t in (1.0, 1.04, 30.0)]
    places = [set(map(tuple, f.uv)) for f in fallen]
    assert len(places[0] & places[1]) > 0.9 * len(places[0])
    assert not places[0] & places[2]
    other = drops(camera, 1.0, None, 0.3, 1, 0, "right", 1.0)
    assert not places[0] & set(map(tuple, other.uv))
    heavy, light = (np.mean([len(drops(camera, x, None, 0, s, 0, "left", 0).uv) for s in range(8)]) for x in (1, 0.25))
    assert abs(light / heavy - 0.25) < 0.08


def test_the_wiper_takes_the_drops_with_it() -> None:
    camera = Camera.simple((1024, 768), 1000.0)
    wiper = Wiper.before(camera, BASELINE_M, 2.0, 1, 0)
    sweep = (wiper.high_m - wiper.low_m) / wiper.speed_mps
    back = wiper.start_s + 2 * sweep
    n = [len(drops(camera, 1.0, wiper, 0.0, 1, 0, "left", back + dt).uv) for dt in (0.01, 1.0, 2.0 - 2 * sweep - 0.01)]
    assert n[0] < 0.2 * n[1] < 0.2 * n[2]
    # Half-way of a pass what the blade has passed is clear, the rest is not.
    x = np.array([0.5 * (wiper.low_m + 0.0), 0.05])
    t = wiper.start_s + 2.0 + (0.0 - wiper.low_m) / wiper.speed_mps
    since = t - wiper.wiped_s(x, t)
    assert since[0] < sweep
    assert since[1] > 2.0 - 2 * sweep


def test_the_blade_passes_the_right_camera_later_by_the_baseline_over_its_speed() -> None:
    wiper = Wiper.before(CAMERA, BASELINE_M, 2.0, 1, 0)
    delay = BASELINE_M / wiper.speed_mps
    t = wiper.start_s + (0.0 - wiper.low_m) / wiper.speed_mps
    left, right = (blade_opacity(CAMERA, wiper, x, s, 0.0) for x, s in ((0.0, t), (BASELINE_M, t + delay)))
    assert left is not None
    assert right is not None
    np.testing.assert_allclose(left, right, atol=1e-6)
    assert blade_opacity(CAMERA, wiper, 0.0, wiper.start_s - 0.5, 0.0) is None
    v, u = np.nonzero(left > 0.9)
    assert abs(across_m(CAMERA, np.stack([u, v], axis=-1).astype(float), 0.0).mean()) < 0.002
    smeared = blade_opacity(CAMERA, wiper, 0.0, t, 0.02)
    assert smeared is not None
    assert smeared.max() < left.max()
    np.testing.assert_allclose(smeared[120].sum(), left[120].sum(), rtol=0.01)  # the same dark for longer


def test_exposure_steps_are_sudden_and_die_away_the_same_for_both_cameras(image: Array) -> None:
    t = np.arange(0, 5, 0.002)
    ev = np.log2([exposure_gain(2.0, 5, 0, float(x)) for x in t])
    jumps = np.flatnonzero(np.abs(np.diff(ev)) > 0.5)
    assert len(jumps) == 5
    sizes = np.abs(np.diff(ev)[jumps])
    assert sizes.min() > 0.95
    assert sizes.max() <= 2.0
    between = np.delete(np.diff(ev), jumps)
    assert np.abs(between).max() < 0.03
    k = int(jumps[0]) + 1
    later = k + 150  # 0.3 s
    if not np.any((jumps >= k) & (jumps < later)):
        assert abs(ev[later] / ev[k] - np.exp(-1)) < 0.02
    realism = Realism(exposure_step_ev=2.0)
    left, right = (disturbed(image, realism, shot(side)) for side in ("left", "right"))
    np.testing.assert_array_equal(left, right)
    assert exposure_gain(2.0, 5, 0, 0.0) == 1.0


def test_streams_of_different_disturbances_do_not_shift_each_other(image: Array) -> None:
    """Adding rain leaves the dirt where it was."""
    both = disturbed(image, Realism(dirt=1.0, rain=0.3), shot())
    dirt = disturbed(image, Realism(dirt=1.0), shot())
    assert same_share(both, dirt) > 0.5
    assert stream(3, 0, "camera/left/dirt").random() != stream(3, 0, "camera/left/rain/0").random()
