"""Vectors: features on the local map as GeoJSON in degrees of Mars, and as GeoPackage.

Enters: `Feature` records in metres of the local map. Leaves: files, and the same records read back.
GeoJSON is the format of products; geopandas writes the others on request
(docs/decisions/0007-geopandas.md). Imports no other format.
"""
