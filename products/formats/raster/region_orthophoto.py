"""A region's orthophoto on disk: merged tile by tile from those of its stops, at any size."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import rasterio
from pyproj import CRS
from rasterio.enums import Resampling
from rasterio.windows import Window

from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.stretching import black_and_white
from solmap.photogrammetry.terrain.dtm.grid import MapGrid, overlap, union
from solmap.photogrammetry.terrain.orthophoto.brightness import balance
from solmap.photogrammetry.terrain.orthophoto.merging import (
    MergingParams,
    StopImagery,
    merge_block,
)
from solmap.products.errors import ProductError
from solmap.products.formats.raster.orthophoto import BrightnessBlock, write_brightness_blocks
from solmap.products.formats.raster.raster import grid_of, open_raster
from solmap.products.formats.raster.region import CACHE_MB, TILE, RegionSource

COARSE_SIDE = 512
"""Cells along the longer side of the region at which the brightness of stops is compared."""


def write_region_orthophoto(
    path: Path,
    sources: Sequence[RegionSource],
    params: MergingParams,
    crs: CRS,
    tags: Mapping[str, str] | None = None,
) -> None:
    """Merge the orthophotos of stops, in cells no finer than the coarsest of them.

    Raises:
        ProductError: the region's cells are not a power of two of those of an orthophoto.
    """
    with contextlib.ExitStack() as held:
        held.enter_context(rasterio.Env(GDAL_CACHEMAX=CACHE_MB))
        orthophotos = [
            _Orthophoto(one, held.enter_context(open_raster(one.path))) for one in sources
        ]
        bounds = union([one.grid.bounds for one in orthophotos])
        cell_m = max(params.cell_m, *(one.grid.cell_m for one in orthophotos))
        params = replace(params, cell_m=cell_m, feather_m=max(params.feather_m, cell_m))
        grid = MapGrid.covering(bounds, cell_m)
        stretch = _balance(orthophotos, grid)
        blocks = _blocks(orthophotos, grid, params)
        write_brightness_blocks(path, grid, blocks, crs, stretches=[stretch], tags=tags)


def _balance(orthophotos: Sequence[_Orthophoto], grid: MapGrid) -> tuple[float, float]:
    """Make the stops agree where they overlap; brightness to show as black and as white."""
    cell_m = grid.cell_m
    while max(grid.rows, grid.cols) * grid.cell_m > COARSE_SIDE * cell_m:
        cell_m *= 2
    coarse = MapGrid.covering(grid.bounds, cell_m)
    shown = np.stack([one.read(coarse).ravel() for one in orthophotos])
    gains = balance(shown)
    for one, (gain, offset) in zip(orthophotos, gains, strict=True):
        one.gain, one.offset = float(gain), float(offset)
    balanced = shown * gains[:, :1] + gains[:, 1:]
    return black_and_white(balanced[np.isfinite(balanced)])


def _blocks(
    orthophotos: Sequence[_Orthophoto], grid: MapGrid, params: MergingParams
) -> Iterator[BrightnessBlock]:
    """The tiles covered by some stop."""
    halo = params.halo
    for row in range(0, grid.rows, TILE):
        for col in range(0, grid.cols, TILE):
            rows, cols = min(TILE, grid.rows - row), min(TILE, grid.cols - col)
            around = grid.part(row - halo, col - halo, rows + 2 * halo, cols + 2 * halo)
            tile = grid.part(row, col, rows, cols).bounds
            reached = [one for one in orthophotos if overlap(one.grid.bounds, tile)]
            read = [StopImagery(one.place, one.read(around)) for one in reached]
            stops = [stop for stop in read if np.isfinite(stop.brightness).any()]
            if stops:
                merged = merge_block(stops, around, params)
                yield row, col, merged[None, halo : halo + rows, halo : halo + cols]


class _Orthophoto:
    """An open orthophoto of a stop, read as brightness in cells of the region."""

    gain, offset = 1.0, 0.0
    """Gain and offset that make it agree with the others."""

    def __init__(self, source: RegionSource, dataset: rasterio.DatasetReader) -> None:
        self.source, self._dataset = source, dataset
        self.grid, self.place = grid_of(dataset), source.place

    def read(self, grid: MapGrid) -> Raster:
        """Balanced brightness on a grid that may extend beyond it; NaN where there is no image."""
        ratio = self._ratio(grid.cell_m)
        row, col = (
            round((self.grid.north - grid.north) / grid.cell_m),
            round((grid.west - self.grid.west) / grid.cell_m),
        )
        top, left = max(0, row), max(0, col)
        bottom = min(self.grid.rows // ratio, row + grid.rows)
        right = min(self.grid.cols // ratio, col + grid.cols)
        brightness = np.full(grid.shape, np.nan, np.float32)
        if bottom > top and right > left:
            stored = self._dataset.read(
                1,
                window=Window(*(ratio * n for n in (left, top, right - left, bottom - top))),
                out_shape=(bottom - top, right - left),
                resampling=Resampling.average,
            )
            scale, offset = self._dataset.scales[0], self._dataset.offsets[0]
            grey = stored.astype(np.float32) * np.float32(self.gain * scale)
            grey += np.float32(self.gain * offset + self.offset)
            there = (slice(top - row, bottom - row), slice(left - col, right - col))
            brightness[there] = np.where(stored > 0, grey, np.float32(np.nan))
        return brightness

    def _ratio(self, cell_m: float) -> int:
        ratio = np.log2(cell_m / self.grid.cell_m)
        if ratio < -1e-6 or abs(ratio - round(ratio)) > 1e-6:  # noqa: PLR2004 - decimal fractions
            raise ProductError(
                f"the orthophoto of {self.source.name} has cells of {self.grid.cell_m} m, the "
                f"region's of {cell_m} m: the latter must be a power of two times the former"
            )
        return 2 ** round(ratio)
