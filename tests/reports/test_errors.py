"""Known offsets give known errors, in every gauge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.estimate import EstimationFailed, Failure
from estimators.stereo.vehicle import interpret
from reports.errors import ERROR_COLUMNS, SMOOTHED, comparison_table
from reports.windows import compare_window, inlier_tracks, standard_deviations, transport_jacobian
from sim.pose import Pose, exp_so3, log_so3

# Products of poses of some 40 m, in double precision.
EXACT = 1e-12 * 1e3


def column(table, quantity, axis, entity="target"):
    rows = table[(table["quantity"] == quantity) & (table["axis"] == axis) & (table["entity"] == entity)]
    assert len(rows)
    return rows["error"].to_numpy()


def test_the_truth_has_no_error(world, keys):
    table = comparison_table(world.truth, world.tracks, world.estimate, **keys)
    assert list(table.columns)[: len(ERROR_COLUMNS)] == ERROR_COLUMNS
    assert np.abs(table["error"]).max() < 1e-7  # 1e-12 m over 0.04 s, over a lever of some metres
    assert set(table["quantity"]) == {
        *("position", "orientation", "reference_point", "velocity", "angular_rate", "speed", "yaw_rate", "shape"),
        *("centroid_speed", "driving_direction"),
        *("centroid_speed_across", "driving_direction_across", "yaw_rate_across"),
    }
    assert not table[["t_s", "error"]].isna().any(axis=None)


def test_known_offset_is_the_position_error_of_every_frame(world, keys):
    offset = np.array([0.1, -0.2, 0.7])
    table = comparison_table(world.truth, world.tracks, world.moved(Pose(np.eye(3), offset)), **keys)
    for entity in ("target", SMOOTHED):
        for i, axis in enumerate("xyz"):
            np.testing.assert_allclose(column(table, "position", axis, entity), offset[i], atol=EXACT)
    np.testing.assert_allclose(column(table, "shape", "all"), 0, atol=EXACT)
    np.testing.assert_allclose(column(table, "speed", "all"), 0, atol=1e-7)


def test_turned_cloud_is_the_orientation_error(world, keys):
    turn = np.array([0.02, -0.05, 0.03])
    estimate = world.with_windows(
        lambda w: replace(
            w, T_co=Pose.stack([_turn_about_centroid(T, w.X_o, turn) for T in (w.T_co[i] for i in range(len(w.T_co)))])
        )
    )
    table = comparison_table(world.truth, world.tracks, estimate, **keys)
    for i, axis in enumerate("xyz"):
        np.testing.assert_allclose(column(table, "orientation", axis), turn[i], atol=EXACT)
        np.testing.assert_allclose(column(table, "position", axis), 0, atol=EXACT)


def _turn_about_centroid(T, X, turn):
    R, c = exp_so3(turn), T.apply(X).mean(axis=0)
    return Pose(R, c - R @ c) @ T


def test_wrong_velocity_is_the_velocity_error(world, keys):
    dv, dt = np.array([0.3, 0.0, -0.5]), 1 / 25

    def faster(w):
        steps = np.arange(len(w.frames))[:, None] * dv * dt
        return replace(w, T_co=Pose(np.broadcast_to(np.eye(3), (len(steps), 3, 3)), steps) @ w.T_co)

    table = comparison_table(world.truth, world.tracks, world.with_windows(faster), **keys)
    for i, axis in enumerate("xyz"):
        np.testing.assert_allclose(column(table, "velocity", axis), dv[i], atol=1e-9)
    true = world.truth.reference_velocity_c()[5]
    expected = np.linalg.norm(true + dv) - np.linalg.norm(true)
    np.testing.assert_allclose(column(table, "speed", "all"), expected, atol=1e-9)


def test_deformed_cloud_is_the_shape_error(world, keys):
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.05, world.truth.point_v.shape)
    table = comparison_table(
        world.truth, world.tracks, world.with_windows(lambda w: replace(w, X_o=w.X_o + noise)), **keys
    )
    shape = column(table, "shape", "all")
    np.testing.assert_allclose(shape, shape[0], atol=1e-9)
    assert 0.05 < shape[0] < 0.05 * np.sqrt(3) * 1.2  # three axes of 0.05 m, less 6 of 72 degrees of freedom


def test_a_change_of_gauge_changes_nothing(world, keys):
    noisy = world.moved(Pose.exp(np.array([0.01, 0.02, -0.01, 0.1, 0.2, 0.5])))
    Q, s = exp_so3(np.array([1.0, 0.3, -2.0])), np.array([10.0, -20.0, 5.0])

    def regauged(w):
        T_co = Pose(w.T_co.R @ Q.T, w.T_co.t - (w.T_co.R @ (Q.T @ s)[:, None])[..., 0])
        return replace(w, T_co=T_co, X_o=w.X_o @ Q.T + s)

    other = replace(noisy, windows=tuple(regauged(w) for w in noisy.windows))
    a = comparison_table(world.truth, world.tracks, noisy, **keys)
    b = comparison_table(world.truth, world.tracks, other, **keys)
    # 1e-13 m of rounding at 50 m from the origin, over 0.04 s
    np.testing.assert_allclose(a["error"], b["error"], atol=1e-9)
    np.testing.assert_allclose(a["sigma"], b["sigma"], rtol=1e-9)


@pytest.mark.parametrize("over_ground", [False, True])
def test_turning_target_and_moving_ego(build_world, keys, over_ground):
    """Differences of two frames lag the instant by half an interval; nothing else remains."""
    w = build_world(yaw_rate=0.4, ego_speed=8.0, ego_yaw_rate=-0.2, ego_poses=over_ground)
    table = comparison_table(w.truth, w.tracks, w.estimate, **keys)
    dt, relative_rate = 0.04, 0.6
    lag = dt / 2 * relative_rate * 60  # |omega x v| with v up to 26 m/s: course, ego and target turn
    assert max(np.abs(column(table, "velocity", a)).max() for a in "xyz") < lag
    np.testing.assert_allclose(column(table, "yaw_rate", "all"), 0, atol=1e-9)
    speed = comparison_table(w.truth, w.tracks, w.estimate, **keys).query("quantity == 'speed'")
    if over_ground:
        np.testing.assert_allclose(speed["truth"], 10.0, atol=1e-12)
        np.testing.assert_allclose(speed["error"], 0, atol=1e-3)  # chord against arc: v (rate dt)^2 / 24
    else:
        assert speed["truth"].min() > 15
    rate = comparison_table(w.truth, w.tracks, w.estimate, **keys).query("quantity == 'yaw_rate'")
    np.testing.assert_allclose(rate["truth"], 0.4 if over_ground else 0.6, atol=1e-12)


def test_outlier_tracks_are_left_out(world):
    kind = world.truth.labels.kind.copy()
    row = int(np.flatnonzero((world.tracks.frame == 20) & (world.tracks.track == 7))[0])
    kind[row] = 1
    point_v = world.truth.point_v.copy()
    point_v[3] = np.nan
    truth = replace(world.truth, labels=replace(world.truth.labels, kind=kind), point_v=point_v)
    windows = {int(w.frames[-1]): w for w in world.estimate.windows}
    assert set(np.flatnonzero(~inlier_tracks(truth, world.tracks, windows[25]))) == {3, 7}
    assert set(np.flatnonzero(~inlier_tracks(truth, world.tracks, windows[19]))) == {3}
    assert set(np.flatnonzero(~inlier_tracks(truth, world.tracks, windows[30]))) == {3}
    compared = compare_window(truth, world.tracks, windows[25], None)
    assert compared is not None
    assert len(compared.track) == 22


def test_failures_have_rows(world, build_world, keys):
    whole = comparison_table(world.truth, world.tracks, EstimationFailed("no tracks", ("look",)), **keys)
    assert whole[["quantity", "entity", "error"]].to_numpy().tolist() == [["failure", "no tracks", 1.0]]
    w = build_world(failures=(Failure(12, "singular"),))
    table = comparison_table(w.truth, w.tracks, w.estimate, **keys)
    failed = table[table["quantity"] == "failure"]
    assert failed["entity"].tolist() == ["singular"]
    assert failed["t_s"].tolist() == [12 / 25]
    all_outliers = replace(w.truth, point_v=np.full_like(w.truth.point_v, np.nan))
    table = comparison_table(all_outliers, w.tracks, w.estimate, **keys)
    assert (table["quantity"] == "failure").all()
    assert len(table) == len(w.estimate.windows) + 1


def _two_frames(x, lever, dt):
    """Reference point, its velocity and the rotations, from (centroid, rotation, velocity, rate)."""
    d_new = exp_so3(x[3:6]) @ lever
    d_old = exp_so3(-x[9:12] * dt) @ d_new
    return np.concatenate([x[:3] + d_new, x[3:6], x[6:9] + (d_new - d_old) / dt, x[9:12]])


@pytest.mark.parametrize("omega", [np.zeros(3), np.array([0.1, -0.7, 0.3])])
def test_transport_jacobian_by_finite_differences(omega):
    lever, dt, h = np.array([0.5, 1.2, -2.0]), 0.04, 1e-6
    x0 = np.concatenate([np.zeros(6), np.array([1.0, 0, -9]), omega])
    steps = np.eye(12) * h
    numeric = np.stack([(_two_frames(x0 + s, lever, dt) - _two_frames(x0 - s, lever, dt)) / (2 * h) for s in steps], 1)
    # central differences: 1e-16 * 10 m/s / 1e-6 of rounding, divided by dt
    np.testing.assert_allclose(transport_jacobian(lever, omega, dt), numeric, atol=1e-7)


@pytest.mark.parametrize("over_ground", [False, True])
def test_sigma_of_speed_and_yaw_rate_by_sampling(build_world, over_ground):
    """Errors of windows disturbed by the covariance have its standard deviations."""
    w = build_world(yaw_rate=0.3, ego_speed=5.0, ego_yaw_rate=0.2, ego_poses=over_ground)
    window = w.estimate.windows[-1]
    base = compare_window(w.truth, w.tracks, window, w.estimate.T_wc)
    assert base is not None
    rng = np.random.default_rng(1)
    samples = rng.multivariate_normal(np.zeros(12), window.cov, 500)
    moved = [compare_window(w.truth, w.tracks, _disturbed(window, x), w.estimate.T_wc) for x in samples]
    expected = standard_deviations(window.cov, base.estimate)
    for quantity in ("speed", "yaw_rate"):
        values = [getattr(c.estimate, quantity) for c in moved if c is not None]
        assert np.std(values) == pytest.approx(expected[quantity][0], rel=0.13)  # 4 / sqrt(2 * 500)
    for quantity in ("position", "reference", "velocity", "omega"):
        name = {"reference": "reference_point", "omega": "angular_rate"}.get(quantity, quantity)
        values = np.array([getattr(c.estimate, quantity) for c in moved if c is not None])
        np.testing.assert_allclose(values.std(axis=0), expected[name], rtol=0.14)


def _disturbed(window, x):
    """The window with the functionals of its covariance changed by x (12,)."""
    dt = 0.04
    T_new, T_old = window.T_co[-1], window.T_co[-2]
    c_new, c_old = T_new.apply(window.X_o).mean(axis=0), T_old.apply(window.X_o).mean(axis=0)
    E = T_new.R @ T_old.R.T
    R_new = exp_so3(x[3:6]) @ T_new.R
    R_old = exp_so3(log_so3(E) + x[9:12] * dt).T @ R_new
    mean = window.X_o.mean(axis=0)
    c_new = c_new + x[:3]
    c_old = c_old + x[:3] - x[6:9] * dt
    T = Pose.stack([Pose(R_old, c_old - R_old @ mean), Pose(R_new, c_new - R_new @ mean)])
    R = np.concatenate([window.T_co.R[:-2], T.R])
    t = np.concatenate([window.T_co.t[:-2], T.t])
    return replace(window, T_co=Pose(R, t))


@pytest.mark.parametrize("ego_poses", [False, True])
def test_the_estimators_own_words_are_held_against_the_same_points(build_world, keys, ego_poses):
    straight = build_world(ego_speed=5.0, ego_poses=ego_poses)
    table = comparison_table(straight.truth, straight.tracks, straight.estimate, **keys)
    for quantity in ("centroid_speed", "driving_direction", "centroid_speed_across", "driving_direction_across"):
        np.testing.assert_allclose(column(table, quantity, "all"), 0, atol=1e-7)
    said = straight.estimate.interpretation
    wrong = replace(said.within, heading=said.within.heading + 0.1 - 2 * np.pi)
    wrong = replace(straight.estimate, interpretation=replace(said, within=wrong))
    table = comparison_table(straight.truth, straight.tracks, wrong, **keys)
    np.testing.assert_allclose(column(table, "driving_direction", "all"), 0.1, atol=1e-7)
    np.testing.assert_allclose(column(table, "driving_direction_across", "all"), 0, atol=1e-7)
    turning = build_world(yaw_rate=0.5, ego_poses=ego_poses)
    table = comparison_table(turning.truth, turning.tracks, turning.estimate, **keys)
    # A difference of two frames 0.04 s apart, 0.5 rad/s: half a frame late is 0.01 rad in the course.
    np.testing.assert_allclose(np.abs(column(table, "driving_direction", "all")), 0.01, rtol=0.2)


def test_what_only_the_way_across_windows_sees(build_world, keys):
    """Every second window sees all farther by 1 cm: 0.25 m/s there and back, nothing within the windows."""
    w = build_world()
    farther = Pose(np.eye(3), np.array([0, 0, 0.01]))
    windows = tuple(replace(x, T_co=farther @ x.T_co) if i % 2 else x for i, x in enumerate(w.estimate.windows))
    estimate = replace(w.estimate, windows=windows, interpretation=interpret(windows, w.truth.t_s, None))
    table = comparison_table(w.truth, w.tracks, estimate, **keys)
    np.testing.assert_allclose(column(table, "centroid_speed", "all"), 0, atol=1e-7)
    across = column(table, "centroid_speed_across", "all")
    assert len(across) == len(windows) - 1
    np.testing.assert_allclose(across, np.resize([-0.25, 0.25], len(across)), atol=1e-3)  # driving slightly aside
    np.testing.assert_allclose(column(table, "yaw_rate_across", "all"), 0, atol=1e-9)
    sigma = table.set_index("quantity")["sigma"]
    assert (sigma.loc[["centroid_speed", "driving_direction"]] > 0).all()
    assert sigma.loc[["centroid_speed_across", "driving_direction_across", "yaw_rate_across"]].isna().all()


def test_no_row_without_a_driving_direction(world, keys):
    said = world.estimate.interpretation
    heading = np.where(np.arange(len(said.frame)) < 5, np.nan, said.within.heading)
    estimate = replace(world.estimate, interpretation=replace(said, within=replace(said.within, heading=heading)))
    table = comparison_table(world.truth, world.tracks, estimate, **keys)
    assert len(column(table, "driving_direction", "all")) == len(said.frame) - 5
    assert len(column(table, "centroid_speed", "all")) == len(said.frame)
