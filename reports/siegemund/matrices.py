"""The structure of the matrices of two adjustments, Appendix C: Figures C.0.1 to C.0.4."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from estimators.bordered import BorderedSystem
from estimators.estimate import TrajectoryEstimate
from estimators.stereo.conditions import RotationAxis, Smoothing, of_window
from estimators.stereo.depth_bias import observation_model
from estimators.stereo.full_system import about_camera, linearise, weighted
from estimators.stereo.object_motion import Problem
from estimators.stereo.triangulation import triangulate
from reports.figures.structure import MATRICES, structure
from reports.run import Run
from reports.studies import StudyResult


def system(run: Run) -> BorderedSystem:
    """The linearised last window of the first estimator of a run, at its estimate.

    Smoothing, known axis and weights are those of the estimator; the rotation axis is put level with the camera's.

    Raises
        ValueError: the estimator gave nothing, or saw through distorted lenses.
    """
    config: Mapping[str, Any] = run.scenario["estimator"][0]
    estimate = run.estimates[config.get("label") or config["name"]]
    if not isinstance(estimate, TrajectoryEstimate):
        raise ValueError(f"{config.get('label')!r} gave nothing: {estimate.reason}")
    window, tracks, rig = estimate.windows[-1], run.observations.tracks, run.observations.rig
    chosen = tracks.select(np.isin(tracks.frame, window.frames) & np.isin(tracks.track, window.track))
    l, C = triangulate(rig, chosen.uv, chosen.cov)
    model = observation_model(rig, l, C, np.linalg.inv(chosen.cov), config["weights"], config["second_order"])
    frame, point = np.searchsorted(window.frames, chosen.frame), np.searchsorted(window.track, chosen.track)
    problem = Problem(frame, point, l, model, len(window.frames), len(window.track))
    smoothing, axis = Smoothing(**config["smoothing"]), RotationAxis(**config["rotation_axis"])
    poses = window.T_co.R, window.T_co.t
    (R, T), conditions = of_window(smoothing, axis, estimate.t_s[window.frames], None, poses, smoothing.tied)
    return about_camera(linearise(weighted(problem, R, T, window.X_o, conditions), R, T, window.X_o), T)


def beside_the_diagonal(s: BorderedSystem) -> int:
    """Elements of the points' part of the normal matrix that lie beside its diagonal of 3 x 3 blocks."""
    i, j = s.N[: 3 * s.n, : 3 * s.n].nonzero()
    return int(np.count_nonzero(i // 3 != j // 3))


def _systems(result: StudyResult) -> list[BorderedSystem]:
    return [system(result.example(str(point))) for point in result.points.index]


def structure_table(result: StudyResult) -> pd.DataFrame:
    """Size of every matrix, number of its elements that are not zero, and their share."""
    rows = []
    for s in _systems(result):
        for name in MATRICES:
            M = getattr(s, name)
            size = f"{M.shape[0]} x {M.shape[1]}"
            row = {"points": s.n, "frames": s.m, "matrix": name, "size": size, "nz": int(M.nnz)}
            rows.append(row | {"share [%]": 100 * M.nnz / (M.shape[0] * M.shape[1])})
    return pd.DataFrame(rows)


def matrix_structure(result: StudyResult) -> Figure:
    """The matrices of run 0 of the study's first two points side by side.

    Raises
        FileNotFoundError: the study keeps no examples; ValueError: it has no two points.
    """
    found = _systems(result)
    if len(found) != 2:
        raise ValueError(f"sweep: expected two points, found {len(found)}")
    return structure(found[0], found[1])
