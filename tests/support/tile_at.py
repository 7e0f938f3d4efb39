"""The tile that a place lies in."""

from __future__ import annotations

import math

from solmap.photogrammetry.terrain.dtm.grid import BLOCK
from solmap.products.formats.raster.tiling import CELL_SIZES, TileAddress


def tile_at(east: float, north: float, zoom: int) -> TileAddress:
    """The tile of a zoom that a place lies in."""
    side_m = BLOCK * CELL_SIZES[zoom]
    middle = 2**zoom / 2
    column, row = math.floor(east / side_m + middle), math.ceil(middle - north / side_m) - 1
    return TileAddress(zoom, column, row)
