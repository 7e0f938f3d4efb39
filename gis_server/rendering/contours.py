"""Contours of a terrain model at any interval: as lines in a tile and as features.

Elevations are smoothed as for the contours that are made once (`terrain`). With the elevation h of
a pixel and the gradient |h'| per pixel, its distance from the nearest contour is

    d = |h - i rint(h / i)| / |h'|        i the interval

pixels, to first order, and a line w pixels wide covers max(0, min(1, w / 2 + 1/2 - d)) of it.
Every fifth contour is drawn wider, as on printed maps. Lines are left out where they would touch:
with less than three pixels between contours.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from rasterio.windows import Window

from solmap.gis_server.rendering.reading import Patch, RasterPool
from solmap.gis_server.rendering.styles import UnknownStyleError
from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.terrain.dtm.grid import Bounds
from solmap.photogrammetry.terrain.relief.contours import (
    Contour,
    ContourParams,
    RegionContourParams,
    interval_by_relief,
    smooth_elevation,
    trace_contours,
)
from solmap.products.formats.raster.raster import grid_of
from solmap.products.formats.vector.geojson import Feature, contour_feature
from solmap.products.model import Layer, ProductKind
from solmap.products.store.product_store import ProductStore

_PARAMS = ContourParams()
_LINE_PX, _INDEX_PX = 1.0, 2.0
_LEVEL = 1e-6
"""Rise per pixel, in intervals, below which ground is level and has no contour."""
_CROWDED = 1 / 3
"""Rise per pixel, in intervals, above which contours would touch."""
_MOST_CELLS = 8_000_000
"""Cells to trace at once: two seconds of a processor."""
_MOST_LEVELS = 500


def smoothing_m(cell_m: float) -> float:
    """Standard deviation of the Gaussian: that of contours, but at least one pixel."""
    return max(_PARAMS.smoothing_m, cell_m)


def contour_margin(cell_m: float) -> int:
    """Cells around a tile that its contours depend on."""
    return math.ceil(4.0 * smoothing_m(cell_m) / cell_m) + 1


def interval_of(layer: Layer, requested_m: float | None) -> float:
    """The requested interval, or one that suits the layer's relief."""
    if requested_m is not None:
        return requested_m
    low, high = layer.range or (0.0, 1.0)
    return interval_by_relief(np.array([low, high]), _PARAMS.most_contours)


def contour_cover(patch: Patch, interval_m: float) -> np.ndarray:
    """Share of every pixel covered by lines, 0 to 255."""
    sigma_m = smoothing_m(patch.cell_m)
    smooth = smooth_elevation(patch.values, patch.cell_m, sigma_m, _PARAMS.min_share)
    return _cover(patch.interpolate(smooth) / np.float32(interval_m))


def _cover(height: Raster) -> np.ndarray:
    """Share covered by lines of round heights, for all pixels except the outer ones."""
    east = (height[1:-1, 2:] - height[1:-1, :-2]) / 2
    south = (height[2:, 1:-1] - height[:-2, 1:-1]) / 2
    own = height[1:-1, 1:-1]
    rise = np.hypot(east, south)
    number = np.rint(own)
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.abs(own - number) / rise
        fifths = number / _PARAMS.index_every
        is_index = fifths == np.rint(fifths)
        width = np.where(is_index, np.float32(_INDEX_PX), np.float32(_LINE_PX))
        cover = np.clip(width / 2 + np.float32(0.5) - distance, 0.0, 1.0)
        spaced = np.where(is_index, rise / _PARAMS.index_every, rise) < _CROWDED
    drawn = (rise > _LEVEL) & spaced
    return cv2.convertScaleAbs(np.where(drawn, cover, np.float32(0)), alpha=255.0)


def contours_in(
    layer: Layer,
    interval_m: float,
    bounds: Bounds | None,
    store: ProductStore,
    pool: RasterPool,
) -> list[Feature]:
    """Contours of a terrain model inside some bounds, or of all of it.

    Raises:
        UnknownStyleError: they would be too many, or the area is too large.
    """
    low, high = layer.range or (0.0, 1.0)
    if (high - low) / interval_m > _MOST_LEVELS:
        raise UnknownStyleError(
            f"an interval of {interval_m:g} m gives {(high - low) / interval_m:.0f} contours "
            f"between {low:.1f} and {high:.1f} m; use one above {(high - low) / _MOST_LEVELS:.2g} "
            "m"
        )
    address = store.address(layer.ref)
    window = _window(layer, bounds, address, pool)
    if window is None:
        return []
    own = RegionContourParams() if layer.ref.kind == ProductKind.REGION_DTM else ContourParams()
    traced = _trace(address, window, replace(own, interval_m=interval_m), pool)
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
        raise UnknownStyleError(
            f"{layer.id} has {rows} x {cols} cells there, and contours are traced of "
            f"{_MOST_CELLS} at once: give a smaller bbox"
        )
    return (first_row, first_col, rows, cols) if rows > 1 and cols > 1 else None


@lru_cache(maxsize=8)
def _trace(
    address: Path | str, window: tuple[int, int, int, int], params: ContourParams, pool: RasterPool
) -> tuple[Contour, ...]:
    row, col, rows, cols = window
    with pool.reading(address) as dataset:
        elevation = dataset.read(1, window=Window(col, row, cols, rows))
        grid = grid_of(dataset).part(row, col, rows, cols)
    return trace_contours(elevation, grid, params)
