"""Reports of real recordings: what can be said without truth, and, with measured ego poses, against them.

run       what a recording's folder holds
motion    the camera's motion, or a vehicle's, window by window, with its standard deviation
metrics   rows of metrics.csv
figures   images with tracks, motion over time, epipolar errors
html      the report
"""
