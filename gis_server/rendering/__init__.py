"""Rendering of a layer or image, at an address and in a style, to the bytes of a tile.

It reads rasters through a pool of open files (`reading`), colours them (`styles`, `painting`) and
encodes them (`png`, `tiles`). It is independent of HTTP and does not import `analysis` or `routes`.
"""
