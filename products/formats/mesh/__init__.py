"""Meshes and point clouds: glTF, 3D Tiles, Draco, PLY and STL.

Enters: meshes, points and solids of `photogrammetry.terrain`. Leaves: bytes or files that viewers
and printing programs open, and their extent read back. Imports no other format.
"""
