"""The sliding-window adjustment: the estimator of Siegemund 2008 as one configurable callable."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from estimators.estimate import EstimationFailed, Failure, TrajectoryEstimate, WindowEstimate
from estimators.stereo import windows
from estimators.stereo.configuration import Configuration
from estimators.stereo.vehicle import interpret
from estimators.stereo.window_adjustment import adjust_window, triangulated
from sim.observations import Observations

Array = np.ndarray


@dataclass(frozen=True)
class SlidingWindowAdjustment(Configuration):
    """Motion and shape of a rigid object by least-squares adjustment over a sliding window (Siegemund 2008, ch. 3-4).

    The options are those of `Configuration`.
    """

    def __call__(self, observations: Observations) -> TrajectoryEstimate | EstimationFailed:
        started = time.perf_counter()
        if len(observations.tracks) and not observations.tracks.informative.any():
            return EstimationFailed("no observation has a finite covariance", ("state the sigma of the image points",))
        points = triangulated(observations, self.propagation)
        results: list[WindowEstimate] = []
        failures: list[Failure] = []
        for newest, window in self._windows(windows.without(np.unique(points.frame), self.skipped), observations):
            previous = results[-1] if results and self.propagate else None
            result = adjust_window(self, observations, points, newest, window, previous)
            if isinstance(result, WindowEstimate):
                results.append(result)
            else:
                failures.append(Failure(newest, result.reason, result.hints))
        if not results:
            reason = failures[0].reason if failures else "no window has enough frames with three tracks or more"
            return EstimationFailed(reason, (f"{len(failures)} windows failed", "lower start_window or window"))
        return TrajectoryEstimate(
            t_s=observations.t_s,
            windows=tuple(results),
            failures=tuple(failures),
            interpretation=interpret(results, observations.t_s, observations.T_wc),
            T_wc=observations.T_wc,
            runtime_s=time.perf_counter() - started,
        )

    def _windows(self, observed: Int[Array, "f"], observations: Observations) -> Iterator[tuple[int, Int[Array, "m"]]]:
        """Newest frame and frames of every window; frames left out on purpose have none."""
        strategy = windows.STRATEGIES["whole" if self.selection == "growing" else self.selection]
        frames = [t for t in range(len(observations.t_s)) if t not in self.skipped]
        if self.selection == "whole":
            frames = observed[-1:].tolist()
        for newest in frames:
            window = strategy(observed, newest, self.window)
            if len(window) >= self.start_window:
                yield newest, window
