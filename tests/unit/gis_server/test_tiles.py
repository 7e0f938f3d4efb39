from concurrent.futures import ThreadPoolExecutor
from itertools import repeat

import numpy as np
import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.gis_server.rendering.png import indexed_png
from solmap.gis_server.rendering.reading import RasterPool, read_tile
from solmap.gis_server.rendering.styles import (
    indices_of,
    palette_of,
)
from solmap.gis_server.rendering.tiles import empty_tile, render_tile
from solmap.products.formats.raster.orthophoto import (
    source_colour,
    write_brightness_blocks,
    write_sources,
)
from solmap.products.formats.raster.styles import (
    TWILIGHT,
)
from solmap.products.formats.raster.tiling import CELL_SIZES, MAX_ZOOM, TileAddress, zoom_of
from solmap.products.model import ProductKind
from tests.support.decoded_answers import unpacked
from tests.support.tile_at import tile_at
from tests.unit.gis_server.conftest import (
    CELL_M,
    CRS,
    GRID,
    STOP,
    UNSEEN_WEST_OF_M,
    brightness,
    elevation_at,
    image_in,
    plane,
    ref_of,
)

OWN_ZOOM = zoom_of(CELL_M)


def centres_of(address):
    west, north = address.west_north
    offsets = (np.arange(256) + 0.5) * address.cell_m
    return (west + offsets)[None, :], (north - offsets)[:, None]


def tile_of(client, world, kind, address):
    ref = ref_of(world, kind)
    place = f"{ref.scope.name}/{kind}/{ref.digest}"
    return client.get(f"/tiles/{place}/{address.zoom}/{address.column}/{address.row}.png")


@pytest.mark.parametrize("zoom", range(OWN_ZOOM - 4, MAX_ZOOM + 1))
def test_a_pixel_shows_the_elevation_of_its_ground_at_every_zoom(world, zoom):
    address = tile_at(3.0, 4.0, zoom)
    with RasterPool().reading(world.store.path(ref_of(world, ProductKind.DTM))) as dataset:
        values = read_tile(dataset, address)
    east, north = centres_of(address)
    there = (
        (east > UNSEEN_WEST_OF_M + 2 * address.cell_m)
        & (east < GRID.bounds[2] - address.cell_m)
        & (abs(north) < GRID.bounds[3] - address.cell_m)
    )
    beyond = np.broadcast_to(east < GRID.bounds[0], values.shape)
    assert np.isnan(values[beyond]).all()
    # A pixel of a lower zoom is the mean over its ground, which on a plane is that of its centre;
    # one of a higher zoom repeats a cell, whose centre is at most half a cell away.
    off = 0.5 * CELL_M * 0.15 if address.cell_m < CELL_M else 1e-4
    np.testing.assert_allclose(
        values[there], np.broadcast_to(elevation_at(east, north), values.shape)[there], atol=off
    )


def test_a_tile_at_the_zoom_of_its_raster_is_a_block_as_it_was_written(world):
    address = tile_at(0.1, 0.1, OWN_ZOOM)
    with RasterPool().reading(world.store.path(ref_of(world, ProductKind.ORTHOPHOTO))) as dataset:
        tile, whole = read_tile(dataset, address), dataset.read(1)
    west, north = address.west_north
    col, row = round((west - GRID.west) / CELL_M), round((GRID.north - north) / CELL_M)
    np.testing.assert_array_equal(tile, whole[row : row + 256, col : col + 256])


def test_the_tile_is_coloured_by_the_legend(client, world):
    address = tile_at(10.0, 10.0, OWN_ZOOM)
    layer = next(
        layer
        for layer in client.get("/api/missions/MER2/layers").json()
        if layer["kind"] == "dtm" and layer["scope"] == STOP.name
    )
    shown = image_in(tile_of(client, world, ProductKind.DTM, address).content)
    east, north = centres_of(address)
    stops = layer["legend"]["stops"]
    values = [value for value, _ in stops]
    colours = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for _, c in stops])
    elevation = np.broadcast_to(elevation_at(east, north), (256, 256))
    expected = np.stack([np.interp(elevation, values, colours[:, i]) for i in range(3)], axis=-1)
    assert (shown[..., 3] == 255).all()
    # 254 steps between nine colours that are at most 120 apart, and rounding of the values.
    assert np.abs(shown[..., :3] - expected).max() <= 4


