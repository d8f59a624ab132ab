"""Vehicles and other bodies: parametric cars, vans, lorries and buses, mesh files, point grids, surface points.

shapes     outlines of the kinds
solid      closed parts, their primitives and their union into one surface
body       lofted bodies with wheel arches
wheels     tyres and rims
atlas      which side lies where on a vehicle's texture
painter    boards, paint and materials for the texture
paint      the texture: paint_flank, paint_ends (front, rear, top), dirt
vehicles   `make_vehicle`: all of it scaled to a size, in three levels of detail
files      `load_mesh` and `point_grid`
volume     `sample_surface`, `volumes_intersect`
"""

from sim.meshes.files import MeshError, OpenMeshWarning, load_mesh, point_grid
from sim.meshes.paint import PAINTS
from sim.meshes.vehicles import VEHICLE_KINDS, make_vehicle
from sim.meshes.volume import bounding_box, sample_surface, volumes_intersect

__all__ = [
    "PAINTS",
    "VEHICLE_KINDS",
    "MeshError",
    "OpenMeshWarning",
    "bounding_box",
    "load_mesh",
    "make_vehicle",
    "point_grid",
    "sample_surface",
    "volumes_intersect",
]
