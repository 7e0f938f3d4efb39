"""From a tile's address and a style to its image, or to its values.

Tiles of values are for shading in the browser: sun, slope, thresholds and colours without a
server. A body has 16 bits a value, steps of a power of two from an offset; all numbers are
little-endian:

    bytes  0-3     SMV1
    bytes  4-5     columns, unsigned: 258
    bytes  6-7     rows, unsigned: 258
    bytes  8-15    offset, 64-bit float
    bytes 16-23    step, 64-bit float
    then           rows x columns low bytes, then rows x columns high bytes, row by row

The byte pair at (row, column) is the difference, modulo 65536, to the value left of it; left of
the first column is 0. With k the running sum of a row,

    value = offset + step k        for k = 1 .. 65535, not measured for k = 0

so that a browser needs no decoder: HTTP's own gzip undoes the compression. The first and last row
and column are those of the neighbouring tiles: shading that depends on neighbours is right up to
the edge. Steps are as fine as the tile's range allows, and no finer than requested; offset and
values are whole steps, so that what neighbours share is equal where their steps are.

Float32 with 24 bits would take twice the room and, rounded to 1/256 of a cell, show the same.
"""

from __future__ import annotations

import math
import struct
from functools import lru_cache

import numpy as np

from solmap.gis_server.rendering.painting import (
    PNG,
    Canvas,
    ImageFormat,
    averaging,
    band_index,
    painter_of,
)
from solmap.gis_server.rendering.png import gzip_stream, indexed_png
from solmap.gis_server.rendering.reading import RasterPool, read_patch
from solmap.gis_server.rendering.styles import (
    ELEVATIONS,
    IMAGERY,
    StyleQuery,
    resolve_style,
)
from solmap.photogrammetry.terrain.dtm.grid import BLOCK
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.raster.styles import (
    TileStyle,
    range_of,
)
from solmap.products.formats.raster.tiling import TileAddress
from solmap.products.model import Layer
from solmap.products.store.product_store import ProductStore

MEDIA_TYPE = "application/vnd.solmap.values"
_HEADER = struct.Struct("<4sHHdd")
_MAGIC = b"SMV1"
_STEPS = 65534
"""Number of steps from k = 1 to k = 65535."""
_COARSEST_EXPONENT, _FINEST_EXPONENT = 100, -40
PLAIN = StyleQuery()
"""Every layer as it is shown by default."""
_SHADES = 256
"""Resolution of a gradient: one shade of grey."""
_COLOURS = 4096
"""Number of steps that a stretched range of a layer needs."""


def encode_values(values: np.ndarray, finest: float) -> bytes:
    """The body of a tile of values.

    Args:
        values: float32, rows by columns; NaN where nothing was measured.
        finest: The step need not be finer than this.
    """
    measured = np.isfinite(values)
    known = values[measured].astype(np.float64)
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = _step(high - low, finest)
    first = math.floor(low / step) - 1
    steps = np.zeros(values.shape, np.uint16)
    steps[measured] = np.rint(known / step) - first
    return _HEADER.pack(_MAGIC, *values.shape[::-1], first * step, step) + _planes(steps)


def _planes(steps: np.ndarray) -> bytes:
    """Differences along the rows: all low bytes, then all high bytes."""
    change = steps.copy()
    change[:, 1:] -= steps[:, :-1]  # modulo 65536
    return np.ascontiguousarray(change.astype("<u2").view(np.uint8).reshape(-1, 2).T).tobytes()


def _step(extent: float, finest: float) -> float:
    """The finest power of two that is not finer than `finest` and has `extent` in its range."""
    requested = math.floor(math.log2(finest)) if finest > 0 else _FINEST_EXPONENT
    needed = math.ceil(math.log2(extent / (_STEPS - 2))) if extent > 0 else _FINEST_EXPONENT
    exponent = max(requested, needed, _FINEST_EXPONENT)
    return math.ldexp(1.0, min(exponent, _COARSEST_EXPONENT))


def render_tile(
    layer: Layer,
    address: TileAddress,
    store: ProductStore,
    pool: RasterPool,
    query: StyleQuery = PLAIN,
) -> bytes:
    """The PNG of a tile; transparent where nothing was measured. Raises as `draw_tile` does."""
    return draw_tile(layer, address, store, pool, query, PNG) or empty_tile()


def draw_tile(
    layer: Layer,
    address: TileAddress,
    store: ProductStore,
    pool: RasterPool,
    query: StyleQuery,
    form: ImageFormat,
) -> bytes | None:
    """The image of a tile; None where nothing was measured.

    Raises:
        ProductNotFoundError: the layer has no tiles.
        UnknownStyleError: it cannot be shown like that.
    """
    style = resolve_style(layer, query)
    paint = painter_of(layer, query, style)
    if not overlap(layer.bounds, address.bounds):
        return None
    with pool.reading(store.address(layer.ref)) as dataset:
        return paint(Canvas(layer, address, query, style, dataset, form))


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
    style = resolve_style(layer, PLAIN)
    if layer.ref.kind in IMAGERY:
        raise ProductNotFoundError(f"{layer.id} has images only: request its tiles as .png")
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


def _finest(layer: Layer, style: TileStyle, cell_m: float) -> float:
    """The required step: of elevations for their gradient, of others for their colour."""
    if layer.ref.kind in ELEVATIONS:
        return cell_m / _SHADES
    low, high = range_of(style, layer)
    return (high - low) / _COLOURS
