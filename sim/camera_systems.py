"""The camera systems of Kozempel 2012, chapter 2, and when they expose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from sim.angles import Mounting, boresight_angles, boresight_rotation
from sim.archive import freeze_fields
from sim.camera import Camera
from sim.pose import rot_z
from sim.streams import stream

Array = np.ndarray
# Camera below the IMU, "ca. 10 cm" (3.).
_LEVER_B = (0.0, 0.0, 0.1)
# Tilt of the outer two of the three heads of the 3K camera [deg]: 110 degrees of view across the flight in all.
_SIDE_TILT_DEG = 35.0


@dataclass(frozen=True)
class Trigger:
    """A steady rate, or bursts of frames (least, most) at the rate with pauses (shortest, longest) [s] between them.

    Heads with the same trigger expose together. A pause is counted from a burst's last frame to the next burst's first.
    """

    name: str
    rate_hz: float
    burst_frames: tuple[int, int] | None = None
    pause_s: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not self.rate_hz > 0:
            raise ValueError(f"Trigger.rate_hz: expected > 0, got {self.rate_hz}")
        if self.burst_frames is not None and not 1 <= self.burst_frames[0] <= self.burst_frames[1]:
            raise ValueError(f"Trigger.burst_frames: expected 1 <= least <= most, got {self.burst_frames}")
        if not 0 <= self.pause_s[0] <= self.pause_s[1]:
            raise ValueError(f"Trigger.pause_s: expected 0 <= shortest <= longest, got {self.pause_s}")

    def times(
        self, start_s: float, end_s: float, rng: np.random.Generator
    ) -> tuple[Float[Array, "n"], Int[Array, "n"]]:
        """Exposure times from start_s to at most end_s, and the burst each belongs to."""
        if self.burst_frames is None:
            n = int(np.floor((end_s - start_s) * self.rate_hz + 1e-9)) + 1
            return start_s + np.arange(n) / self.rate_hz, np.zeros(n, int)
        t_s: list[float] = []
        burst: list[int] = []
        clock, index = start_s, 0
        while clock <= end_s:
            frames = clock + np.arange(rng.integers(*self.burst_frames, endpoint=True)) / self.rate_hz
            t_s += frames.tolist()
            burst += [index] * len(frames)
            clock, index = frames[-1] + rng.uniform(*self.pause_s), index + 1
        inside = np.array(t_s) <= end_s
        return np.array(t_s)[inside], np.array(burst)[inside]


@dataclass(frozen=True, eq=False)
class Head:
    """One camera of a system, as nominally built and mounted."""

    name: str
    camera: Camera
    mounting: Mounting
    trigger: Trigger
    band: Literal["mono", "rgb", "thermal"]

    def ground_sampling_m(self, height_m: float) -> float:
        """Size of a pixel on level ground under the camera."""
        return height_m / float(self.camera.K[1, 1])


@dataclass(frozen=True, eq=False)
class CameraSystem:
    """Cameras on one body."""

    name: str
    heads: tuple[Head, ...]


def antar(mount_deg: float = 0.0) -> CameraSystem:
    """ANTAR: 1024 x 1024 monochrome at 5 Hz and 320 x 240 thermal at 25 Hz (2.1).

    The focal lengths are ours: 2500 px from 0.20 m at 500 m ("5-6 Pixel ... 1,0 bis 1,2 Meter", 3.3), and the thermal
    camera sees the same width.
    """
    mounting = _mounting(mount_deg, 0.0)
    mono = Camera.simple((1024, 1024), 2500.0)
    thermal = Camera.simple((320, 240), 2500.0 * 320 / 1024)
    return CameraSystem(
        "antar",
        (
            Head("mono", mono, mounting, Trigger("mono", 5.0), "mono"),
            Head("thermal", thermal, mounting, Trigger("thermal", 25.0), "thermal"),
        ),
    )


def argos(heads: int = 1, mount_deg: float = 0.0) -> CameraSystem:
    """ARGOS / 3K: 4992 x 3328 colour, bursts of 2-4 frames at 3 Hz, 7-10 s pause (2.2); 50 mm on 36 x 24 mm.

    One head looks down; the others are tilted to the left and to the right by 35 degrees (ours: the source's Fig. 2.3
    has no figures).

    Raises
        ValueError: a number of heads other than 1 and 3.
    """
    if heads not in (1, 3):
        raise ValueError(f"argos: expected 1 or 3 heads, got {heads}")
    camera = Camera.simple((4992, 3328), 50.0 / 36.0 * 4992)
    trigger = Trigger("burst", 3.0, (2, 4), (7.0, 10.0))
    tilts = {"nadir": 0.0} if heads == 1 else {"left": _SIDE_TILT_DEG, "nadir": 0.0, "right": -_SIDE_TILT_DEG}
    return CameraSystem(
        "argos",
        tuple(Head(name, camera, _mounting(mount_deg, tilt), trigger, "rgb") for name, tilt in tilts.items()),
    )


def _mounting(mount_deg: float, tilt_deg: float) -> Mounting:
    """Tilted to the left about the flight direction, then turned about its own axis, clockwise seen from above."""
    tilted = boresight_rotation(np.array([0.0, -np.deg2rad(tilt_deg), 0.0]))
    return Mounting(boresight_angles(tilted @ rot_z(np.deg2rad(mount_deg))), np.array(_LEVER_B))


@dataclass(frozen=True, eq=False)
class Exposures:
    """What is exposed when, by time: true times t_s (n,), the index of the head, the flight line and its burst."""

    t_s: Float[Array, "n"]
    head: Int[Array, "n"]
    line: Int[Array, "n"]
    burst: Int[Array, "n"]

    def __post_init__(self) -> None:
        freeze_fields(self)

    def __len__(self) -> int:
        return len(self.t_s)


def exposures(system: CameraSystem, line_s: ArrayLike, seed: int, run: int) -> Exposures:
    """All exposures of a system along flight lines (n, 2), begin and end [s]; between the lines it rests."""
    rows: list[tuple[float, int, int, int]] = []
    for line, (begin, end) in enumerate(np.asarray(line_s, float).reshape(-1, 2).tolist()):
        for trigger in dict.fromkeys(head.trigger for head in system.heads):
            rng = stream(seed, run, f"{system.name}/trigger/{trigger.name}/{line}")
            t_s, burst = trigger.times(begin, end, rng)
            fired = [i for i, head in enumerate(system.heads) if head.trigger == trigger]
            rows += [(t, head, line, b) for t, b in zip(t_s.tolist(), burst.tolist(), strict=True) for head in fired]
    t, head, line_of, burst_of = zip(*sorted(rows), strict=True) if rows else ((), (), (), ())
    return Exposures(np.array(t, float), np.array(head, int), np.array(line_of, int), np.array(burst_of, int))
