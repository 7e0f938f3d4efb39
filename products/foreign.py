"""Rasters of others, read onto the local map: orbital images and terrain models in any Mars CRS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pyproj import CRS
from rasterio.enums import Resampling
from rasterio.errors import CRSError, RasterioError
from rasterio.transform import Affine
from rasterio.warp import reproject, transform_bounds

from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.terrain.dtm.grid import Bounds, MapGrid
from solmap.products.errors import ProductError
from solmap.products.formats.raster.raster import open_raster

MOST_CELLS = 100_000_000
"""Of an image that is read whole: 10,000 x 10,000."""


def foreign_bounds(path: Path, crs: CRS) -> tuple[Bounds, float]:
    """(west, south, east, north) of a raster on the local map, and the side of its cells, metres.

    Raises:
        ProductError: it has no georeference, or one that is not on Mars.
    """
    with open_raster(path) as dataset:
        if dataset.crs is None:
            raise ProductError(f"{path.name} has no CRS: georeference it, or give control points")
        try:
            bounds = transform_bounds(dataset.crs, crs.to_wkt(), *dataset.bounds, densify_pts=21)
        except (CRSError, RasterioError) as error:
            raise ProductError(f"{path.name} is not on this map: {error}") from error
        if not np.isfinite(bounds).all():
            raise ProductError(f"{path.name} does not lie near the landing site")
        width_m = (bounds[2] - bounds[0]) / dataset.width
        height_m = (bounds[3] - bounds[1]) / dataset.height
    return bounds, float(np.sqrt(width_m * height_m))


def read_foreign(path: Path, grid: MapGrid, crs: CRS, band: int = 1) -> Raster:
    """A band of a raster on a grid of the local map; NaN where it has nothing.

    Larger cells are interpolated, smaller ones averaged.

    Raises:
        ProductError: the grid is too large to be read whole, or the file is broken.
    """
    if grid.rows * grid.cols > MOST_CELLS:
        raise ProductError(f"{path.name} on {grid.shape} cells is too large: ask for less ground")
    out = np.full(grid.shape, np.nan, dtype=np.float32)
    transform = Affine(grid.cell_m, 0.0, grid.west, 0.0, -grid.cell_m, grid.north)
    with open_raster(path) as dataset:
        finer = abs(dataset.transform.a) < grid.cell_m / 1.5
        try:
            values = dataset.read(band, masked=True).astype(np.float32).filled(np.nan)
            reproject(
                values,
                out,
                src_transform=dataset.transform,
                src_crs=dataset.crs,
                src_nodata=np.nan,
                dst_transform=transform,
                dst_crs=crs.to_wkt(),
                dst_nodata=np.nan,
                resampling=Resampling.average if finer else Resampling.cubic,
            )
        except (CRSError, RasterioError) as error:
            raise ProductError(f"{path.name} cannot be read: {error}") from error
        scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
    return out * np.float32(scale) + np.float32(offset)
