"""The filter of a single state that is measured directly, (6.21)-(6.26) of Dickmanns 2007, right or wrongly tuned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from estimators.kalman import FORMS, variances
from scenarios.experiments.steps import check_range, check_steps
from sim.streams import stream

_FORM = FORMS["udu"]


@dataclass(frozen=True)
class ScalarFilter:
    """x(k) = a x(k-1) + v, y = x + w, (6.21): all variances over that of w, which is 1.

    What is simulated and what the filter is told may differ, as they do before a filter is tuned.
    """

    a: float = 1.0
    """Transition."""
    noise: float = 0.01
    """Variance of v: Q over R."""
    stated_noise: float = 1.0
    """What the filter takes for Q, over the variance of v."""
    start: float = 100.0
    """Variance of the error of the start value."""
    stated_start: float = 1.0
    """P*(0), over the variance of the error of the start value."""
    steps: tuple[int, ...] = (1, 2, 3, 5, 10, 20, 50, 100, 200)
    """Numbers of steps after which the filter is looked at."""

    def __post_init__(self) -> None:
        for name in ("noise", "stated_noise", "start", "stated_start"):
            check_range(name, getattr(self, name), 1e-12, 1e12)
        check_range("a", self.a, -1, 1)
        check_steps(self.steps)

    @property
    def cases(self) -> tuple[str, ...]:
        """One filter."""
        return ("filter",)

    def __call__(self, seed: int, run: int) -> pd.DataFrame:
        """Rows after the steps asked for: gain (6.23), stated_variance p, error, nees and nis."""
        rng = stream(seed, run, "scalar_filter/noise")
        last = self.steps[-1]
        v, w = np.sqrt(self.noise) * rng.standard_normal(last), rng.standard_normal(last)
        x, estimate = -np.sqrt(self.start) * rng.standard_normal(), np.zeros(1)
        A, H, G, R = np.array([[self.a]]), np.eye(1), np.eye(1), variances(np.ones(1))
        F = _FORM.start(np.array([[self.stated_start * self.start]]))
        q = np.array([self.stated_noise * self.noise])
        rows: list[tuple[str, int, float]] = []
        for k in range(1, last + 1):
            if k > 1:
                x = self.a * x + v[k - 1]
                estimate, F = A @ estimate, _FORM.predict(F, A, G, q)
            predicted = _FORM.covariance(F).item()
            c = _FORM.correct(estimate, F, H, x + w[k - 1 : k] - estimate, R)
            estimate, F = c.x, c.F
            if k in self.steps:
                p, error = _FORM.covariance(F).item(), estimate.item() - x
                rows += [("gain", k, 1 - p / predicted), ("stated_variance", k, p), ("error", k, error)]
                rows += [("nees", k, error**2 / p), ("nis", k, c.nis.item())]
        return pd.DataFrame(rows, columns=["quantity", "t_s", "value"]).assign(estimator=self.cases[0])
