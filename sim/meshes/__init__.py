"""Vehicles and other bodies: parametric cars, vans, lorries and buses, mesh files, point grids, surface points.

`make_vehicle` builds a kind, `load_mesh` reads a file, `point_grid` is a grid without a body; `sample_surface` draws
measurable points and `volumes_intersect` tests two placed bodies.
"""

from sim.meshes.vehicles import VEHICLE_KINDS, make_vehicle

__all__ = ["VEHICLE_KINDS", "make_vehicle"]
