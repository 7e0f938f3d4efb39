"""From a tile's address to its picture, or to its values."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import rasterio
from rasterio.enums import Resampling

from gis_server.rendering.deflate import gzip_stream
from gis_server.rendering.floats import encode_values
from gis_server.rendering.patches import read_patch, read_tile
from gis_server.rendering.png import colour_png, indexed_png
from gis_server.rendering.readers import RasterPool
from gis_server.rendering.styles import PALETTES, STYLES, Style, indices_of, range_of, style_of
from photogrammetry.terrain.grid import BLOCK
from products.errors import ProductNotFoundError
from products.model import Layer, ProductKind
from products.raster import band_names
from products.store import ProductStore
from products.tiling import TileAddress

ELEVATIONS = (ProductKind.DTM, ProductKind.FAR_DTM, ProductKind.REGION_DTM)
_NOT_AVERAGED = {ProductKind.ASPECT, ProductKind.REGION_ASPECT} | {
    kind for kind, style in STYLES.items() if style.is_classes
}
_SHADES = 256
"""A gradient is felt to this part of 1: what a shade of grey shows."""
_COLOURS = 4096
"""Steps that a stretch of a layer's range is good for."""


def render_tile(layer: Layer, address: TileAddress, store: ProductStore, pool: RasterPool) -> bytes:
    """The PNG of a tile; transparent where nothing was measured.

    Raises:
        ProductNotFoundError: the layer has no tiles.
    """
    style = style_of(layer.ref.kind)
    if not overlap(layer.bounds, address.bounds):
        return empty_tile()
    with pool.reading(store.path(layer.ref)) as dataset:
        if style.is_colour:
            bands = [read_tile(dataset, address, band) for band in (1, 2, 3)]
            return _colour_png(bands)
        values = read_tile(dataset, address, style.band, _averaging(layer.ref.kind))
        palette = _own_palette(dataset) if style.is_classes else PALETTES[layer.ref.kind]
    if values is None:
        return empty_tile()
    indices = indices_of(values, *range_of(style, layer))
    return indexed_png(indices, palette) if indices.any() else empty_tile()


def _averaging(kind: ProductKind) -> Resampling:
    """How cells become larger pixels: directions run in a circle and classes have no mean."""
    return Resampling.nearest if kind in _NOT_AVERAGED else Resampling.average


def _own_palette(dataset: rasterio.DatasetReader) -> np.ndarray:
    """The colours that a file of classes gives them: 256 rows of red, green and blue."""
    colours = dataset.colormap(1)
    return np.array([colours[index][:3] for index in range(256)], np.uint8)


def _colour_png(bands: Sequence[np.ndarray | None]) -> bytes:
    """Red, green and blue as a picture; transparent where all are 0."""
    known = [band for band in bands if band is not None]
    if len(known) < len(bands) or not any(band.any() for band in known):
        return empty_tile()
    return colour_png(np.stack(known, axis=-1))


@lru_cache(maxsize=1)
def empty_tile() -> bytes:
    """A transparent tile."""
    return indexed_png(np.zeros((BLOCK, BLOCK), np.uint8), np.zeros((256, 3), np.uint8))


def overlap(
    one: tuple[float, float, float, float], other: tuple[float, float, float, float]
) -> bool:
    """Whether two (west, south, east, north) share any ground."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def render_values(
    layer: Layer, address: TileAddress, store: ProductStore, pool: RasterPool, band: str = ""
) -> bytes | None:
    """The values of a tile and of the pixels around it, compressed with gzip; None where none are.

    Args:
        layer: A raster of 32-bit floats.
        address: The tile.
        store: Where the layer's file is.
        pool: Open rasters.
        band: Name of the band; the first by default.

    Raises:
        ProductNotFoundError: the layer has no such values.
    """
    style = style_of(layer.ref.kind)
    if not overlap(layer.bounds, address.bounds):
        return None
    with pool.reading(store.path(layer.ref)) as dataset:
        index = _band_of(layer, dataset, band)
        patch = read_patch(dataset, address, index, _averaging(layer.ref.kind), border=1)
    if patch is None:
        return None
    values = patch.tile(patch.values)
    if not np.isfinite(values).any():
        return None
    finest = _finest(layer, style, patch.cell_m) if index == 1 else 0.0
    return gzip_stream(encode_values(values, finest))


def _finest(layer: Layer, style: Style, cell_m: float) -> float:
    """The step that values need: elevations for their gradient, others for their colour."""
    if layer.ref.kind in ELEVATIONS:
        return cell_m / _SHADES
    low, high = range_of(style, layer)
    return (high - low) / _COLOURS


def _band_of(layer: Layer, dataset: rasterio.DatasetReader, name: str) -> int:
    """The number of a band of floats."""
    names = band_names(dataset)
    if dataset.dtypes[0] != "float32":
        raise ProductNotFoundError(f"{layer.id} is a picture: ask for its tiles as .png")
    if name and name not in names:
        raise ProductNotFoundError(f"{layer.id} has no band {name}; it has {', '.join(names)}")
    return names.index(name) + 1 if name else 1
