"""Rasters: Cloud Optimised GeoTIFFs on the grid of a landing site's map.

Enters: bands on a `MapGrid`, or blocks of them one by one. Leaves: GeoTIFFs, and the same arrays
read back. `cog` defines every property of the files and writes also orthophotos, panoramas and
regions. `styles` has their colours, `tiling` divides the map into tiles. Imports no other format.
"""