def test_hillshade_of_one_half_is_middle_grey_and_unseen_ground_is_transparent(client, world):
    address = tile_at(UNSEEN_WEST_OF_M, 0.1, OWN_ZOOM)
    shown = image_in(tile_of(client, world, ProductKind.HILLSHADE, address).content)
    east, _ = centres_of(address)
    seen = np.broadcast_to(east >= UNSEEN_WEST_OF_M, (256, 256))
    np.testing.assert_array_equal(shown[..., 3], np.where(seen, 255, 0))
    assert np.abs(shown[seen][:, :3].astype(int) - 127.5).max() <= 1.5


def test_the_orthophoto_gets_brighter_to_the_east_as_measured(client, world):
    address = tile_at(10.0, 10.0, OWN_ZOOM)
    shown = image_in(tile_of(client, world, ProductKind.ORTHOPHOTO, address).content)
    east, _ = centres_of(address)
    column = (east[0] - GRID.west) / CELL_M - 0.5
    expected = column / (GRID.cols - 1) * 255
    assert np.abs(shown[0, :, 0] - expected).max() < 1.5
    assert (shown[..., 0] == shown[..., 1]).all()


def test_directions_just_west_and_just_east_of_north_have_similar_colours():
    colours = palette_of(TWILIGHT)[indices_of(np.float32([[1.0, 359.0]]), 0.0, 360.0)]
    assert np.abs(np.diff(colours[0].astype(int), axis=0)).max() <= 4


def test_far_from_the_layer_there_is_one_transparent_tile(client, world):
    answer = tile_of(client, world, ProductKind.DTM, tile_at(5_000.0, 0.1, OWN_ZOOM))
    assert answer.status_code == 200
    assert answer.content == empty_tile()
    assert not image_in(answer.content)[..., 3].any()


def test_a_whole_map_of_four_kilometres_a_pixel_is_still_drawn(client, world):
    answer = tile_of(client, world, ProductKind.DTM, TileAddress(1, 1, 0))
    assert answer.status_code == 200
    assert image_in(answer.content).shape == (256, 256, 4)


def test_a_tile_is_cached_forever(client, world):
    answer = tile_of(client, world, ProductKind.SLOPE, tile_at(1.0, 1.0, OWN_ZOOM))
    assert answer.headers["content-type"] == "image/png"
    assert answer.headers["cache-control"] == "public, max-age=31536000, immutable"
    assert "content-encoding" not in answer.headers


@pytest.mark.parametrize("address", ["21/0/0", "3/8/0", "3/0/8", "-1/0/0", "a/0/0", "3/1e3/0"])
def test_a_url_outside_the_tile_matrix_set_is_refused(client, world, address):
    ref = ref_of(world, ProductKind.DTM)
    answer = client.get(f"/tiles/{ref.scope.name}/dtm/{ref.digest}/{address}.png")
    assert answer.status_code in (404, 422)


def test_an_indexed_png_is_decoded_as_encoded(rng):
    indices = rng.integers(0, 256, (7, 5), dtype=np.uint8)
    palette = rng.integers(0, 256, (256, 3), dtype=np.uint8)
    shown = image_in(indexed_png(indices, palette))
    np.testing.assert_array_equal(shown[..., 3], np.where(indices == 0, 0, 255))
    np.testing.assert_array_equal(shown[..., :3], palette[indices])


def test_exactly_the_measured_values_have_a_colour(rng):
    values = rng.normal(0.0, 100.0, 1000).astype(np.float32)
    values[::7] = np.nan
    indices = indices_of(values, -1.0, 1.0)
    np.testing.assert_array_equal(indices == 0, np.isnan(values))
    assert {int(i) for i in indices_of(np.float32([-1.0, 0.0, 1.0]), -1.0, 1.0)} == {1, 128, 255}


