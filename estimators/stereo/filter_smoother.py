"""What all frames say of every frame: the smoother of Rauch, Tung and Striebel where states are born and end.

Going back from one step to the one before, only the points that went from one to the other matter:

    C = P A' P*^-1,   d = C (x_s minus x*),   P_s = P + C (P_s,next - P*) C'

with the prediction x*, P* of the motion and of these points, and A that selects and moves them. A point born at the
next step is a function of the pose there and of noise of its own: given that pose it says nothing of the past, and its
share of the smoothed state is left out. A point that ends has no row in A, but one in C: it is corrected by what it
shares with the others. So the smoother is as exact as without births and deaths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.stereo.filter_run import Step
from estimators.stereo.filter_state import MOTION, error_rows

Array = np.ndarray


def smoothed(steps: Sequence[Step]) -> list[Step]:
    """The steps of a run with their states and covariances P from all observations."""
    result = list(steps[-1:])
    for step, after in zip(steps[-2::-1], steps[:0:-1], strict=True):
        rows, n = error_rows(after.kept), len(after.predicted)
        PA = step.P[:, rows]
        PA[:, :MOTION] = step.P[:, :MOTION] @ after.A.T
        C = np.linalg.solve(after.P_predicted, PA.T).T
        d = result[-1].state.select(np.arange(len(after.kept))).minus(after.predicted)
        P = step.P + C @ (result[-1].P[:n, :n] - after.P_predicted) @ C.T
        result.append(replace(step, state=step.state.plus(C @ d), P=(P + P.T) / 2))
    return result[::-1]
