"""The image front end: stereo images in, tracks with measured covariance out.

frames         stereo frames, read from files
front_end      `FrontEnd`: corners, bookkeeping, the loop over the frames
temporal       from one left image to the next
stereo_match   from left to right
templates      live tracks and the patches they are known by
registration   compiled sub-pixel registration
measured       tracks with the covariance that the images show
segmentation   where the target is, from motion and depth
"""

from estimators.stereo.features.frames import ImageError, StereoFrame, read_frames, to_grey
from estimators.stereo.features.front_end import FrontEnd

__all__ = ["FrontEnd", "ImageError", "StereoFrame", "read_frames", "to_grey"]
