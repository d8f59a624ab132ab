"""The outlines of the vehicle kinds: side silhouette, front view, glass, doors; metres at the kind's typical size.

x counts from the rear bumper forward, z from the ground up.
"""

from __future__ import annotations

from dataclasses import dataclass

Line = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Hull:
    """One lofted body: ``top`` (x, z) from rear to front, ``flank`` (z, half width as a share of the widest)."""

    top: Line
    flank: Line
    sill_m: float
    belt_m: float
    corner_m: float = 0.10
    crown_m: float = 0.05
    tail_round: tuple[float, float] = (0.30, 0.16)
    nose_round: tuple[float, float] = (0.45, 0.24)
    tail_bulge_m: float = 0.04
    nose_bulge_m: float = 0.07
    smooth_m: float = 0.07
    arches: bool = True


@dataclass(frozen=True)
class Shape:
    """A kind of vehicle: size (length, width, height), chassis, hulls and what is painted on them.

    ``windscreen`` and ``rear_window`` are x-ranges seen from above (None: drawn on the front or rear view only);
    ``panes`` are x-ranges of side glass along the belt; ``doors`` the x of door seams.
    """

    size_m: tuple[float, float, float]
    wheelbase_m: float
    rear_overhang_m: float
    wheel_radius_m: float
    wheel_width_m: float
    hulls: tuple[Hull, ...]
    panes: tuple[tuple[float, float], ...]
    doors: tuple[float, ...]
    belt_m: tuple[float, float]
    windscreen: tuple[float, float] | None
    rear_window: tuple[float, float] | None
    rear_glass_m: tuple[float, float] | None
    front_glass_m: tuple[float, float] | None
    headlight_m: tuple[float, float]
    tail_light_m: tuple[float, float, float]
    plate_m: tuple[float, float]
    grille_m: tuple[float, float]


_CAR_FLANK: Line = (
    (0.0, 0.93), (0.20, 0.955), (0.32, 0.985), (0.50, 0.998), (0.62, 1.0), (0.80, 0.985), (0.93, 0.955), (0.97, 0.925),
    (1.20, 0.83), (1.50, 0.68),
)  # fmt: skip

_SEDAN = Shape(
    size_m=(4.60, 1.80, 1.45),
    wheelbase_m=2.70,
    rear_overhang_m=1.02,
    wheel_radius_m=0.315,
    wheel_width_m=0.205,
    hulls=(
        Hull(
            top=((0.0, 0.84), (0.05, 0.97), (0.12, 1.01), (0.60, 1.04), (0.78, 1.10), (1.42, 1.37), (1.75, 1.435),
                 (2.15, 1.45), (2.55, 1.425), (2.78, 1.38), (3.46, 1.02), (3.60, 0.985), (4.20, 0.885), (4.45, 0.79),
                 (4.60, 0.63)),
            flank=_CAR_FLANK, sill_m=0.20, belt_m=0.95,
        ),
    ),
    panes=((0.98, 1.33), (1.40, 2.18), (2.26, 3.40)),
    doors=(1.30, 2.22, 3.28),
    belt_m=(0.98, 0.93),
    windscreen=(2.76, 3.42), rear_window=(0.80, 1.48),
    rear_glass_m=None, front_glass_m=None,
    headlight_m=(0.60, 0.73), tail_light_m=(0.74, 0.93, 0.36), plate_m=(0.45, 0.80), grille_m=(0.54, 0.72),
)  # fmt: skip

_HATCHBACK = Shape(
    size_m=(4.05, 1.74, 1.47),
    wheelbase_m=2.55,
    rear_overhang_m=0.72,
    wheel_radius_m=0.305,
    wheel_width_m=0.195,
    hulls=(
        Hull(
            top=((0.0, 0.80), (0.04, 0.93), (0.10, 0.99), (0.36, 1.33), (0.46, 1.40), (0.85, 1.45), (1.40, 1.47),
                 (1.90, 1.45), (2.20, 1.40), (2.94, 1.04), (3.08, 1.0), (3.66, 0.90), (3.90, 0.79), (4.05, 0.62)),
            flank=_CAR_FLANK, sill_m=0.20, belt_m=0.95, tail_round=(0.32, 0.20),
        ),
    ),
    panes=((0.42, 0.74), (0.80, 1.58), (1.66, 2.86)),
    doors=(0.86, 1.62, 2.74),
    belt_m=(1.01, 0.94),
    windscreen=(2.20, 2.90), rear_window=None,
    rear_glass_m=(1.02, 1.34), front_glass_m=None,
    headlight_m=(0.60, 0.75), tail_light_m=(0.74, 0.98, 0.24), plate_m=(0.44, 0.72), grille_m=(0.54, 0.70),
)  # fmt: skip

_ESTATE = Shape(
    size_m=(4.70, 1.80, 1.49),
    wheelbase_m=2.72,
    rear_overhang_m=1.10,
    wheel_radius_m=0.315,
    wheel_width_m=0.205,
    hulls=(
        Hull(
            top=((0.0, 0.82), (0.04, 0.96), (0.10, 1.02), (0.30, 1.34), (0.40, 1.41), (0.80, 1.46), (1.60, 1.49),
                 (2.30, 1.47), (2.62, 1.44), (2.86, 1.38), (3.56, 1.02), (3.70, 0.985), (4.30, 0.885), (4.55, 0.79),
                 (4.70, 0.63)),
            flank=_CAR_FLANK, sill_m=0.20, belt_m=0.95, tail_round=(0.28, 0.17),
        ),
    ),
    panes=((0.36, 1.18), (1.26, 2.22), (2.30, 3.50)),
    doors=(1.30, 2.26, 3.36),
    belt_m=(0.99, 0.93),
    windscreen=(2.84, 3.52), rear_window=None,
    rear_glass_m=(1.04, 1.36), front_glass_m=None,
    headlight_m=(0.60, 0.73), tail_light_m=(0.74, 1.02, 0.22), plate_m=(0.45, 0.80), grille_m=(0.54, 0.72),
)  # fmt: skip

