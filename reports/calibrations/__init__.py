"""Reports of calibrations of the boresight from clicked control points.

run          what a calibration's folder holds
tables       angles with their standard deviations, residuals of every click, what was left out
time_offset  residuals over an assumed time offset
metrics      rows of metrics.csv
figures      angles of every image, residuals in the image, residuals over time offset
html         the report
"""
