"""What an estimator may know. Imports neither `truth` nor `scenario`, nor they it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from sim import archive
from sim.archive import freeze_fields
from sim.camera import StereoRig
from sim.pose import Pose

_FILE = "observations.npz"


@dataclass(frozen=True, eq=False)
class Tracks:
    """Image points of one object as flat columns, one row per stereo observation; ragged tracks need no padding.

    frame (N,) index into `Observations.t_s`; track (N,) identifier; uv_left, uv_right (N, 2) pixels; cov (N, 4, 4)
    the *stated* covariance of (u_left, v_left, u_right, v_right) in px²; an infinite variance means that the row says
    nothing. Rows are sorted by (frame, track).
    """

    frame: Int[np.ndarray, "n"]
    track: Int[np.ndarray, "n"]
    uv_left: Float[np.ndarray, "n 2"]
    uv_right: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "n 4 4"]

    def __post_init__(self) -> None:
        freeze_fields(self)
        n = len(self.frame)
        shapes = [a.shape for a in (self.frame, self.track, self.uv_left, self.uv_right, self.cov)]
        if shapes != [(n,), (n,), (n, 2), (n, 2), (n, 4, 4)]:
            raise ValueError(f"Tracks: expected (n,), (n,), (n, 2), (n, 2), (n, 4, 4), got {shapes}")
        silent = ~self.informative
        for name in ("uv_left", "uv_right", "cov"):
            wrong = ~np.isfinite(getattr(self, name))
            if name == "cov":
                wrong[silent] = np.isnan(self.cov[silent])
            if wrong.any():
                raise ValueError(f"Tracks.{name}: not finite in {self._row(wrong)}")
        not_positive = np.linalg.eigvalsh(np.where(silent[:, None, None], np.eye(4), self.cov))[:, :1] <= 0
        if not_positive.any():
            raise ValueError(f"Tracks.cov: not positive definite in {self._row(not_positive)}")
        if np.any(np.diff(self.frame) < 0) or np.any((np.diff(self.frame) == 0) & (np.diff(self.track) <= 0)):
            raise ValueError("Tracks: rows must be sorted by (frame, track), each pair at most once")

    def _row(self, where: np.ndarray) -> str:
        """Names the first row with an entry that is marked."""
        row = int(np.argwhere(where)[0, 0])
        return f"row {row} (frame {self.frame[row]}, track {self.track[row]})"

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def uv(self) -> Float[np.ndarray, "n 4"]:
        """(u_left, v_left, u_right, v_right)."""
        return np.concatenate([self.uv_left, self.uv_right], axis=1)

    @property
    def informative(self) -> Bool[np.ndarray, "n"]:
        """Rows without an infinite variance."""
        return np.asarray(~np.isposinf(np.einsum("nii->ni", self.cov)).any(axis=1))

    @staticmethod
    def none() -> Tracks:
        """No observation at all."""
        rows = np.empty(0, int)
        return Tracks(rows, rows, np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 4, 4)))

    def select(self, rows: Any) -> Tracks:
        return Tracks(self.frame[rows], self.track[rows], self.uv_left[rows], self.uv_right[rows], self.cov[rows])


@dataclass(frozen=True, eq=False)
class Observations:
    """The measurements of one object in one stereo sequence.

    t_s (m,) times of the frames, strictly increasing; rig the *nominal* calibration; T_wc (m,) the *measured* poses of
    the left camera, or None where nothing is known of the ego motion; images (left, right) file names per frame, and
    masks file names of where the target is supposed to be in the left image, both relative to the folder the
    observations are stored in, or None.
    """

    t_s: Float[np.ndarray, "m"]
    rig: StereoRig
    tracks: Tracks
    entity: str = "target"
    T_wc: Pose | None = None
    images: tuple[tuple[str, str], ...] | None = None
    masks: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        freeze_fields(self)
        if not np.isfinite(self.t_s).all() or np.any(np.diff(self.t_s) <= 0):
            raise ValueError("Observations.t_s: expected finite, strictly increasing times")
        if len(self.tracks) and not 0 <= self.tracks.frame[0] <= self.tracks.frame[-1] < len(self.t_s):
            raise ValueError(f"Observations.tracks: frame outside 0..{len(self.t_s) - 1}")
        if self.T_wc is not None and self.T_wc.t.shape != (len(self.t_s), 3):
            raise ValueError(f"Observations.T_wc: expected {len(self.t_s)} poses, got {self.T_wc.t.shape}")
        if self.T_wc is not None and not (np.isfinite(self.T_wc.R).all() and np.isfinite(self.T_wc.t).all()):
            raise ValueError("Observations.T_wc: not finite")
        for name in ("images", "masks"):
            names = getattr(self, name)
            if names is not None and len(names) != len(self.t_s):
                raise ValueError(f"Observations.{name}: expected {len(self.t_s)} frames, got {len(names)}")

    def save(self, folder: Path) -> None:
        archive.save(folder / _FILE, self)

    @staticmethod
    def load(folder: Path) -> Observations:
        f = archive.load(folder / _FILE)
        images = None if f["images"] is None else tuple((left, right) for left, right in f["images"])
        masks = None if f["masks"] is None else tuple(f["masks"])
        T_wc = None if f["T_wc"] is None else Pose(**f["T_wc"])
        rig, tracks = StereoRig.from_fields(f["rig"]), Tracks(**f["tracks"])
        return Observations(f["t_s"], rig, tracks, f["entity"], T_wc, images, masks)
