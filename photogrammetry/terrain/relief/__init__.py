"""The shape of a terrain model: slope, aspect, roughness, hillshade and contours.

A terrain model enters; rasters with their grid, and contour lines, leave. Only `dtm` may be
imported of terrain.
"""
