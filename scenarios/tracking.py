"""The image front end of a scenario file at work."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from estimators.stereo.features import StereoFrame
from sim.camera import StereoRig
from sim.observations import Tracks


def track(spec: Any, rig: StereoRig, frames: Iterable[StereoFrame]) -> Tracks:
    """What the front end of a scenario file finds, with the covariance it measures or the one the scenario states."""
    tracks: Tracks = spec.front_end.build(spec.measure)(rig, frames)
    sigma = spec.measure.stated_sigma_px
    if sigma is None:
        return tracks
    return replace(tracks, cov=np.broadcast_to(sigma**2 * np.eye(4), tracks.cov.shape))
