"""Contours of a terrain model at any interval, as features."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from rasterio.windows import Window

from solmap.gis_server.rendering.looks import UnknownLookError
from solmap.gis_server.rendering.readers import RasterPool
from solmap.photogrammetry.terrain.dtm.grid import Bounds
from solmap.photogrammetry.terrain.relief.contours import (
    Contour,
    ContourParams,
    RegionContourParams,
    trace_contours,
)
from solmap.products.formats.raster.raster import grid_of
from solmap.products.formats.vector.geojson import Feature, contour_feature
from solmap.products.model import Layer, ProductKind
from solmap.products.store.product_store import ProductStore

_MOST_CELLS = 8_000_000
"""Cells to trace at once: two seconds of a processor."""
_MOST_LEVELS = 500


def contours_in(
    layer: Layer,
    interval_m: float,
    bounds: Bounds | None,
    store: ProductStore,
    pool: RasterPool,
) -> list[Feature]:
    """Contours of a terrain model inside some bounds, or of all of it.

    Raises:
        UnknownLookError: they would be too many, or the area is too large.
    """
    low, high = layer.range or (0.0, 1.0)
    if (high - low) / interval_m > _MOST_LEVELS:
        raise UnknownLookError(
            f"an interval of {interval_m:g} m gives {(high - low) / interval_m:.0f} "
            f"contours between {low:.1f} and {high:.1f} m; ask for one above "
            f"{(high - low) / _MOST_LEVELS:.2g} m"
        )
    address = store.address(layer.ref)
    window = _window(layer, bounds, address, pool)
    if window is None:
        return []
    own = RegionContourParams() if layer.ref.kind == ProductKind.REGION_DTM else ContourParams()
    traced = _traced(address, window, replace(own, interval_m=interval_m), pool)
    return [contour_feature(contour) for contour in traced]


def _window(
    layer: Layer, bounds: Bounds | None, address: Path | str, pool: RasterPool
) -> tuple[int, int, int, int] | None:
    """First row and column, and rows and columns, of the cells inside some bounds."""
    with pool.reading(address) as dataset:
        grid = grid_of(dataset)
    west, south, east, north = bounds or grid.bounds
    top, left = (grid.north - north) / grid.cell_m, (west - grid.west) / grid.cell_m
    bottom, right = (grid.north - south) / grid.cell_m, (east - grid.west) / grid.cell_m
    first_row, last_row = (round(min(max(at, 0.0), grid.rows)) for at in (top, bottom))
    first_col, last_col = (round(min(max(at, 0.0), grid.cols)) for at in (left, right))
    rows, cols = last_row - first_row, last_col - first_col
    if rows * cols > _MOST_CELLS:
        raise UnknownLookError(
            f"{layer.id} has {rows} x {cols} cells there, and contours are traced of "
            f"{_MOST_CELLS} at once: give a smaller bbox"
        )
    return (first_row, first_col, rows, cols) if rows > 1 and cols > 1 else None


@lru_cache(maxsize=8)
def _traced(
    address: Path | str, window: tuple[int, int, int, int], params: ContourParams, pool: RasterPool
) -> tuple[Contour, ...]:
    row, col, rows, cols = window
    with pool.reading(address) as dataset:
        elevation = dataset.read(1, window=Window(col, row, cols, rows))
        grid = grid_of(dataset).part(row, col, rows, cols)
    return trace_contours(elevation, grid, params)
