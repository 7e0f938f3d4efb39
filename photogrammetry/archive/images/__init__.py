"""Image files: bytes in, `RoverImage`, grey values and masks out, or a derived raster.

`reading` is the entrance for images and `derived_rasters` that for disparity, XYZ and range
products. Corrections of the pixels need tables that the caller hands over. May not import `tables`.
"""
