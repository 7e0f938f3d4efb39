"""The terrain models of a mission combined: sampled at points, or resampled to a grid.

Models are read in windows around the requested points. A large window is divided, so that a long
profile does not read a whole large model. At every point and cell, the measured value of the model
with the smallest cells is used; among equal cells, that with the smallest standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import rasterio
import rasterio.features
from affine import Affine
from rasterio.enums import Resampling
from rasterio.windows import Window

from solmap.gis_server.analysis.bodies import UnanswerableError
from solmap.gis_server.rendering.reading import RasterPool
from solmap.photogrammetry.arrays import Classes, Flags, Raster
from solmap.photogrammetry.terrain.dtm.grid import Bounds, MapGrid
from solmap.photogrammetry.terrain.dtm.resampling import (
    NOWHERE,
    GroundSamples,
    MapPoints,
    finest_samples,
    sample_bilinear,
)
from solmap.products.formats.raster.raster import band_names, grid_of
from solmap.products.model import Layer, ProductKind
from solmap.products.store.product_store import ProductStore

MODELS = (ProductKind.DTM, ProductKind.REGION_DTM, ProductKind.FAR_DTM)
"""Kinds of terrain models, in metres above the tangent plane."""
BEST = "best"
"""Identifier of the combined models: the finest measured one at every point."""
_WINDOW = 1 << 20
"""Largest window that is read at once, in cells; 4 MB per band."""
_BANDS = ("elevation", "standard_deviation", "pose_deviation")


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Terrain models that are used together; the finest has precedence."""

    models: tuple[Layer, ...]
    store: ProductStore
    pool: RasterPool

    @classmethod
    def of(
        cls, layers: Iterable[Layer], requested: str, store: ProductStore, pool: RasterPool
    ) -> Ground:
        """The requested models: one by the layer's id, or all as `best`.

        Raises:
            UnanswerableError: no layer of that id is a terrain model.
        """
        models = [layer for layer in layers if layer.ref.kind in MODELS]
        chosen = [layer for layer in models if requested in (BEST, layer.id)]
        if not chosen:
            names = ", ".join(layer.id for layer in models[:5]) or "none"
            raise UnanswerableError(
                f"{requested} is not a terrain model of this mission; available: {names}; '{BEST}' "
                "uses the finest one at every point"
            )
        return cls(tuple(chosen), store, pool)

    @property
    def finest_cell_m(self) -> float:
        """The smallest cell size of all models, metres."""
        return min(cell_of(layer) for layer in self.models)

    def at(self, places: MapPoints) -> GroundSamples:
        """Ground at map points; `source` is the index of the model in `models`."""
        found = [GroundSamples.unknown(len(places))]
        cells = [math.inf]
        for number, layer in enumerate(self.models):
            west, south, east, north = layer.bounds
            inside = (places[:, 0] >= west) & (places[:, 0] <= east)
            inside &= (places[:, 1] >= south) & (places[:, 1] <= north)
            if inside.any():
                found.append(self._sample(layer, number, places, inside))
                cells.append(cell_of(layer))
        return finest_samples(list(zip(cells, found, strict=True)))

    def elevation(self, places: MapPoints) -> np.ndarray:
        """Elevations at map points, metres."""
        return self.at(places).elevation

    def _sample(self, layer: Layer, number: int, places: MapPoints, inside: Flags) -> GroundSamples:
        values = np.full((len(_BANDS), len(places)), np.nan)
        with self.pool.reading(self.store.address(layer.ref)) as dataset:
            values[:, inside] = sample_bands(dataset, _BANDS, places[inside])
        known = np.isfinite(values[0])
        return GroundSamples(
            values[0],
            values[1],
            np.where(known, np.nan_to_num(values[2]), np.nan),
            np.where(known, number, NOWHERE).astype(np.int32),
        )


def cell_of(layer: Layer) -> float:
    """Cell size of a raster layer, metres."""
    return layer.cell_m or math.inf


def sample_bands(
    dataset: rasterio.DatasetReader, bands: Sequence[str], places: MapPoints
) -> np.ndarray:
    """Bands of an open raster, interpolated bilinearly, one row per band; NaN for missing bands."""
    names = band_names(dataset)
    held = [name for name in bands if name in names]
    indexes = [names.index(name) + 1 for name in held]
    read = _read(dataset, grid_of(dataset), indexes, places)
    values = np.full((len(bands), len(places)), np.nan)
    for row, name in zip(read, held, strict=True):
        values[bands.index(name)] = row
    return values


def _read(
    dataset: rasterio.DatasetReader, grid: MapGrid, indexes: list[int], places: MapPoints
) -> np.ndarray:
    """Values at points; if their common window is too large, the points are divided in two."""
    window = _window_around(grid, places)
    if window.width * window.height > _WINDOW and len(places) > 1:
        order = np.argsort(places[:, 0] if window.width > window.height else places[:, 1])
        values = np.empty((len(indexes), len(places)))
        for half in np.array_split(order, 2):
            values[:, half] = _read(dataset, grid, indexes, places[half])
        return values
    stack = dataset.read(indexes, window=window)
    part = grid.part(window.row_off, window.col_off, window.height, window.width)
    return np.stack([sample_bilinear(band, part, places) for band in stack])


