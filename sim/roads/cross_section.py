"""Standard cross sections of roads after RAS-Q 96, and the widths by which a road map becomes a mask."""

from __future__ import annotations

from dataclasses import dataclass

# Mean error of the exterior orientation, added on both sides (Kozempel 2012, 4.2.1).
ORIENTATION_MARGIN_M = 1.5


@dataclass(frozen=True)
class CrossSection:
    """One Regelquerschnitt: its parts [m] from the middle outwards add up to its name.

    ``lanes`` counts one carriageway of a divided road (``median_m`` > 0), both directions otherwise. ``strip_m`` is the
    paved strip at either side of the lanes (Randstreifen), ``shoulder_m`` the hard shoulder at the right
    (Standstreifen), ``verge_m`` the unpaved verge (Bankett).
    """

    name: str
    total_m: float
    lanes: int
    lane_m: float
    strip_m: float
    verge_m: float
    shoulder_m: float = 0.0
    median_m: float = 0.0

    @property
    def divided(self) -> bool:
        return self.median_m > 0

    def paved_m(self, lanes: int) -> float:
        """Paved width [m] of a carriageway with a number of lanes."""
        return lanes * self.lane_m + 2 * self.strip_m + self.shoulder_m


# By class of the road map, 0 (motorway) to 4 (local). The source gives the first, third, fifth, seventh and ninth of
# nine sections to five classes and calls RQ 20 class 2 and RQ 7.5 class 4 (4.2.1, 4.2.2): so it counts from 0. It
# names the total widths only; the parts are ours, with its lane widths of 2.75 to 3.75 m.
SECTIONS = (
    CrossSection("RQ 35.5", 35.5, 3, 3.50, 0.75, 1.5, shoulder_m=2.5, median_m=3.5),
    CrossSection("RQ 29.5", 29.5, 2, 3.75, 0.75, 1.5, shoulder_m=2.5, median_m=3.5),
    CrossSection("RQ 20", 20.0, 2, 3.25, 0.50, 1.5, median_m=2.0),
    CrossSection("RQ 10.5", 10.5, 2, 3.50, 0.25, 1.5),
    CrossSection("RQ 7.5", 7.5, 2, 2.75, 0.00, 1.0),
)


def section(road_class: int) -> CrossSection:
    """The cross section of a class.

    Raises
        ValueError: a class other than 0 to 4.
    """
    if not 0 <= road_class < len(SECTIONS):
        raise ValueError(f"road class: expected 0 (motorway) to {len(SECTIONS) - 1} (local), got {road_class}")
    return SECTIONS[road_class]


def map_width_m(road_class: int, carriageway: bool = False, margin_m: float = ORIENTATION_MARGIN_M) -> float:
    """Width [m] of a road of the map in a mask: its RAS-Q width and the margin on both sides (Kozempel 2012, 4.2.1).

    With ``carriageway`` the line is one carriageway of a divided road, which takes half of what the median leaves (the
    source does not say how it treats them). The roads of classes 3 and 4 are not divided: it changes nothing there.
    """
    s = section(road_class)
    width = (s.total_m - s.median_m) / 2 if carriageway and s.divided else s.total_m
    return width + 2 * margin_m
