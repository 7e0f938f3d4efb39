"""From a tile's address and a look to its picture, or to its values."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solmap.gis_server.rendering.deflate import gzip_stream
from solmap.gis_server.rendering.floats import encode_values
from solmap.gis_server.rendering.looks import Look, style_for
from solmap.gis_server.rendering.painting import Canvas, averaging, band_index, painter_of
from solmap.gis_server.rendering.patches import read_patch
from solmap.gis_server.rendering.png import indexed_png
from solmap.gis_server.rendering.readers import RasterPool
from solmap.gis_server.rendering.styles import ELEVATIONS, PICTURES, Style, range_of
from solmap.photogrammetry.terrain.dtm.grid import BLOCK
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.tiling import TileAddress
from solmap.products.model import Layer
from solmap.products.store.product_store import ProductStore

PLAIN = Look()
"""Every layer as it is shown by default."""
_SHADES = 256
"""A gradient is felt to this part of 1: what a shade of grey shows."""
_COLOURS = 4096
"""Steps that a stretch of a layer's range is good for."""


def render_tile(
    layer: Layer, address: TileAddress, store: ProductStore, pool: RasterPool, look: Look = PLAIN
) -> bytes:
    """The PNG of a tile; transparent where nothing was measured.

    Raises:
        ProductNotFoundError: the layer has no tiles.
        UnknownLookError: it cannot be shown like that.
    """
    style = style_for(layer, look)
    paint = painter_of(layer, look, style)
    if not overlap(layer.bounds, address.bounds):
        return empty_tile()
    with pool.reading(store.address(layer.ref)) as dataset:
        return paint(Canvas(layer, address, look, style, dataset)) or empty_tile()


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
    style = style_for(layer, PLAIN)
    if layer.ref.kind in PICTURES:
        raise ProductNotFoundError(f"{layer.id} is a picture: ask for its tiles as .png")
    if not overlap(layer.bounds, address.bounds):
        return None
    with pool.reading(store.address(layer.ref)) as dataset:
        index = band_index(layer, dataset, band)
        patch = read_patch(dataset, address, index, averaging(layer.ref.kind), border=1)
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
