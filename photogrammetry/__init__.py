"""Photogrammetry of rover stereo images: pure functions over arrays and frozen records.

Bytes, text and arrays enter, records and arrays leave; no function opens a file. Modules at this
level are shared by all packages: array types, errors, frames, images, planes, robust estimates and
the coordinates of Mars. Neither the other packages of solmap nor Prefect, FastAPI, rasterio or
geopandas may be imported.
"""
