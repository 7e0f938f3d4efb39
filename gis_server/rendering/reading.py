"""Rasters for tiles: a pool of open files, and the cells that a tile is drawn from.

Opening a raster costs more than reading a tile of it, and its decoded blocks are lost when it is
closed. Datasets must not be shared between threads, so a thread borrows one exclusively. Products
never change, so an open one stays valid.

Rasters are snapped to the tile matrix set, so a tile at the raster's own zoom is one block, a tile
below it one block of an overview, and a tile above it a part of a block whose cells are repeated:
cells keep their measured values at every zoom. Slope, shading and contours depend on neighbouring
cells; a patch with a margin has those of the tiles around it, so that tiles meet without a seam.
Above the raster's own zoom they are computed on its own cells, and repeated afterwards.

Windows are clipped to the raster by hand, because GDAL's boundless reads decode blocks again and
again.
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.errors import RasterioError
from rasterio.windows import Window

from solmap.photogrammetry.terrain.dtm.grid import BLOCK
from solmap.products.formats.raster.raster import grid_of, open_raster, read_error
from solmap.products.formats.raster.tiling import TileAddress

# By default GDAL uses a twentieth of the memory for blocks. The variable counts megabytes and is
# read once; set as an option from Python the same number would count bytes.
os.environ.setdefault("GDAL_CACHEMAX", "256")

OPEN_RASTERS = 64
"""Rasters kept open: identifying a place reads some fifty layers, and opening one takes 10 ms."""


class RasterPool:
    """Idle datasets, the least recently used closed first."""

    def __init__(self, idle: int = OPEN_RASTERS) -> None:
        """Keep at most `idle` datasets open while nobody reads them."""
        self._limit = idle
        self._idle: OrderedDict[int, tuple[Path | str, rasterio.DatasetReader]] = OrderedDict()
        self._lock = threading.Lock()
        self._found = [0, 0]

    @property
    def waiting(self) -> int:
        """How many are open and idle."""
        return len(self._idle)

    @property
    def lookups(self) -> tuple[int, int]:
        """Numbers of cache hits and misses."""
        return self._found[0], self._found[1]

    @contextlib.contextmanager
    def reading(self, address: Path | str) -> Iterator[rasterio.DatasetReader]:
        """Borrow an open dataset of a file or object.

        Raises:
            ProductNotFoundError: the file is not there.
            StoreAwayError: the object store does not answer.
            ProductError: it cannot be read.
        """
        dataset = self._take(address) or open_raster(address)
        try:
            yield dataset
        except RasterioError as error:
            dataset.close()
            raise read_error(address, error) from error
        except BaseException:
            dataset.close()
            raise
        self._give(address, dataset)

    def close(self) -> None:
        """Close idle datasets."""
        with self._lock:
            for _, dataset in self._idle.values():
                dataset.close()
            self._idle.clear()

    def _take(self, address: Path | str) -> rasterio.DatasetReader | None:
        with self._lock:
            for key in reversed(self._idle):
                if self._idle[key][0] == address:
                    self._found[0] += 1
                    return self._idle.pop(key)[1]
            self._found[1] += 1
        return None

    def _give(self, address: Path | str, dataset: rasterio.DatasetReader) -> None:
        with self._lock:
            self._idle[id(dataset)] = (address, dataset)
            surplus = len(self._idle) - self._limit
            evicted = [self._idle.popitem(last=False)[1][1] for _ in range(surplus)]
        for old in evicted:
            old.close()


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Cells around a tile, square on the ground."""

    values: np.ndarray
    """Stored values, rows by columns; nodata beyond the raster."""
    cell_m: float
    """Size of these cells: the tile's pixel, or the raster's cell where that is larger."""
    row_at: np.ndarray
    """Position in `values` of the middle of every row of the tile, counted from the corner."""
    column_at: np.ndarray

    @property
    def is_repeated(self) -> bool:
        """Whether a cell is more than one pixel."""
        return bool(self.row_at[-1] - self.row_at[0] < len(self.row_at) - 1.5)

    def tile(self, computed: np.ndarray) -> np.ndarray:
        """Values computed per cell (last two axes), resampled to the tile."""
        rows, columns = self.row_at.astype(int), self.column_at.astype(int)
        if self.is_repeated:
            return computed[..., rows[:, None], columns[None, :]]
        return computed[..., rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]

    def interpolate(self, computed: np.ndarray) -> np.ndarray:
        """Values computed per cell, interpolated bilinearly between the middles of cells."""
        if not self.is_repeated:
            return self.tile(computed)
        at = np.meshgrid(self.column_at - 0.5, self.row_at - 0.5)
        columns, rows = (axis.astype(np.float32) for axis in at)
        return cv2.remap(computed, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def read_patch(
    dataset: rasterio.DatasetReader,
    address: TileAddress,
    band: int = 1,
    how: Resampling = Resampling.average,
    *,
    margin: int = 0,
    border: int = 0,
) -> Patch | None:
    """The cells of a tile; None where the raster holds none of them.

    Args:
        dataset: The raster.
        address: The tile.
        band: Which band, from 1.
        how: How cells become pixels that are larger than they.
        margin: Cells to read around those that are shown.
        border: Pixels that are shown around the tile's 256 x 256.
    """
    grid = grid_of(dataset)
    west, north = address.west_north
    ratio = address.cell_m / grid.cell_m
    step = min(ratio, 1.0)  # tiles and grids share a lattice: any remainder is rounding
    row = round((grid.north - north) / grid.cell_m / step) * step
    col = round((west - grid.west) / grid.cell_m / step) * step
    pixels = np.arange(-border, BLOCK + border) + 0.5
    if ratio < 1.0 - 1e-9:
        row_at, column_at = row + pixels * ratio, col + pixels * ratio
        own, top, left = _own_cells(dataset, band, row_at, column_at, margin)
        return None if own is None else Patch(own, grid.cell_m, row_at - top, column_at - left)
    around = margin + border
    corner = (row / ratio - around, col / ratio - around)
    larger = _larger_cells(dataset, band, corner, ratio, how, BLOCK + 2 * around)
    return (
        None if larger is None else Patch(larger, address.cell_m, pixels + around, pixels + around)
    )


def read_tile(
    dataset: rasterio.DatasetReader,
    address: TileAddress,
    band: int = 1,
    how: Resampling = Resampling.average,
) -> np.ndarray | None:
    """Stored values of a tile, nodata where the raster ends; None where it holds none of it."""
    patch = read_patch(dataset, address, band, how)
    return None if patch is None else patch.tile(patch.values)


def _own_cells(
    dataset: rasterio.DatasetReader,
    band: int,
    row_at: np.ndarray,
    column_at: np.ndarray,
    margin: int,
) -> tuple[np.ndarray | None, int, int]:
    """The raster's own cells under some pixels, with a margin, and their first row and column."""
    top, left = math.floor(row_at[0]) - margin, math.floor(column_at[0]) - margin
    bottom, right = math.floor(row_at[-1]) + margin + 1, math.floor(column_at[-1]) + margin + 1
    first_row, last_row = max(0, top), min(bottom, dataset.height)
    first_col, last_col = max(0, left), min(right, dataset.width)
    if first_row >= last_row or first_col >= last_col:
        return None, top, left
    window = Window(first_col, first_row, last_col - first_col, last_row - first_row)
    part = dataset.read(band, window=window)
    shape = (bottom - top, right - left)
    return _pad(dataset, part, shape, first_row - top, first_col - left), top, left


def _larger_cells(
    dataset: rasterio.DatasetReader,
    band: int,
    corner: tuple[float, float],
    ratio: float,
    how: Resampling,
    side: int,
) -> np.ndarray | None:
    """A square of pixels `ratio` cells wide, 1 or more, from the overview that fits."""
    row, col = corner
    rows = _span(row, dataset.height / ratio, side)
    cols = _span(col, dataset.width / ratio, side)
    if not (rows and cols):
        return None
    top, left = max((row + rows.start) * ratio, 0.0), max((col + cols.start) * ratio, 0.0)
    bottom = min((row + rows.stop) * ratio, dataset.height)
    right = min((col + cols.stop) * ratio, dataset.width)
    part = dataset.read(
        band,
        window=Window(left, top, right - left, bottom - top),
        out_shape=(len(rows), len(cols)),
        resampling=how,
    )
    return _pad(dataset, part, (side, side), rows.start, cols.start)


def _span(origin: float, size: float, side: int) -> range:
    """Pixels of a tile starting at `origin` that lie on a raster of `size` such pixels."""
    return range(max(0, math.floor(-origin)), min(side, math.ceil(size - origin)))


def _pad(
    dataset: rasterio.DatasetReader, part: np.ndarray, shape: tuple[int, int], row: int, col: int
) -> np.ndarray:
    """A part of a raster with nodata around it."""
    if part.shape == shape:
        return part
    whole = np.full(shape, dataset.nodata, part.dtype)
    whole[row : row + part.shape[0], col : col + part.shape[1]] = part
    return whole
