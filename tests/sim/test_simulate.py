"""One simulation: the same bits wherever it runs, honest noise, and a clear word where nothing can be measured."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from sim.observations import Observations
from sim.pose import log_so3
from sim.scenario import Scenario, ScenarioError
from sim.simulate import look, simulate
from sim.truth import Truth
from sim.world import World

Array = np.ndarray
Maker = Callable[..., Scenario]
Product = tuple[Observations, Truth]

GRID = {
    "name": "target",
    "mesh": "point_grid",
    "motion": {"kind": "straight", "start_m": [-1.0, 20.0], "heading_deg": 180.0, "speed_mps": 10.0},
}
OUTLIERS = [{"kind": k, "tracks": 0.1} for k in ("noise", "stereo", "temporal", "segmentation", "reflection")]


def digest(product: Product) -> str:
    """All bits of what was observed."""
    tracks, sha = product[0].tracks, hashlib.sha256()
    ego = product[0].T_wc
    for a in (tracks.frame, tracks.track, tracks.uv_left, tracks.uv_right, tracks.cov, product[0].t_s):
        sha.update(np.ascontiguousarray(a).tobytes())
    if ego is not None:
        sha.update(ego.R.tobytes() + ego.t.tobytes())
    return sha.hexdigest()


@pytest.fixture(scope="module")
def product(scenario: Scenario, world: World) -> Product:
    return simulate(scenario, 0, world)


def test_rows_and_columns_agree(product: Product, world: World) -> None:
    o, truth = product
    n = len(o.tracks)
    assert len(truth.labels.kind) == len(truth.labels.uv_true) == n
    np.testing.assert_array_equal(truth.track, np.unique(o.tracks.track))
    np.testing.assert_array_equal(truth.visible_points, np.bincount(o.tracks.frame, minlength=20))
    assert truth.visible_points.max() == 60
    # The truth's geometry is that of its pixels.
    for k in range(20):
        rows = o.tracks.frame == k
        p = truth.points_c(np.array([k]), o.tracks.track[rows])[0]
        np.testing.assert_allclose(world.rig.project(p), truth.labels.uv_true[rows], atol=1e-9)


def test_truth_moves_as_its_poses(product: Product) -> None:
    """Velocities of the truth are the derivatives of its poses, to the second order of the frame interval."""
    truth = product[1]
    p = truth.T_cv.apply(truth.reference_v)
    dt = truth.t_s[2:] - truth.t_s[:-2]
    velocity = (p[2:] - p[:-2]) / dt[:, None]
    # Turning with 0.7 rad/s at 8 m/s: v omega² dt²/6 = 1 mm/s, and as much at the clothoid's begin.
    np.testing.assert_allclose(truth.reference_velocity_c()[1:-1], velocity, atol=5e-3)
    R = truth.T_cv.R
    omega = log_so3(R[2:] @ np.swapaxes(R[:-2], 1, 2)) / dt[:, None]
    np.testing.assert_allclose(truth.relative_omega_c()[1:-1], omega, atol=2e-2)  # ramp of 1.4 rad/s², rounded corners
    assert np.abs(truth.reference_velocity_c()).max() > 7


def test_the_second_time_the_bits_are_the_same(make_scenario: Maker, product: Product) -> None:
    """The world built anew, too."""
    assert digest(simulate(make_scenario())) == digest(product)


def test_runs_may_share_a_view(make_scenario: Maker, world: World) -> None:
    """Whatever noise and outliers a run draws, the next one finds the view as it was."""
    scenario = make_scenario(outliers=OUTLIERS)
    view = look(scenario, world)
    shared = [digest(simulate(scenario, run, world, view)) for run in (0, 1, 0)]
    assert shared == [digest(simulate(scenario, run, world)) for run in (0, 1, 0)]


def test_another_process_makes_the_same_bits(make_scenario: Maker, tmp_path: Path) -> None:
    scenario = make_scenario(outliers=OUTLIERS)
    (tmp_path / "scenario.json").write_text(scenario.model_dump_json(by_alias=True))
    code = (
        "import sys; from pathlib import Path; from sim.scenario import Scenario; from sim.simulate import simulate;"
        "simulate(Scenario.model_validate_json(Path(sys.argv[1]).read_text()))[0].save(Path(sys.argv[2]))"
    )
    environment = os.environ | {"PYTHONHASHSEED": "12345", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", code, str(tmp_path / "scenario.json"), str(tmp_path / "there")]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    here = simulate(scenario)[0]
    here.save(tmp_path / "here")
    (a,), (b,) = (list((tmp_path / name).iterdir()) for name in ("here", "there"))
    assert a.read_bytes() == b.read_bytes()


def test_another_run_and_another_seed_draw_other_noise(make_scenario: Maker, product: Product, world: World) -> None:
    other_run = simulate(make_scenario(), 1, world)
    assert digest(other_run) != digest(product)
    # The same world and the same surface points: the noise-free pixels do not change with the run.
    np.testing.assert_array_equal(other_run[1].labels.uv_true, product[1].labels.uv_true)
    assert np.mean(other_run[0].tracks.uv == product[0].tracks.uv) < 0.01
    assert digest(simulate(make_scenario(seed=8), 0, world)) != digest(product)


def test_a_car_that_hides_nothing_changes_nothing(make_scenario: Maker, scenario: Scenario, product: Product) -> None:
    fields = scenario.model_dump(mode="json", exclude_none=True)["vehicle"]
    far = {"name": "far", "mesh": "bus", "motion": {"kind": "straight", "start_m": [20.0, 60.0], "speed_mps": 5.0}}
    assert digest(simulate(make_scenario(vehicle=[*fields, far]))) == digest(product)
    assert digest(simulate(make_scenario(vehicle=fields[:1]))) == digest(product)


def test_how_pictures_look_does_not_matter(make_scenario: Maker, product: Product, world: World) -> None:
    assert digest(simulate(make_scenario(render={"shadows": False}), 0, world)) == digest(product)


def test_noise_is_the_injected_one_and_uncorrelated(make_scenario: Maker, world: World) -> None:
    o, truth = simulate(make_scenario(measure={"sigma_px": 0.3, "stated_sigma_px": 0.5}), 0, world)
    noise = (o.tracks.uv - truth.labels.uv_true) / 0.3
    n = len(noise)
    assert n > 1000
    # 4.5 standard deviations each: mean, standard deviation, the six correlations - left and right above all.
    assert np.abs(noise.mean(axis=0)).max() < 4.5 / np.sqrt(n)
    assert np.abs(noise.std(axis=0) - 1).max() < 4.5 / np.sqrt(2 * n)
    assert np.abs(np.corrcoef(noise.T) - np.eye(4)).max() < 4.5 / np.sqrt(n)
    # Nor in time: the noise of a track in one frame says nothing of that in the next.
    same = np.array([np.flatnonzero((o.tracks.track == t) & (o.tracks.frame == f + 1)) for t, f in
                     zip(o.tracks.track, o.tracks.frame, strict=True)], dtype=object)  # fmt: skip
    pairs = np.array([(i, int(s[0])) for i, s in enumerate(same) if len(s)])
    lagged = np.mean(noise[pairs[:, 0]] * noise[pairs[:, 1]])
    assert abs(lagged) < 4.5 / np.sqrt(4 * len(pairs))
    np.testing.assert_array_equal(truth.labels.sigma_px, 0.3)
    # Estimators are told another one.
    np.testing.assert_allclose(o.tracks.cov, np.broadcast_to(0.25 * np.eye(4), (n, 4, 4)))


def test_without_noise_the_pixels_are_true(make_scenario: Maker, world: World) -> None:
    o, truth = simulate(make_scenario(measure={"sigma_px": 0.0, "stated_sigma_px": 0.2}), 0, world)
    np.testing.assert_array_equal(o.tracks.uv, truth.labels.uv_true)


def test_missing_frames_are_missing_and_nothing_else(make_scenario: Maker, product: Product, world: World) -> None:
    o, truth = simulate(make_scenario(measure={"missing_frames": [0, 7, 8, 99]}), 0, world)
    kept = ~np.isin(product[0].tracks.frame, [0, 7, 8])
    np.testing.assert_array_equal(o.tracks.uv, product[0].tracks.uv[kept])
    np.testing.assert_array_equal(o.tracks.track, product[0].tracks.track[kept])
    np.testing.assert_array_equal(truth.visible_points[[0, 7, 8]], 0)
    np.testing.assert_array_equal(o.t_s, product[0].t_s)


def test_a_standing_ego_car_is_not_observed_a_moving_one_is(make_scenario: Maker, product: Product) -> None:
    assert product[0].T_wc is None
    drive = {"kind": "straight", "start_m": [0.0, 0.0], "speed_mps": 10.0}
    o, truth = simulate(make_scenario(vehicle=[GRID], ego={"motion": drive}))
    assert o.T_wc is not None
    np.testing.assert_array_equal(o.T_wc.t, truth.T_wc.t)
    np.testing.assert_allclose(truth.ego_velocity_w, [[0, 10, 0]] * 20, atol=1e-9)
    hidden, _ = simulate(make_scenario(vehicle=[GRID], ego={"motion": drive, "observed": False}))
    assert hidden.T_wc is None
    seen, _ = simulate(make_scenario(vehicle=[GRID], ego={"observed": True}))
    assert seen.T_wc is not None


def test_noise_of_the_observed_ego_poses(make_scenario: Maker) -> None:
    ego = {"observed": True, "sigma_position_m": 0.1, "sigma_rotation_deg": 0.5}
    rig = {"frames": 400, "rate_hz": 1000.0}
    o, truth = simulate(make_scenario(vehicle=[GRID], rig=rig, ego=ego, measure={"points": 1}))
    assert o.T_wc is not None
    shift = (o.T_wc.t - truth.T_wc.t) / 0.1
    turn = np.rad2deg(log_so3(o.T_wc.R @ np.swapaxes(truth.T_wc.R, 1, 2))) / 0.5
    # 1200 values each: 4.5 standard deviations of a standard deviation.
    assert shift.std() == pytest.approx(1, abs=4.5 / np.sqrt(2400))
    assert turn.std() == pytest.approx(1, abs=4.5 / np.sqrt(2400))


def test_estimators_are_given_the_nominal_rig(make_scenario: Maker) -> None:
    rig = {"nominal": {"baseline_m": 0.31}}
    o, truth = simulate(make_scenario(vehicle=[GRID], rig=rig))
    assert o.rig.T_rl.t[0] == pytest.approx(-0.31)
    assert truth.rig.T_rl.t[0] == pytest.approx(-0.30)


@pytest.mark.parametrize(
    "motion",
    [
        {"kind": "straight", "start_m": [0.0, -30.0], "speed_mps": 1.0},
        {"kind": "straight", "start_m": [100.0, 20.0], "speed_mps": 1.0},
    ],
    ids=["behind", "beside"],
)
@pytest.mark.parametrize("mesh", ["point_grid", "sedan"])
def test_a_target_that_is_never_visible_is_refused(make_scenario: Maker, motion: dict[str, Any], mesh: str) -> None:
    vehicle = {"name": "target", "mesh": mesh, "motion": motion}
    with pytest.raises(ScenarioError, match="'target' is never visible"):
        simulate(make_scenario(vehicle=[vehicle]))


def test_all_frames_missing_is_refused(make_scenario: Maker, world: World) -> None:
    with pytest.raises(ScenarioError, match="never visible"):
        simulate(make_scenario(measure={"missing_frames": list(range(20))}), 0, world)


@pytest.mark.parametrize(
    ("key", "table"),
    [
        ("rig", {"focal_px": float("nan")}),
        ("rig", {"frames": 0}),
        ("rig", {"baseline_m": -0.3}),
        ("measure", {"sigma_px": -0.1}),
        ("measure", {"sigma_px": float("inf")}),
        ("measure", {"points": 0}),
        ("measure", {"sigma_px": 0.0}),
        ("ego", {"sigma_position_m": float("nan")}),
    ],
)
def test_numbers_that_are_none_are_refused(make_scenario: Maker, key: str, table: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        make_scenario(**{key: table})


def test_one_frame_can_be_simulated(make_scenario: Maker) -> None:
    o, truth = simulate(make_scenario(vehicle=[GRID], rig={"frames": 1}))
    assert len(o.t_s) == 1
    assert len(o.tracks) == 60
    np.testing.assert_allclose(truth.velocity_w, [[0, -10, 0]], atol=1e-9)


def test_points_to_be_tracked_in_images_are_none_yet(make_scenario: Maker, world: World, product: Product) -> None:
    """What could be tracked is known from the geometry: as many points as are projected."""
    o, truth = simulate(make_scenario(measure={"from": "images"}), 0, world)
    assert len(o.tracks) == len(truth.track) == len(truth.labels.kind) == 0
    np.testing.assert_array_equal(truth.visible_points, product[1].visible_points)
    np.testing.assert_array_equal(truth.T_wc.t, product[1].T_wc.t)


def test_products_return_from_disk(product: Product, tmp_path: Path) -> None:
    product[0].save(tmp_path / "observations")
    product[1].save(tmp_path / "truth")
    o, truth = Observations.load(tmp_path / "observations"), Truth.load(tmp_path / "truth")
    assert digest((o, truth)) == digest(product)
    np.testing.assert_array_equal(truth.labels.uv_true, product[1].labels.uv_true)
    np.testing.assert_array_equal(truth.bodies[1].T_wv.R, product[1].bodies[1].T_wv.R)
    assert [b.name for b in truth.bodies] == ["target", "neighbour"]
    assert truth.labels.kinds == ()
