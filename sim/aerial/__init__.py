"""Aerial worlds and their pictures: painted ground, buildings, trees and vehicles under a sun, from any camera.

presets        the source's five data sets, a town beside a motorway, any place of a map, as `AerialWorld`
scene          `AerialWorld` (the spec) and `build`: everything that stands, is painted or drives
land_use       blocks between the roads: houses, parks, fields, woods, car parks
road_surface   asphalt with its age, kerbs, markings; road_paint: crossings, arrows, bays
materials      what the ground is made of, by season; surfaces: how warm it gets
ground         tiles of the painted map; paint_kernels colours and warms them
library        meshes and textures in flat arrays; buildings, trees and vehicles make them
sunlight       sun, sky, haze, white balance
view           what a camera sees, ready for the loops
renderer       `render` and `measure`; kernels (geometry), shadow_kernels, shade_kernels are its compiled loops
exposure       a sensor stage for tens of megapixels
thermal        `render_thermal` and its sensor; thermal_kernels is its loop
heads          `picture`: what a head of a camera system takes, in its band
"""

from sim.aerial.renderer import AerialTruth, VisibleVehicles, measure, render
from sim.aerial.scene import AerialScene, AerialWorld, build
from sim.aerial.sunlight import Sunlight
from sim.aerial.traffic_state import VehicleStates

__all__ = [
    "AerialScene",
    "AerialTruth",
    "AerialWorld",
    "Sunlight",
    "VehicleStates",
    "VisibleVehicles",
    "build",
    "measure",
    "render",
]
