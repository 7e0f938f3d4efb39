"""Rasters: Cloud Optimised GeoTIFFs on the grid of a landing site's map.

Enters: bands on a `MapGrid`, or blocks of them one by one. Leaves: GeoTIFFs, and the same arrays
read back. `cog` decides every property of the files; orthophotos, panoramas and regions are written
by way of it. `styles` has their colours, `tiling` cuts the map into tiles. Imports no other format.
"""
