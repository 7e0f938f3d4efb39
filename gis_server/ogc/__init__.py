"""OGC API Features and Tiles, and WMTS 1.0.0: a mission's features and rasters by open standards.

Inputs are requests, outputs are documents, features and tiles of the latest layers. `landing` joins
the parts; tiles are drawn by `rendering`. It does not import `routes`, `analysis` or
`collaboration`.
"""
