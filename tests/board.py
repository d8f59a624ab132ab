"""A textured board that moves before a textured wall, seen by a stereo rig: every grey value is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from estimators.stereo.features import StereoFrame
from sim.camera import Camera, StereoRig
from sim.observations import Tracks

Array = np.ndarray
SIZE, FOCAL, BASE = (320, 240), 400.0, 0.3
BOARD_M, WALL_M, FRAMES, HALF_M = 8.0, 30.0, 12, (1.0, 0.7)
RIG = StereoRig.normal_case(Camera.simple(SIZE, FOCAL), BASE)


def texture(x: Array, y: Array, seed: int) -> Array:
    """Grey values of a smooth random pattern, wave lengths down to some 0.1 m, known everywhere."""
    rng = np.random.default_rng(seed)
    k, phase = rng.uniform(-60, 60, (60, 2)), rng.uniform(0, 2 * np.pi, 60)
    waves = np.sin(k[:, :1] * x.ravel() + k[:, 1:] * y.ravel() + phase[:, None])
    return np.asarray(128 + 12 * waves.sum(axis=0)).reshape(x.shape)


@dataclass(frozen=True)
class Board:
    """The board's way: towards the camera and to the right."""

    speed_mps: float = 6.0
    noise: float = 2.0

    def middle(self, k: int) -> Array:
        return np.array([-0.5 + 0.04 * k, 0.1, BOARD_M - self.speed_mps * k / 25])

    def image(self, k: int, right: bool) -> tuple[Array, Array]:
        """Grey values and where the board is."""
        u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
        c, X = np.array(RIG.left.K)[:2, 2], self.middle(k)
        x, y = (u - c[0]) / FOCAL, (v - c[1]) / FOCAL
        bx, by = x * X[2] + right * BASE - X[0], y * X[2] - X[1]
        wall = texture((x * WALL_M + right * BASE) / 4, y * WALL_M / 4, 2)
        inside = (np.abs(bx) < HALF_M[0]) & (np.abs(by) < HALF_M[1])
        rng = np.random.default_rng([k, right])
        grey = np.where(inside, texture(bx, by, 1), wall) + self.noise * rng.standard_normal(x.shape)
        return np.clip(np.rint(grey), 0, 255).astype(np.uint8), inside

    def frames(self) -> Iterator[StereoFrame]:
        yield from _frames(self)

    def errors(self, tracks: Tracks) -> Array:
        """Deviation of every row from the point of the board that is in the middle of its track, (n, 4)."""
        middle = np.array([self.middle(k) for k in tracks.frame])
        on_board = RIG.left.unproject(tracks.uv_left, middle[:, 2]) - middle
        of_track = np.array([np.median(on_board[tracks.track == t], axis=0) for t in tracks.track])
        return np.asarray(tracks.uv - RIG.project(of_track + middle))


@cache
def _frames(board: Board) -> tuple[StereoFrame, ...]:
    found = []
    for k in range(FRAMES):
        left, mask = board.image(k, right=False)
        found.append(StereoFrame(left, board.image(k, right=True)[0], mask))
    return tuple(found)
