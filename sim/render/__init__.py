"""From the world to images: colour, depth, instance mask and optical flow. The only importer of pyrender and OpenGL.

light       sun, sky and haze; the picture of the sky
placement   items, level of detail, culling          pure geometry
chunks      large surfaces in pieces             pure geometry
view        projection and light boxes               pure geometry
lens        distortion by resampling                 pure geometry
flow        optical flow from depth and poses        pure geometry
blur        the mean light of an exposure            pure geometry
surroundings  what is mirrored, and what shades         pure geometry
context     the process's OpenGL context
gpu         buffers, textures, shaders               OpenGL
passes      what is drawn in which order             OpenGL
renderer    `Renderer`, which calls them
"""

from sim.render.blur import mean_light, moments, motion_px
from sim.render.context import RendererUnavailable
from sim.render.flow import optical_flow
from sim.render.light import Light
from sim.render.placement import Item
from sim.render.renderer import PRODUCTS, Renderer, View

__all__ = [
    "PRODUCTS",
    "Item",
    "Light",
    "Renderer",
    "RendererUnavailable",
    "View",
    "mean_light",
    "moments",
    "motion_px",
    "optical_flow",
]
