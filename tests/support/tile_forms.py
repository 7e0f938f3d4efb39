"""Bytes and processor time of tiles as PNG and WebP: `python -m tests.support.tile_forms STORE`.

Of every raster kind of the merged map, or of all layers where there is none: tiles two zooms below
the layer's own, drawn once before. Times are of drawing and encoding, on one thread.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

from solmap.gis_server.rendering.painting import PNG, WEBP, ImageFormat
from solmap.gis_server.rendering.styles import StyleQuery
from solmap.gis_server.rendering.tiles import draw_tile
from solmap.gis_server.services import Services, open_services
from solmap.products.formats.raster.styles import STYLES
from solmap.products.formats.raster.tiling import CELL_SIZES, EXTENT, TileAddress, zoom_of
from solmap.products.model import Layer, ScopeLevel

ZOOMS_OUT, ROUNDS = 2, 3


def tiles_of(layer: Layer) -> Iterator[TileAddress]:
    """The tiles that hold a layer."""
    zoom = max(zoom_of(layer.cell_m or CELL_SIZES[0]) - ZOOMS_OUT, 0)
    side = CELL_SIZES[zoom] * 256
    west, south, east, north = layer.bounds
    columns = range(int((west - EXTENT[0]) // side), int((east - EXTENT[0]) // side) + 1)
    rows = range(int((EXTENT[3] - north) // side), int((EXTENT[3] - south) // side) + 1)
    return (TileAddress(zoom, column, row) for column in columns for row in rows)


def measure(services: Services, layer: Layer, form: ImageFormat) -> tuple[list[int], float]:
    """Bytes of every tile, 0 where nothing was measured, and milliseconds of processor a tile."""
    tiles = list(tiles_of(layer))

    def draw() -> list[int]:
        store, pool, query = services.store, services.pool, StyleQuery()
        drawn = (draw_tile(layer, one, store, pool, query, form) for one in tiles)
        return [len(body or b"") for body in drawn]

    draw()
    started = time.process_time()
    for _ in range(ROUNDS):
        sizes = draw()
    return sizes, 1000 * (time.process_time() - started) / ROUNDS / len(tiles)


def _report(store: Path) -> None:
    services = open_services(store)
    rasters = [one for one in services.catalogue.layers() if one.ref.kind in STYLES and one.cell_m]
    merged = [one for one in rasters if one.ref.scope.level is ScopeLevel.REGION]
    sys.stdout.write("| kind | tiles | empty | PNG, B | ms | WebP, B | ms |\n|---|" + "---|" * 6)
    for layer in merged or rasters:
        (png, png_ms), (webp, webp_ms) = (measure(services, layer, form) for form in (PNG, WEBP))
        seen = max(sum(map(bool, png)), 1)
        sys.stdout.write(
            f"\n| {layer.ref.kind} | {len(png)} | {len(png) - seen} | {sum(png) / seen:.0f} | "
            f"{png_ms:.2f} | {sum(webp) / seen:.0f} | {webp_ms:.2f} |"
        )
    sys.stdout.write("\n")


if __name__ == "__main__":
    _report(Path(sys.argv[1]))
