"""The ground in three dimensions: meshes, tiles, point clouds and solids.

Terrain models and views enter; points, triangles and textures in metres of the local map leave, to
be written by `products.formats.mesh`. Of terrain `dtm` and `orthophoto` may be imported.
"""