def test_the_pool_opens_a_raster_once_and_keeps_a_bounded_number(world):
    pool = RasterPool(idle=2)
    paths = [
        world.store.path(ref_of(world, kind))
        for kind in (ProductKind.DTM, ProductKind.SLOPE, ProductKind.ASPECT)
    ]
    with pool.reading(paths[0]) as first:
        pass
    with pool.reading(paths[0]) as again, pool.reading(paths[0]) as other:
        assert again is first
        assert other is not first
    for path in paths[1:]:
        with pool.reading(path):
            pass
    assert first.closed
    assert other.closed
    pool.close()


def test_cells_halve_from_zoom_to_zoom():
    assert CELL_SIZES[MAX_ZOOM] == 0.01
    np.testing.assert_allclose(np.divide(CELL_SIZES[:-1], CELL_SIZES[1:]), 2.0)


def test_many_threads_get_the_same_tiles_as_one(world):
    layer = world.catalogue.layer(STOP.name, ProductKind.DTM)
    addresses = [
        tile_at(east, north, zoom)
        for zoom in range(OWN_ZOOM - 2, OWN_ZOOM + 2)
        for east in (-20.0, 0.1, 20.0)
        for north in (-20.0, 0.1, 20.0)
    ]
    pool = RasterPool(idle=2)

    def drawn(address, pool):
        return unpacked(render_tile(layer, address, world.store, pool))

    alone = [drawn(address, RasterPool()) for address in addresses]
    with ThreadPoolExecutor(8) as threads:
        together = threads.map(drawn, addresses * 4, repeat(pool))
        assert list(together) == alone * 4
    assert len(set(alone)) > len(alone) / 2


NAMES = ("2N000000001", "2N000000002", "2P000000003")


def sources() -> np.ndarray:
    """The first image to the south, the second to the north, the third in a corner."""
    _, north = np.meshgrid(*GRID.centres())
    source = np.where(north < 0, 1, 2).astype(np.uint8)
    source[:256, -256:] = 3
    return np.where(np.isfinite(plane()), source, 0).astype(np.uint8)


@pytest.fixture
def pictured(own_world):
    """A world with sources and a colour orthophoto, red to the east and blue to the north."""
    own_world.publish_raster(
        ProductKind.SOURCES,
        STOP,
        lambda path: write_sources(path, GRID, sources(), NAMES, CRS),
    )
    bands = np.stack([brightness(), np.full(GRID.shape, 100.0, np.float32), brightness().T])
    own_world.publish_raster(
        ProductKind.COLOUR,
        STOP,
        lambda path: write_brightness_blocks(
            path, GRID, [(0, 0, bands)], CRS, stretches=[(0.0, 254.0)] * 3
        ),
    )
    with TestClient(create_app(own_world.root)) as opened:
        yield own_world, opened


def test_classes_have_the_colours_of_their_file_at_every_zoom(pictured):
    world, client = pictured
    allowed = {tuple(bytes.fromhex(source_colour(n)[1:])) for n in (1, 2, 3)}
    for zoom in (OWN_ZOOM - 2, OWN_ZOOM, OWN_ZOOM + 1):
        address = tile_at(10.0, 10.0, zoom)
        shown = image_in(tile_of(client, world, ProductKind.SOURCES, address).content)
        seen = shown[shown[..., 3] > 0]
        assert len(seen)
        assert {tuple(colour) for colour in seen[:, :3].tolist()} <= allowed


def test_identify_names_the_source_image_of_a_place(pictured):
    _, client = pictured
    for north, name in ((-3.0, NAMES[0]), (3.0, NAMES[1])):
        place = client.get("/api/missions/MER2/identify", params={"east": 7.0, "north": north})
        label = {layer["kind"]: layer["label"] for layer in place.json()["layers"]}
        assert label["sources"] == name
        assert label["dtm"] is None


def test_a_colour_image_is_shown_unchanged_and_transparent_where_unseen(pictured):
    world, client = pictured
    address = tile_at(UNSEEN_WEST_OF_M, 0.1, OWN_ZOOM)
    shown = image_in(tile_of(client, world, ProductKind.COLOUR, address).content)
    with RasterPool().reading(world.store.path(ref_of(world, ProductKind.COLOUR))) as dataset:
        bands = np.stack([read_tile(dataset, address, band) for band in (1, 2, 3)], axis=-1)
    np.testing.assert_array_equal(shown[..., :3], bands)
    np.testing.assert_array_equal(shown[..., 3] > 0, bands.any(axis=-1))