def _window_around(grid: MapGrid, places: MapPoints) -> Window:
    """The window of the grid that contains the cells around all points."""
    col = (places[:, 0] - grid.west) / grid.cell_m
    row = (grid.north - places[:, 1]) / grid.cell_m
    left, top = (max(0, math.floor(float(at.min())) - 1) for at in (col, row))
    right = min(grid.cols, math.floor(float(col.max())) + 2)
    bottom = min(grid.rows, math.floor(float(row.max())) + 2)
    left, top = min(left, grid.cols - 1), min(top, grid.rows - 1)
    return Window(left, top, max(1, right - left), max(1, bottom - top))


def mosaic(ground: Ground, grid: MapGrid) -> tuple[Raster, list[Layer]]:
    """Elevation on a grid, by the precedence of the module, and the contributing models.

    Smaller cells are averaged, larger ones are resampled by nearest neighbour.
    """
    elevation = np.full(grid.shape, np.nan, np.float32)
    best = np.full(grid.shape, np.inf, np.float32)
    number = np.full(grid.shape, -1, np.int32)
    order = sorted(range(len(ground.models)), key=lambda k: -cell_of(ground.models[k]))
    former = math.inf
    for k in order:
        layer = ground.models[k]
        part = _overlap(layer.bounds, grid)
        if part is None:
            continue
        if cell_of(layer) < former:  # a finer model has precedence wherever it is measured
            former, best[:] = cell_of(layer), np.inf
        with ground.pool.reading(ground.store.address(layer.ref)) as dataset:
            height, sigma = _read_part(dataset, grid, part)
        rows, cols = part
        better = np.isfinite(height) & (sigma < best[rows, cols])
        elevation[rows, cols][better] = height[better]
        best[rows, cols][better] = sigma[better]
        number[rows, cols][better] = k
    used = sorted(set(number[number >= 0].tolist()))
    return elevation, [ground.models[k] for k in used]


def _overlap(bounds: Bounds, grid: MapGrid) -> tuple[slice, slice] | None:
    """Rows and columns of a grid that are completely within bounds; None if there are none."""
    west, south, east, north = bounds
    rows = slice(
        max(0, math.ceil((grid.north - north) / grid.cell_m - 1e-6)),
        min(grid.rows, math.floor((grid.north - south) / grid.cell_m + 1e-6)),
    )
    cols = slice(
        max(0, math.ceil((west - grid.west) / grid.cell_m - 1e-6)),
        min(grid.cols, math.floor((east - grid.west) / grid.cell_m + 1e-6)),
    )
    return (rows, cols) if rows.stop > rows.start and cols.stop > cols.start else None


def _read_part(
    dataset: rasterio.DatasetReader, grid: MapGrid, part: tuple[slice, slice]
) -> tuple[Raster, Raster]:
    """Elevation and its standard deviation on a part of the grid."""
    window, shape = _window(grid_of(dataset), grid, part)
    names = band_names(dataset)
    bands = [names.index(n) + 1 for n in ("elevation", "standard_deviation") if n in names]
    how = Resampling.average if window.width > shape[1] else Resampling.nearest
    read = dataset.read(bands, window=window, out_shape=(len(bands), *shape), resampling=how)
    sigma = read[1] if len(read) > 1 else np.zeros(shape, np.float32)
    unsure: Raster = np.where(np.isfinite(sigma), sigma, np.float32(1e6))
    return read[0], unsure


def worst_classes(
    layers: Sequence[Layer], grid: MapGrid, store: ProductStore, pool: RasterPool
) -> tuple[Classes, list[Layer]]:
    """The highest class code of all layers at every cell of a grid (0: unknown).

    The second result is the layers that overlap the grid.
    """
    found = np.zeros(grid.shape, np.uint8)
    used = []
    for layer in layers:
        part = _overlap(layer.bounds, grid)
        if part is None:
            continue
        with pool.reading(store.address(layer.ref)) as dataset:
            window, shape = _window(grid_of(dataset), grid, part)
            codes = dataset.read(1, window=window, out_shape=shape, resampling=Resampling.nearest)
        here = found[part]
        np.maximum(here, codes, out=here)
        used.append(layer)
    return found, used


def _window(
    own: MapGrid, grid: MapGrid, part: tuple[slice, slice]
) -> tuple[Window, tuple[int, int]]:
    """Window of a raster `own` that covers a part of `grid`, and the shape of that part."""
    rows, cols = part
    ratio = grid.cell_m / own.cell_m
    top = (own.north - grid.north) / own.cell_m + rows.start * ratio
    left = (grid.west - own.west) / own.cell_m + cols.start * ratio
    shape = (rows.stop - rows.start, cols.stop - cols.start)
    return Window(left, top, shape[1] * ratio, shape[0] * ratio), shape


def grid_around(place: tuple[float, float], reach_m: float, cell_m: float) -> MapGrid:
    """A square grid that extends by `reach_m` from a point to every side."""
    east, north = place
    box = (east - reach_m, north - reach_m, east + reach_m, north + reach_m)
    return MapGrid.covering(box, cell_m)


def polygons_of(
    codes: Classes, grid: MapGrid
) -> Iterator[tuple[list[list[tuple[float, float]]], int]]:
    """Polygons of connected cells with equal code above 0: rings rounded to 1 mm, and code."""
    place = Affine(grid.cell_m, 0.0, grid.west, 0.0, -grid.cell_m, grid.north)
    for geometry, code in rasterio.features.shapes(codes, mask=codes > 0, transform=place):
        rings = [[(round(x, 3), round(y, 3)) for x, y in ring] for ring in geometry["coordinates"]]
        yield rings, int(code)
