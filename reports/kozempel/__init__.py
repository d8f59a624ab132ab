"""Studies of airborne georeferencing, Kozempel 2012, chapters 3 and 4, beside what the source says.

Functions of a `StudyResult` that study files name, as ``kozempel_...``. Every module of a part has TABLES and FIGURES
of its own, merged here.
"""

from collections.abc import Callable

import pandas as pd
from matplotlib.figure import Figure

from reports.kozempel import (
    boresight,
    boresight_design,
    boresight_figures,
    boresight_offset,
    boresight_statements,
    boresight_ties,
    interior,
    interior_figures,
    ortho,
    ortho_figures,
    ortho_statements,
    road,
    road_figures,
    road_statements,
)

TABLES: dict[str, Callable[..., pd.DataFrame]] = {
    "kozempel_boresight_claims": boresight_statements.claims,
    "kozempel_boresight_design": boresight_design.design_table,
    "kozempel_boresight_noise": boresight_design.noise_table,
    "kozempel_boresight_offset": boresight_offset.offset_table,
    "kozempel_boresight_smallest": boresight_design.smallest,
    "kozempel_boresight_ties": boresight_ties.ties_table,
    "kozempel_boresight_ways": boresight.ways_table,
    "kozempel_interior_claims": interior.claims,
    "kozempel_interior_design": interior.design_table,
    "kozempel_interior_parameters": interior.parameters_table,
    "kozempel_interior_iteration": interior.iteration_table,
    "kozempel_ortho_claims": ortho_statements.claims,
    "kozempel_ortho_passes": ortho.passes_table,
    "kozempel_ortho_budget": ortho.budget_table,
    "kozempel_ortho_methods": ortho.methods_table,
    "kozempel_road_claims": road_statements.claims,
    "kozempel_road_faults": road.faults_table,
    "kozempel_road_classes": road.classes_table,
    "kozempel_road_margins": road.margins_table,
}
FIGURES: dict[str, Callable[..., Figure]] = {
    "kozempel_boresight_curves": boresight_offset.curves_figure,
    "kozempel_boresight_honesty": boresight_figures.honesty_figure,
    "kozempel_boresight_images": boresight_offset.images_figure,
    "kozempel_boresight_maps": boresight_design.maps_figure,
    "kozempel_boresight_noise": boresight_design.noise_figure,
    "kozempel_boresight_numbers": boresight_design.images_figure,
    "kozempel_boresight_scatter": boresight_figures.scatter_figure,
    "kozempel_boresight_ties": boresight_ties.ties_figure,
    "kozempel_interior_design": interior_figures.design_figure,
    "kozempel_interior_field": interior_figures.field_figure,
    "kozempel_interior_iteration": interior_figures.iteration_figure,
    "kozempel_ortho_passes": ortho_figures.passes_figure,
    "kozempel_ortho_budget": ortho_figures.budget_figure,
    "kozempel_ortho_zones": ortho_figures.zones_figure,
    "kozempel_ortho_vectors": ortho_figures.vectors_figure,
    "kozempel_road_displacement": road_figures.displacement_figure,
    "kozempel_road_margins": road_figures.margins_figure,
    "kozempel_road_classes": road_figures.classes_figure,
}
