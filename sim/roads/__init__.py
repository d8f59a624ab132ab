"""Roads on the ground: networks, cross sections, lanes, markings; from files, from a seed, and as a faulty map."""

from sim.roads.cross_section import SECTIONS, CrossSection, map_width_m, section
from sim.roads.lanes import Lane, lanes, offset_line
from sim.roads.markings import Marking, markings
from sim.roads.network import LONGEST_EDGE_M, Road, RoadNetwork, RoadSamples

__all__ = [
    "LONGEST_EDGE_M",
    "SECTIONS",
    "CrossSection",
    "Lane",
    "Marking",
    "Road",
    "RoadNetwork",
    "RoadSamples",
    "lanes",
    "map_width_m",
    "markings",
    "offset_line",
    "section",
]
