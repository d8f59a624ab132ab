"""Tables, truth and estimates to matplotlib figures; no I/O and no pyplot state.

`trajectory`, `velocity`, `depth_error` and `nees` take tidy tables, `point_cloud` and `frame_strip` what they draw.
"""

from reports.figures.cloud import point_cloud
from reports.figures.front_end import front_end
from reports.figures.series import depth_error, nees, trajectory, velocity
from reports.figures.strip import frame_strip

__all__ = ["depth_error", "frame_strip", "front_end", "nees", "point_cloud", "trajectory", "velocity"]
