"""Meshes and point clouds: glTF, 3D Tiles, Draco, PLY and STL.

Enters: meshes, points and solids of `photogrammetry.terrain`. Leaves: bytes or files for viewers
and printing programs, and their extent read back. Imports no other format.
"""
