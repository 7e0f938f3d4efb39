"""The terrain models of a mission as one ground that can be asked at any place.

Models are read in windows around the places asked for. Where places lie far apart the windows are
cut, so that a long line never reads the whole of a large model.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import rasterio
from rasterio.windows import Window

from solmap.gis_server.analysis.refusal import RefusedError
from solmap.gis_server.rendering.readers import RasterPool
from solmap.photogrammetry.arrays import Flags
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.resampling import (
    NOWHERE,
    GroundSamples,
    MapPoints,
    bilinear,
    finest,
)
from solmap.products.formats.raster.raster import band_names, grid_of
from solmap.products.model import Layer, ProductKind
from solmap.products.store.product_store import ProductStore

MODELS = (ProductKind.DTM, ProductKind.REGION_DTM, ProductKind.FAR_DTM)
"""Kinds of terrain models, in metres above the tangent plane."""
BEST = "best"
"""Stands for the finest measured model at every place."""
_WINDOW = 1 << 20
"""Cells of a window that is read at once, 4 MB a band."""
_BANDS = ("elevation", "standard_deviation", "pose_deviation")


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Terrain models that are asked together; the finest answers."""

    models: tuple[Layer, ...]
    store: ProductStore
    pool: RasterPool

    @classmethod
    def of(
        cls, layers: Iterable[Layer], asked: str, store: ProductStore, pool: RasterPool
    ) -> Ground:
        """The models that are asked for: one by the layer's id, or all as `best`.

        Raises:
            RefusedError: no layer of that id is a terrain model.
        """
        models = [layer for layer in layers if layer.ref.kind in MODELS]
        chosen = [layer for layer in models if asked in (BEST, layer.id)]
        if not chosen:
            names = ", ".join(layer.id for layer in models[:5]) or "none"
            raise RefusedError(
                f"{asked} is no terrain model of this mission; there are {names}; "
                f"'{BEST}' takes the finest at every place"
            )
        return cls(tuple(chosen), store, pool)

    @property
    def finest_cell_m(self) -> float:
        """The smallest cell of all models."""
        return min(cell_of(layer) for layer in self.models)

    def at(self, places: MapPoints) -> GroundSamples:
        """The ground at places; `source` numbers the models."""
        found = [GroundSamples.none(len(places))]
        cells = [math.inf]
        for number, layer in enumerate(self.models):
            west, south, east, north = layer.bounds
            inside = (places[:, 0] >= west) & (places[:, 0] <= east)
            inside &= (places[:, 1] >= south) & (places[:, 1] <= north)
            if inside.any():
                found.append(self._asked(layer, number, places, inside))
                cells.append(cell_of(layer))
        return finest(list(zip(cells, found, strict=True)))

    def elevation(self, places: MapPoints) -> np.ndarray:
        """Elevations alone, metres."""
        return self.at(places).elevation

    def _asked(self, layer: Layer, number: int, places: MapPoints, inside: Flags) -> GroundSamples:
        values = np.full((len(_BANDS), len(places)), np.nan)
        with self.pool.reading(self.store.address(layer.ref)) as dataset:
            values[:, inside] = sampled(dataset, _BANDS, places[inside])
        known = np.isfinite(values[0])
        return GroundSamples(
            values[0],
            values[1],
            np.where(known, np.nan_to_num(values[2]), np.nan),
            np.where(known, number, NOWHERE).astype(np.int32),
        )


def cell_of(layer: Layer) -> float:
    """The cell of a raster layer, metres."""
    return layer.cell_m or math.inf


def sampled(dataset: rasterio.DatasetReader, bands: Sequence[str], places: MapPoints) -> np.ndarray:
    """Bands of an open raster between cell centres, one row a band; NaN for bands it lacks."""
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
    """Values at places, window by window; a window too large is cut between its places."""
    window = _around(grid, places)
    if window.width * window.height > _WINDOW and len(places) > 1:
        order = np.argsort(places[:, 0] if window.width > window.height else places[:, 1])
        values = np.empty((len(indexes), len(places)))
        for half in np.array_split(order, 2):
            values[:, half] = _read(dataset, grid, indexes, places[half])
        return values
    stack = dataset.read(indexes, window=window)
    part = grid.part(window.row_off, window.col_off, window.height, window.width)
    return np.stack([bilinear(band, part, places) for band in stack])


def _around(grid: MapGrid, places: MapPoints) -> Window:
    """The cells around places, within the grid."""
    col = (places[:, 0] - grid.west) / grid.cell_m
    row = (grid.north - places[:, 1]) / grid.cell_m
    left, top = (max(0, math.floor(float(at.min())) - 1) for at in (col, row))
    right = min(grid.cols, math.floor(float(col.max())) + 2)
    bottom = min(grid.rows, math.floor(float(row.max())) + 2)
    left, top = min(left, grid.cols - 1), min(top, grid.rows - 1)
    return Window(left, top, max(1, right - left), max(1, bottom - top))
