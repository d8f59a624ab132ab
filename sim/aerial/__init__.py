"""Aerial worlds and their pictures: painted ground, buildings, trees and vehicles under a sun, from any camera."""

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
