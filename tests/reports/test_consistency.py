"""NEES, its bands, and the Cramer-Rao bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from reports.consistency import band, cramer_rao, disjoint_windows, nees, nees_table, pooled_nees
from reports.errors import compare_windows


def test_nees_of_honest_samples_is_chi_square():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 6))
    cov = A @ A.T + 0.1 * np.eye(6)
    values = nees(rng.multivariate_normal(np.zeros(6), cov, 200), np.broadcast_to(cov, (200, 6, 6)))
    mean, lower, upper = pooled_nees(values)
    assert lower < mean < upper
    assert mean == values.mean() / 6
    assert chi2.cdf(np.sort(values), 6)[100] > 0.4  # the median too, 3 sigma = 0.1


def test_band_is_that_of_the_mean():
    lower, upper = band(6, 200)
    assert 0.8 < lower < 1 < upper < 1.2
    assert band(6, 1)[1] > upper


def test_disjoint_windows_share_no_frame(world):
    chosen = disjoint_windows(world.estimate)
    used = [f for w in world.estimate.windows if int(w.frames[-1]) in chosen for f in w.frames]
    assert len(used) == len(set(used))
    assert sorted(chosen) == [2, 12, 22, 32]


def test_what_earlier_observations_entered_is_neither_independent_nor_bounded(world):
    windows = tuple(replace(w, since=0) for w in world.estimate.windows)
    recursive = replace(world.estimate, windows=windows)
    assert disjoint_windows(recursive) == {int(windows[0].frames[-1])}
    comparison = compare_windows(world.truth, world.tracks, recursive)[-1]
    assert comparison.window.frames[0] > 0
    assert np.isnan(cramer_rao(world.truth, world.tracks, comparison)).all()


def test_nees_of_windows_disturbed_by_their_covariance(world, keys):
    """Disjoint windows of a fixed seed, each disturbed by a sample of its own covariance."""
    rng = np.random.default_rng(8)
    comparisons = compare_windows(world.truth, world.tracks, world.estimate)
    disturbed = []
    for c in comparisons:
        x = rng.multivariate_normal(np.zeros(12), c.window.cov)
        e = replace(c.estimate, position=c.estimate.position + x[:3])
        J = np.eye(12)
        lever = c.estimate.lever
        J[6:9, 9:12] = -np.array([[0, -lever[2], lever[1]], [lever[2], 0, -lever[0]], [-lever[1], lever[0], 0]])
        y = J @ x
        e = replace(e, velocity=e.velocity + y[6:9], omega=e.omega + y[9:12])
        disturbed.append(replace(c, estimate=e, orientation=x[3:6]))
    table = nees_table(world.truth, world.estimate, disturbed, **keys)
    for _, part in table.groupby("quantity"):
        lower, upper = band(6, len(part), 0.999)
        assert lower < part["nees"].mean() / 6 < upper
    assert table["disjoint"].sum() == 2 * 4


def test_a_direction_that_is_known_has_no_nees(world, keys):
    """Rotation about a known axis: rates across it have no variance, but for rounding."""
    fixed = np.diag(np.repeat([1.0, 1e-12, 1.0], [9, 1, 2]))
    comparisons = [
        replace(c, window=replace(c.window, cov=fixed @ c.window.cov @ fixed))
        for c in compare_windows(world.truth, world.tracks, world.estimate)
    ]
    assert set(nees_table(world.truth, world.estimate, comparisons, **keys)["quantity"]) == {"pose"}


def test_bound_equals_the_covariance_of_the_same_rows(world):
    """With the injected noise as stated one, the covariance at the truth is the bound."""
    for c in compare_windows(world.truth, world.tracks, world.estimate)[::10]:
        bound = cramer_rao(world.truth, world.tracks, c)
        np.testing.assert_allclose(bound, c.window.cov, rtol=1e-6, atol=1e-9 * np.abs(c.window.cov).max())


def test_bound_grows_when_rows_are_lost_and_is_nan_without_noise(world):
    c = compare_windows(world.truth, world.tracks, world.estimate)[-1]
    full = cramer_rao(world.truth, world.tracks, c)
    keep = ~((world.tracks.track < 6) & (world.tracks.frame < 36))
    labels = world.truth.labels
    fewer = replace(
        world.truth,
        labels=replace(labels, kind=labels.kind[keep], uv_true=labels.uv_true[keep], sigma_px=labels.sigma_px[keep]),
    )
    less = cramer_rao(fewer, world.tracks.select(keep), c)
    assert np.all(np.diag(less) > np.diag(full))
    silent = replace(world.truth, labels=replace(labels, sigma_px=0 * labels.sigma_px))
    assert np.isnan(cramer_rao(silent, world.tracks, c)).all()


def test_bound_of_the_centroid_by_hand(world):
    """One frame more known shape cannot help: the bound of a window of points lies between that of one frame and
    one m-th of it."""
    c = compare_windows(world.truth, world.tracks, world.estimate)[-1]
    bound = cramer_rao(world.truth, world.tracks, c)
    J = world.truth.rig.project_jacobian(c.p_c)
    single = np.linalg.inv(np.swapaxes(J, 1, 2) @ J / 0.2**2).sum(axis=0) / len(c.p_c) ** 2
    assert np.all(np.diag(bound)[:3] < np.diag(single))
    assert np.all(np.diag(bound)[:3] > np.diag(single) / len(c.window.frames) * 0.5)
