"""The static street: road with markings, kerbs, verges, pavements, houses, trees, signs, lamps and a wooded horizon.

World frame: x right, y forward, z up; the street runs along +y and the ego lane's centre is x = 0, the oncoming lane's
x = -lane_m. A crossing road, where there is one, runs along x, two lanes wide, centred on ``y = crossing_y``.
Nothing stands in a lane. `follow` bends the street along a driven path.
"""

from sim.roadside.follow import Path, follow
from sim.roadside.street import build_roadside

__all__ = ["Path", "build_roadside", "follow"]
