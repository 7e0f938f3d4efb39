"""Rendering: a layer or image, an address and a style enter, the bytes of a tile or image leave.

It reads rasters through a pool of open files (`reading`), colours them (`styles`, `painting`) and
encodes them (`png`, `tiles`). It is independent of HTTP and does not import `analysis` or `routes`.
"""
