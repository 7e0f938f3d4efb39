"""Features of a mission as collections, for OGC API Features and the map.

Enters: published vector layers and annotations. Leaves: collections, an index of their features on
disk, filled on demand, and the features of a layer as GeoJSON text in local metres. May import
`catalogue` and `formats`, not `reports`.
"""
