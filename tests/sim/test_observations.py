"""What an estimator may know: refused where broken, the same after a round trip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim.camera import Camera, StereoRig
from sim.observations import Observations, Tracks
from sim.pose import Pose, exp_so3

RIG = StereoRig.normal_case(Camera.simple((640, 480), 500.0), 0.3)


def tracks() -> Tracks:
    rng = np.random.default_rng(0)
    return Tracks(
        frame=np.array([0, 0, 1, 1, 3]),
        track=np.array([0, 4, 0, 4, 4]),
        uv_left=rng.uniform(0, 400, (5, 2)),
        uv_right=rng.uniform(0, 400, (5, 2)),
        cov=np.broadcast_to(np.eye(4) * 0.04, (5, 4, 4)),
    )


def observations(ego: bool = True) -> Observations:
    t = np.array([0.0, 0.04, 0.09, 0.12])
    r = np.linspace(0, 0.1, 12).reshape(4, 3)
    return Observations(
        t,
        RIG,
        tracks(),
        "target",
        Pose(exp_so3(r), 10 * r) if ego else None,
        (("l/0.png", "r/0.png"),) * 4 if ego else None,
        ("m/0.png",) * 4 if ego else None,
    )


@pytest.mark.parametrize("ego", [True, False])
def test_round_trip(tmp_path: Path, ego: bool) -> None:
    o = observations(ego)
    o.save(tmp_path / "observations")
    p = Observations.load(tmp_path / "observations")
    np.testing.assert_array_equal(p.t_s, o.t_s)
    for name in ("frame", "track", "uv_left", "uv_right", "cov"):
        assert getattr(p.tracks, name).dtype == getattr(o.tracks, name).dtype
        np.testing.assert_array_equal(getattr(p.tracks, name), getattr(o.tracks, name))
    np.testing.assert_array_equal(p.rig.left.K, RIG.left.K)
    np.testing.assert_array_equal(p.rig.T_rl.t, RIG.T_rl.t)
    assert p.rig.right.size_px == (640, 480)
    assert (p.entity, p.images, p.masks) == (o.entity, o.images, o.masks)
    assert (p.T_wc is None) == (not ego)
    if ego:
        assert p.T_wc is not None
        assert o.T_wc is not None
        np.testing.assert_array_equal(p.T_wc.R, o.T_wc.R)


def test_round_trip_without_any_observation(tmp_path: Path) -> None:
    o = replace(observations(), tracks=Tracks.none())
    o.save(tmp_path)
    p = Observations.load(tmp_path)
    assert len(p.tracks) == 0
    assert p.tracks.cov.shape == (0, 4, 4)


def test_saved_twice_the_bytes_are_the_same(tmp_path: Path) -> None:
    observations().save(tmp_path / "a")
    observations().save(tmp_path / "b")
    (a,), (b,) = (list((tmp_path / f).iterdir()) for f in "ab")
    assert a.read_bytes() == b.read_bytes()


@pytest.mark.parametrize(
    ("name", "value"),
    [("uv_left", np.nan), ("uv_left", np.inf), ("uv_right", np.nan), ("uv_right", np.inf), ("cov", np.nan)],
)
def test_what_is_not_finite_is_refused_by_name(name: str, value: float) -> None:
    broken = np.array(getattr(tracks(), name))
    broken[3].flat[0] = value
    with pytest.raises(ValueError, match=rf"Tracks\.{name}: not finite in row 3 \(frame 1, track 4\)"):
        replace(tracks(), **{name: broken})


def test_an_infinite_variance_says_nothing() -> None:
    cov = np.array(tracks().cov)
    cov[3, 1, 1] = np.inf
    assert replace(tracks(), cov=cov).informative.tolist() == [True, True, True, False, True]
    cov[3, 0, 1] = np.nan
    with pytest.raises(ValueError, match=r"Tracks\.cov: not finite in row 3"):
        replace(tracks(), cov=cov)


@pytest.mark.parametrize(
    ("frame", "track"),
    [([0, 1, 0, 1, 3], [0, 4, 0, 4, 4]), ([0, 0, 1, 1, 3], [4, 0, 0, 4, 4]), ([0, 0, 1, 1, 3], [4, 4, 0, 4, 4])],
    ids=["frames", "tracks", "twice"],
)
def test_unsorted_rows_are_refused(frame: list[int], track: list[int]) -> None:
    with pytest.raises(ValueError, match="sorted by"):
        replace(tracks(), frame=np.array(frame), track=np.array(track))


def test_rows_must_belong_together() -> None:
    # Shape annotations refuse it in the tests, the constructor elsewhere.
    with pytest.raises((ValueError, TypeError)):
        replace(tracks(), frame=np.arange(4))


def test_rows_are_selected() -> None:
    t = tracks().select(tracks().track == 4)
    np.testing.assert_array_equal(t.frame, [0, 1, 3])
    np.testing.assert_array_equal(t.uv, np.concatenate([tracks().uv_left, tracks().uv_right], axis=1)[[1, 3, 4]])


@pytest.mark.parametrize("t_s", [[0, 0.04, 0.04, 0.1], [0, 0.04, 0.03, 0.1], [0, np.nan, 0.1, 0.2], [0, 1, 2, np.inf]])
def test_times_must_increase(t_s: list[float]) -> None:
    with pytest.raises(ValueError, match=r"Observations\.t_s"):
        replace(observations(), t_s=np.array(t_s))


def test_frames_and_ego_poses_must_fit_the_times() -> None:
    with pytest.raises(ValueError, match=r"frame outside 0\.\.2"):
        replace(observations(False), t_s=np.arange(3.0))
    with pytest.raises(ValueError, match="expected 4 poses"):
        replace(observations(), T_wc=Pose.identity((3,)))
    with pytest.raises(ValueError, match="frame outside"):
        replace(observations(), tracks=replace(tracks(), frame=np.array([-1, -1, 1, 1, 3])))


def test_every_frame_has_its_images() -> None:
    with pytest.raises(ValueError, match=r"Observations\.images: expected 4 frames, got 1"):
        replace(observations(), images=(("l/0.png", "r/0.png"),))
    with pytest.raises(ValueError, match=r"Observations\.masks: expected 4 frames, got 5"):
        replace(observations(), masks=("m/0.png",) * 5)


def test_ego_poses_must_be_finite() -> None:
    with pytest.raises(ValueError, match=r"Observations\.T_wc: not finite"):
        replace(observations(), T_wc=Pose(np.eye(3)[None].repeat(4, 0), np.full((4, 3), np.nan)))


def test_covariances_must_be_positive() -> None:
    """A standard deviation of zero would weigh without end."""
    cov = np.array(tracks().cov)
    cov[2] = 0
    with pytest.raises(ValueError, match=r"Tracks\.cov: not positive definite in row 2 \(frame 1, track 0\)"):
        replace(tracks(), cov=cov)
    cov[2] = np.diag([1, 1, -1, 1])
    with pytest.raises(ValueError, match="not positive definite"):
        replace(tracks(), cov=cov)


def test_nothing_can_be_written_into() -> None:
    o = observations()
    for a in (o.t_s, o.tracks.uv_left, o.tracks.cov, o.rig.left.K):
        with pytest.raises(ValueError, match="read-only"):
            a.flat[0] = 0
