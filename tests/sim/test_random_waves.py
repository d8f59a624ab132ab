"""Sums of random waves: moments and autocorrelation of the spectrum they were drawn from, over many draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, kstest

from sim.random_waves import RandomWaves

DRAWS = 400


def draws(kind: str) -> list[RandomWaves]:
    rngs = [np.random.default_rng([7, i]) for i in range(DRAWS)]
    if kind == "dryden":
        return [RandomWaves.dryden(rng, 2.0, 2.5, 1.0) for rng in rngs]
    return [RandomWaves.band(rng, 2.0, 15.0, 80.0) for rng in rngs]


@pytest.mark.parametrize("kind", ["dryden", "band"])
def test_normal_with_the_stated_sigma(kind: str) -> None:
    """At any one time the values of independent draws are normal: chi-square of their squares, 0.1 % on each side."""
    values = np.array([wave(3.7) for wave in draws(kind)])
    low, high = chi2.ppf([0.001, 0.999], DRAWS)
    assert low < np.sum((values / 2) ** 2) < high
    assert kstest(values / 2, "norm").pvalue > 0.001


@pytest.mark.parametrize("lag_s", [0.25, 1.0, 2.5, 6.0])
def test_autocorrelation_of_gusts_is_drydens(lag_s: float) -> None:
    x_max = 2 * np.pi * 1.0 * 2.5

    def spectrum(x: float) -> float:
        return (1 + 3 * x * x) / (1 + x * x) ** 2

    total = quad(spectrum, 0, x_max)[0]
    expected = quad(lambda x: spectrum(x) * np.cos(x * lag_s / 2.5), 0, x_max, limit=500)[0] / total
    waves = draws("dryden")
    # The phases average out over time exactly, so each draw's autocorrelation is that of its frequencies.
    found = np.array([np.mean(np.cos(wave.omega * lag_s)) for wave in waves])
    assert abs(found.mean() - expected) < 4 * found.std() / np.sqrt(DRAWS) + 1e-6
    t = np.arange(0, 4000, 0.5)
    sampled = np.mean([np.mean(wave(t) * wave(t + lag_s)) / 4 for wave in waves[:40]])
    assert sampled == pytest.approx(expected, abs=0.03)  # 40 draws of 1600 correlation times: 4 sigma


@pytest.mark.parametrize("lag_s", [0.25, 1.0, 2.5, 6.0])
def test_gusts_without_a_cutoff_are_the_textbooks(lag_s: float) -> None:
    """exp(-t/T)(1 - t/2T); what lies above 10 kHz is 1e-5 of the power."""
    waves = [RandomWaves.dryden(np.random.default_rng([8, i]), 1.0, 2.5, 1e4) for i in range(DRAWS)]
    found = np.array([np.mean(np.cos(wave.omega * lag_s)) for wave in waves])
    expected = np.exp(-lag_s / 2.5) * (1 - lag_s / 5)
    assert abs(found.mean() - expected) < 4 * found.std() / np.sqrt(DRAWS) + 1e-5


def test_vibration_lies_in_its_band() -> None:
    t = np.arange(0, 20, 1 / 400)
    values = draws("band")[0](t)
    power = np.abs(np.fft.rfft(values * np.hanning(len(t)))) ** 2
    hz = np.fft.rfftfreq(len(t), 1 / 400)
    outside = (hz < 14.5) | (hz > 80.5)
    assert power[outside].sum() < 1e-6 * power.sum()
    halves = power[(hz > 15) & (hz < 47.5)].sum() / power.sum()
    assert halves == pytest.approx(0.5, abs=0.05)  # half of 256 waves of one strength


def test_any_time_alone_is_the_same() -> None:
    wave = draws("dryden")[0]
    t = np.linspace(0, 100, 7)
    np.testing.assert_array_equal(wave(t), [wave(x) for x in t])
    assert wave(t.reshape(7, 1)).shape == (7, 1)
    assert RandomWaves(0.0, wave.omega, wave.phase)(t).tolist() == [0.0] * 7


def test_refusals() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="correlation_s"):
        RandomWaves.dryden(rng, 1.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="low_hz"):
        RandomWaves.band(rng, 1.0, 20.0, 10.0)