_VAN = Shape(
    size_m=(5.00, 1.92, 2.02),
    wheelbase_m=3.05,
    rear_overhang_m=0.98,
    wheel_radius_m=0.335,
    wheel_width_m=0.215,
    hulls=(
        Hull(
            top=((0.0, 1.86), (0.05, 1.94), (0.25, 1.99), (0.9, 2.02), (3.30, 2.02), (3.60, 1.97), (3.78, 1.90),
                 (4.42, 1.24), (4.52, 1.18), (4.82, 1.04), (4.94, 0.90), (5.00, 0.70)),
            flank=((0.0, 0.95), (0.25, 0.965), (0.40, 0.99), (0.70, 1.0), (1.0, 0.99), (1.16, 0.975), (1.20, 0.96),
                   (1.60, 0.92), (2.1, 0.84)),
            sill_m=0.24, belt_m=1.18, corner_m=0.10, tail_round=(0.14, 0.08), tail_bulge_m=0.02,
        ),
    ),
    panes=((0.25, 1.55), (1.68, 2.72), (2.98, 4.28)),
    doors=(1.62, 2.78, 3.98),
    belt_m=(1.18, 1.10),
    windscreen=(3.76, 4.40), rear_window=None,
    rear_glass_m=(1.22, 1.76), front_glass_m=(1.26, 1.86),
    headlight_m=(0.72, 0.94), tail_light_m=(0.80, 1.25, 0.12), plate_m=(0.46, 0.98), grille_m=(0.70, 0.88),
)  # fmt: skip

_LORRY = Shape(
    size_m=(8.20, 2.50, 3.45),
    wheelbase_m=4.55,
    rear_overhang_m=2.20,
    wheel_radius_m=0.48,
    wheel_width_m=0.32,
    hulls=(
        Hull(
            top=((6.28, 3.02), (6.60, 3.12), (7.00, 3.02), (7.55, 2.72), (7.90, 2.60), (8.10, 2.10), (8.20, 1.50)),
            flank=((0.0, 0.94), (0.6, 0.96), (1.2, 0.975), (1.5, 0.97), (1.55, 0.955), (2.5, 0.90), (3.2, 0.84)),
            sill_m=0.42, belt_m=1.52, corner_m=0.14, tail_round=(0.10, 0.06), nose_round=(0.35, 0.28),
            tail_bulge_m=0.01, nose_bulge_m=0.06,
        ),
        Hull(
            top=((0.0, 3.44), (0.04, 3.45), (6.11, 3.45), (6.15, 3.44)),
            flank=((0.0, 1.0), (4.0, 1.0)),
            sill_m=1.05, belt_m=2.0, corner_m=0.05, crown_m=0.02, tail_round=(0.03, 0.03), nose_round=(0.05, 0.05),
            tail_bulge_m=0.005, nose_bulge_m=0.01, smooth_m=0.0, arches=False,
        ),
    ),
    panes=((6.78, 7.86),),
    doors=(6.70, 7.90),
    belt_m=(1.60, 1.52),
    windscreen=None, rear_window=None,
    rear_glass_m=None, front_glass_m=(1.62, 2.52),
    headlight_m=(0.62, 0.80), tail_light_m=(0.72, 0.88, 0.40), plate_m=(0.50, 0.74), grille_m=(0.90, 1.40),
)  # fmt: skip

_BUS = Shape(
    size_m=(11.95, 2.50, 3.05),
    wheelbase_m=5.90,
    rear_overhang_m=3.35,
    wheel_radius_m=0.48,
    wheel_width_m=0.32,
    hulls=(
        Hull(
            top=((0.0, 2.86), (0.10, 2.98), (0.35, 3.03), (1.0, 3.05), (11.2, 3.05), (11.65, 3.00), (11.85, 2.85),
                 (11.95, 2.45)),
            flank=((0.0, 0.95), (0.4, 0.965), (0.9, 0.975), (1.05, 0.97), (2.6, 0.95), (3.1, 0.92)),
            sill_m=0.34, belt_m=1.05, corner_m=0.16, crown_m=0.06, tail_round=(0.22, 0.12), nose_round=(0.40, 0.30),
            tail_bulge_m=0.02, nose_bulge_m=0.08,
        ),
    ),
    panes=((0.55, 1.85), (1.93, 3.35), (3.43, 4.45), (5.65, 6.95), (7.03, 8.35), (8.43, 9.75)),
    doors=(),
    belt_m=(1.12, 1.12),
    windscreen=None, rear_window=None,
    rear_glass_m=(1.55, 2.45), front_glass_m=(1.05, 2.55),
    headlight_m=(0.58, 0.80), tail_light_m=(0.75, 1.25, 0.14), plate_m=(0.45, 0.62), grille_m=(0.36, 0.46),
)  # fmt: skip

SHAPES = {
    "sedan": _SEDAN, "hatchback": _HATCHBACK, "estate": _ESTATE, "van": _VAN, "lorry": _LORRY, "bus": _BUS,
}  # fmt: skip
