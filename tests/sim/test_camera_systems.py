"""The source's two camera systems: what they see from their height, how they are mounted, when they expose."""

from __future__ import annotations

import numpy as np
import pytest

from sim.angles import camera_pose
from sim.camera_systems import CameraSystem, Trigger, antar, argos, exposures

NORTH = np.zeros(3)


def footprint(system: CameraSystem, name: str, height_m: float) -> np.ndarray:
    """Ground (east, north) of the image's corners, flying north: top left, top right, bottom right, bottom left."""
    head = next(head for head in system.heads if head.name == name)
    w, h = head.camera.size_px
    T_wc = camera_pose(NORTH, np.array([0, 0, height_m]), 0.0, head.mounting)
    corners = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])
    rays = head.camera.unproject(corners, np.ones(4)) @ T_wc.R.T
    return np.asarray(T_wc.t[:2] - rays[:, :2] * T_wc.t[2] / rays[:, 2:])


def test_argos_from_1400_metres() -> None:
    """0.20 m ground sampling; 1009 x 673 m with the IMU at 1400.1 m and the camera a decimetre below."""
    head = argos().heads[0]
    assert head.ground_sampling_m(1400.0) == pytest.approx(0.20, abs=0.005)
    corners = footprint(argos(), "nadir", 1400.1)
    np.testing.assert_allclose(np.ptp(corners, axis=0), [1008, 672], atol=1e-6)  # 36/50 and 24/50 of the height
    np.testing.assert_allclose(corners[0], [-504, 336], atol=1e-6)  # top left is left and ahead


def test_antar_from_500_metres() -> None:
    mono, thermal = antar().heads
    assert mono.ground_sampling_m(500.0) == pytest.approx(0.2)
    assert (mono.camera.size_px, thermal.camera.size_px) == ((1024, 1024), (320, 240))
    width = [np.ptp(footprint(antar(), name, 500.0), axis=0)[0] for name in ("mono", "thermal")]
    assert width[0] == pytest.approx(width[1])


def test_mount_of_90_degrees_turns_the_top_of_the_image_to_the_right() -> None:
    turned = footprint(argos(mount_deg=90.0), "nadir", 1400.1)
    np.testing.assert_allclose(np.ptp(turned, axis=0), [672, 1008], atol=1e-6)
    np.testing.assert_allclose(turned[0], [336, 504], atol=1e-6)  # top left of the image: right and ahead


@pytest.mark.parametrize("mount_deg", [0.0, 90.0])
def test_three_heads_look_left_down_and_right(mount_deg: float) -> None:
    """Tilted about the flight direction by 35 degrees, however they are turned about their own axes."""
    for name, tilt in (("left", -35.0), ("nadir", 0.0), ("right", 35.0)):
        head = next(head for head in argos(3, mount_deg).heads if head.name == name)
        view = camera_pose(NORTH, np.zeros(3), 0.0, head.mounting).R[:, 2]
        np.testing.assert_allclose(view, [np.sin(np.deg2rad(tilt)), 0, -np.cos(np.deg2rad(tilt))], atol=1e-14)
    if mount_deg == 0:
        left, nadir = footprint(argos(3), "left", 1400.0), footprint(argos(3), "nadir", 1400.0)
        assert left[:, 0].max() > nadir[:, 0].min()  # the swaths overlap
        assert left[:, 0].min() == pytest.approx(-1399.9 * np.tan(np.deg2rad(35 + 19.8)), rel=1e-3)


def test_antar_exposes_steadily() -> None:
    exposed = exposures(antar(), [(0.0, 10.0), (100.0, 101.0)], 1, 0)
    mono = exposed.t_s[(exposed.head == 0) & (exposed.line == 0)]
    np.testing.assert_allclose(mono, np.arange(51) / 5, atol=1e-12)
    assert np.sum((exposed.head == 1) & (exposed.line == 0)) == 251
    np.testing.assert_allclose(exposed.t_s[(exposed.head == 0) & (exposed.line == 1)], 100 + np.arange(6) / 5)
    assert np.all(np.diff(exposed.t_s) >= 0)


def test_argos_bursts_and_pauses() -> None:
    exposed = exposures(argos(3), [(0.0, 3000.0)], 1, 0)
    heads = [exposed.t_s[exposed.head == i] for i in range(3)]
    np.testing.assert_array_equal(heads[0], heads[1])  # one trigger for all heads
    np.testing.assert_array_equal(heads[0], heads[2])
    t, burst = heads[0], exposed.burst[exposed.head == 0]
    assert t[0] == 0
    assert t[-1] <= 3000
    gaps, new = np.diff(t), np.diff(burst) > 0
    np.testing.assert_allclose(gaps[~new], 1 / 3, atol=1e-9)
    assert gaps[new].min() >= 7
    assert gaps[new].max() <= 10
    # Uniform in 7-10 s: mean 8.5, sigma 0.87 of some 330 pauses.
    assert gaps[new].mean() == pytest.approx(8.5, abs=4 * 0.87 / np.sqrt(new.sum()))
    assert set(np.unique(burst, return_counts=True)[1][:-1]) == {2, 3, 4}


def test_streams_of_lines_are_their_own() -> None:
    one = exposures(argos(), [(0.0, 60.0)], 1, 0)
    two = exposures(argos(), [(0.0, 60.0), (100.0, 160.0)], 1, 0)
    np.testing.assert_array_equal(one.t_s, two.t_s[two.line == 0])
    assert len(exposures(argos(), [(0.0, 60.0)], 1, 1)) > 0
    assert not np.array_equal(one.t_s[:8], exposures(argos(), [(0.0, 60.0)], 1, 1).t_s[:8])
    assert len(exposures(argos(), [], 1, 0)) == 0


def test_refusals() -> None:
    for change, message in (
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"burst_frames": (3, 2)}, "burst_frames"),
        ({"pause_s": (5.0, 3.0)}, "pause_s"),
    ):
        with pytest.raises(ValueError, match=message):
            Trigger(**({"name": "x", "rate_hz": 1.0} | change))
    with pytest.raises(ValueError, match="1 or 3"):
        argos(2)
