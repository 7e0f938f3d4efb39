"""Image files: bytes in, `RoverImage`, grey values and masks out, or a derived raster.

`reading` reads images, `derived_rasters` disparity, XYZ and range products. Corrections of the
pixels need tables that the caller passes in. May not import `tables`.
"""
