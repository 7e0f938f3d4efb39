"""The tile matrix set of a landing site: its map divided into tiles of 256 x 256 cells.

The set is a square around the landing point. Zoom 20 has cells of 0.01 m; every zoom below doubles
the cell, so that zoom 0 is one tile with a side of

    256 * 0.01 m * 2^20 = 2684354.56 m,        cell(z) = 0.01 m * 2^(20 - z)

The lander is at a corner of tiles at every zoom except 0, and map grids (`MapGrid.covering`) start
and end on whole tiles of the zoom of their cell: a block of a raster is a tile, and the overviews
of a raster are the lower zooms. Nothing is resampled for display.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import morecantile
from pyproj import CRS

from solmap.photogrammetry.terrain.dtm.grid import BLOCK, FINEST_CELL_M
from solmap.products.crs import IAU_RADIUS_M, LandingPoint, local_crs
from solmap.products.errors import OutsideCoverageError, ProductError

MAX_ZOOM = 20
HALF_SIDE_M = FINEST_CELL_M * BLOCK * 2 ** (MAX_ZOOM - 1)
EXTENT = (-HALF_SIDE_M, -HALF_SIDE_M, HALF_SIDE_M, HALF_SIDE_M)
"""(west, south, east, north) of the whole set, metres."""
CELL_SIZES = tuple(FINEST_CELL_M * 2 ** (MAX_ZOOM - zoom) for zoom in range(MAX_ZOOM + 1))
"""Cell of every zoom, metres."""


@dataclass(frozen=True, slots=True)
class TileAddress:
    """A tile: zoom, column counted from the west and row counted from the north."""

    zoom: int
    column: int
    row: int

    def __post_init__(self) -> None:
        if not 0 <= self.zoom <= MAX_ZOOM:
            raise OutsideCoverageError(f"zoom {self.zoom} is not between 0 and {MAX_ZOOM}")
        tiles = 2**self.zoom
        if not (0 <= self.column < tiles and 0 <= self.row < tiles):
            raise OutsideCoverageError(
                f"zoom {self.zoom} has columns and rows 0 to {tiles - 1}; column {self.column}, "
                f"row {self.row} is outside"
            )

    @property
    def cell_m(self) -> float:
        """Size of the tile's pixels on the ground, metres."""
        return CELL_SIZES[self.zoom]

    @property
    def west_north(self) -> tuple[float, float]:
        """The outer north-west corner, metres."""
        middle = 2**self.zoom / 2
        side_m = BLOCK * self.cell_m
        return (self.column - middle) * side_m, (middle - self.row) * side_m

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(west, south, east, north), metres."""
        west, north = self.west_north
        side_m = BLOCK * self.cell_m
        return west, north - side_m, west + side_m, north


def zoom_of(cell_m: float) -> int:
    """The zoom with the cells of a raster.

    Raises:
        ProductError: the cell is not one of the set's.
    """
    for zoom, size in enumerate(CELL_SIZES):
        if math.isclose(size, cell_m, rel_tol=1e-9):
            return zoom
    raise ProductError(
        f"a cell of {cell_m} m is not 0.01 m times a power of two up to 2^{MAX_ZOOM}"
    )


def whole_zoom_of(bounds: tuple[float, float, float, float]) -> int:
    """The finest zoom at which bounds of this size fit into one tile: a first look at a layer."""
    west, south, east, north = bounds
    side_m = max(east - west, north - south, FINEST_CELL_M)
    fitting = [zoom for zoom, size in enumerate(CELL_SIZES) if BLOCK * size >= side_m]
    return max(fitting, default=0)


@lru_cache(maxsize=64)
def tile_matrix_set(landing: LandingPoint) -> morecantile.TileMatrixSet:
    """The OGC tile matrix set of a landing site, or of a map that is not tied to one."""
    # the format requires an ellipsoid, even for a map that is not tied to one
    crs = local_crs(replace(landing, origin="", radius_m=landing.radius_m or IAU_RADIUS_M))
    degrees = crs.geodetic_crs
    assert degrees is not None  # noqa: S101 - a projected CRS has one
    made = morecantile.TileMatrixSet.custom(
        list(EXTENT),
        crs,
        tile_width=BLOCK,
        tile_height=BLOCK,
        minzoom=0,
        maxzoom=MAX_ZOOM,
        id="".join(c if c.isalnum() else "-" for c in landing.name),
        title=f"Tiles of the map of {landing.name}",
        geographic_crs=CRS(degrees),
    )
    if not landing.origin:
        return made
    untied = morecantile.models.CRSWKT(wkt=local_crs(landing).to_json_dict())
    return made.model_copy(update={"crs": morecantile.models.CRS(untied)})
