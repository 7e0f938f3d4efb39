"""CPU of a map tile: ours beside rio-tiler's reader and encoder on the same files in the same run.

rio-tiler is what TiTiler serves tiles with: it opens the file, reads the tile through the tile
matrix set of the site, colours it and encodes it, as it does here. Ours keeps the file open. Both
get the same random tiles of a product 50 m wide.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import cv2
import morecantile
import numpy as np
import pytest
from rio_tiler.colormap import cmap
from rio_tiler.io import Reader

from gis_server.rendering.readers import RasterPool
from gis_server.rendering.tiles import render_tile
from photogrammetry.terrain.grid import BLOCK, MapGrid
from products.crs import LandingPoint, local_crs
from products.model import Layer, ProductKind, Recipe, Scope, ScopeLevel
from products.pictures import write_orthophoto
from products.raster import summarise, write_raster
from products.store import ProductStore
from products.tiling import TileAddress, tile_matrix_set, zoom_of

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
CELL_M = 0.02
GRID = MapGrid.covering((-25.0, -25.0, 25.0, 25.0), CELL_M)
KINDS = (ProductKind.ORTHOPHOTO, ProductKind.DTM, ProductKind.HILLSHADE)
TILES = 32


@dataclass(frozen=True)
class Served:
    store: ProductStore
    layers: dict[ProductKind, Layer]
    addresses: list[TileAddress]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Served:
    store = ProductStore.open(tmp_path_factory.mktemp("tiles"))
    rng = np.random.default_rng(7)
    shape = GRID.shape
    rough = sum(
        cv2.resize(
            rng.normal(0.0, cells / 2000, (shape[0] // cells, shape[1] // cells)).astype(
                np.float32
            ),
            shape[::-1],
            interpolation=cv2.INTER_CUBIC,
        )
        for cells in (512, 64, 8)
    )
    shade = np.clip(0.7 - np.gradient(rough, CELL_M, axis=1), 0.0, 1.0).astype(np.float32)
    grey = (100.0 * shade + rng.normal(0.0, 4.0, shape)).astype(np.float32)
    fields = {
        ProductKind.ORTHOPHOTO: grey,
        ProductKind.DTM: rough.astype(np.float32),
        ProductKind.HILLSHADE: shade,
    }
    layers = {kind: _layer(store, kind, field) for kind, field in fields.items()}
    own = zoom_of(CELL_M)
    addresses = [
        TileAddress.holding(*rng.uniform(-24.0, 24.0, 2), zoom)
        for zoom in itertools.islice(itertools.cycle(range(own - 3, own + 1)), TILES)
    ]
    return Served(store, layers, addresses)


def _layer(store: ProductStore, kind: ProductKind, field: np.ndarray) -> Layer:
    def write(path: Path) -> None:
        if kind == ProductKind.ORTHOPHOTO:
            write_orthophoto(path, GRID, field, local_crs(LANDING))
        else:
            write_raster(path, GRID, {str(kind): field}, local_crs(LANDING))

    ref = store.make(Recipe(kind, Scope(ScopeLevel.REGION, "mer2")), write)
    band = summarise(store.path(ref))[1][0]
    return Layer(
        ref, "MER2", str(kind), "raster", GRID.bounds, CELL_M, "m", band.range, (), "2026-01-01"
    )


@pytest.mark.parametrize("kind", KINDS)
def test_our_tiles(benchmark, served, kind):
    benchmark.group = f"{TILES} tiles of {kind}"
    pool = RasterPool()
    layer = served.layers[kind]

    def draw() -> int:
        return sum(
            len(render_tile(layer, address, served.store, pool)) for address in served.addresses
        )

    size = benchmark.pedantic(draw, rounds=5, warmup_rounds=1)
    _note(benchmark, size)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", KINDS)
def test_tiles_of_rio_tiler(benchmark, served, kind):
    benchmark.group = f"{TILES} tiles of {kind}"
    layer = served.layers[kind]
    path, tiles = str(served.store.path(layer.ref)), tile_matrix_set(LANDING)
    low, high = layer.range or (0.0, 1.0)
    colours = cmap.get("viridis") if kind == ProductKind.DTM else None

    def draw_one(address: TileAddress) -> int:
        with Reader(path, tms=tiles) as reader:
            tile = morecantile.Tile(x=address.column, y=address.row, z=address.zoom)
            image = reader.tile(*tile, tilesize=BLOCK)
        if kind != ProductKind.ORTHOPHOTO:
            image.rescale(in_range=((low, high),))
        return len(image.render(img_format="PNG", colormap=colours))

    size = benchmark.pedantic(
        lambda: sum(map(draw_one, served.addresses)), rounds=5, warmup_rounds=1
    )
    _note(benchmark, size)


def _note(benchmark, size: int) -> None:
    if benchmark.stats is None:  # --benchmark-disable
        return
    benchmark.extra_info["tiles/s"] = round(TILES / benchmark.stats["median"])
    benchmark.extra_info["ms/tile"] = round(1e3 * benchmark.stats["median"] / TILES, 2)
    benchmark.extra_info["kB/tile"] = round(size / TILES / 1e3, 1)
