"""Styles of tiles: what is computed of a terrain model, colours, limits, and what is refused."""

import itertools

import cv2
import numpy as np
import pytest

from solmap.gis_server.rendering.painting import OF_TERRAIN
from solmap.gis_server.rendering.reading import RasterPool
from solmap.gis_server.rendering.styles import (
    StyleQuery,
    indices_of,
    legend_of,
    palette_of,
    styles_of,
)
from solmap.gis_server.rendering.tiles import render_tile
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.relief.slope import (
    HillshadeParams,
    SlopeParams,
    aspect_of,
    hillshade,
    northerly_tilt_of,
    relief,
    slope_of,
)
from solmap.products.formats.raster.raster import write_dtm
from solmap.products.formats.raster.styles import (
    RED_BLUE,
    STYLES,
    VIRIDIS,
)
from solmap.products.formats.raster.tiling import TileAddress, zoom_of
from solmap.products.model import ProductKind
from tests.support.decoded_answers import unpacked
from tests.support.tile_at import tile_at
from tests.unit.gis_server.conftest import CELL_M, CRS, GRID, STOP, build

OWN_ZOOM = zoom_of(CELL_M)
INSIDE = tile_at(5.0, 5.0, OWN_ZOOM)
PLANE = (0.1, 0.05)
"""Gradient of the small world's ground."""


def hills() -> Dtm:
    rng = np.random.default_rng(3)
    coarse = rng.normal(0.0, 1.0, (GRID.rows // 16, GRID.cols // 16)).astype(np.float32)
    surface = cv2.resize(coarse, GRID.shape[::-1], interpolation=cv2.INTER_CUBIC)
    surface[rng.random(GRID.shape) < 0.02] = np.nan
    seen = np.isfinite(surface)
    zero = np.zeros(GRID.shape, np.float32)
    return Dtm(
        GRID, surface, np.where(seen, 0.02, np.nan).astype(np.float32), zero, seen.astype(np.uint8)
    )


@pytest.fixture(scope="module")
def hilly(tmp_path_factory):
    world = build(tmp_path_factory.mktemp("hills"))
    world.publish_raster(
        ProductKind.DTM, STOP, lambda path: write_dtm(path, hills(), CRS), version=1
    )
    return world


@pytest.fixture
def terrain(hilly):
    return hilly.catalogue.layer(STOP.name, ProductKind.DTM)


def drawn(world, layer, address, look) -> np.ndarray:
    body = render_tile(layer, address, world.store, RasterPool(), look)
    image = cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)
    return image[:, :, [2, 1, 0, 3]]


def block_of(whole: np.ndarray, address: TileAddress) -> np.ndarray:
    west, north = address.west_north
    row, col = round((GRID.north - north) / CELL_M), round((west - GRID.west) / CELL_M)
    return whole[row : row + 256, col : col + 256]


OF_WHOLE_MODEL = {
    "hillshade": lambda dtm: hillshade(
        dtm.elevation, dtm.grid.cell_m, HillshadeParams(200.0, 30.0)
    ),
    "slope": lambda dtm: slope_of(relief(dtm, SlopeParams(3 * CELL_M)).normal),
    "aspect": lambda dtm: aspect_of(relief(dtm, SlopeParams(3 * CELL_M)).normal),
    "northerly-tilt": lambda dtm: northerly_tilt_of(relief(dtm, SlopeParams(3 * CELL_M)).normal),
}


@pytest.mark.parametrize("style", OF_WHOLE_MODEL)
def test_a_tile_equals_the_same_computation_on_the_whole_model(hilly, terrain, style):
    """Also in the outermost pixels: tiles include cells of their neighbours."""
    look = StyleQuery(style=style, azimuth=200.0, elevation=30.0)
    expected = block_of(OF_WHOLE_MODEL[style](hills()), INSIDE)
    chosen = styles_of(ProductKind.DTM)[style]
    indices = indices_of(expected, *chosen.range)
    shown = drawn(hilly, terrain, INSIDE, look)
    np.testing.assert_array_equal(shown[..., 3] > 0, indices > 0)
    # Rounding of single precision may take a value to the next of 255 colours, not farther.
    index = indices.astype(int)
    palette = palette_of(chosen.colours).astype(int)
    steps = [
        np.abs(shown[..., :3] - palette[np.clip(index + d, 1, 255)]).max(axis=-1)
        for d in (-1, 0, 1)
    ]
    off = np.where(indices > 0, np.min(steps, axis=0), 0)
    if style == "aspect":  # at north the palette's two ends meet
        off[(expected < 2) | (expected > 358)] = 0
    assert off.max() == 0


def test_a_baseline_has_the_effect_it_has_on_precomputed_layers(hilly, terrain):
    expected = block_of(slope_of(relief(hills(), SlopeParams(1.1)).normal), INSIDE)
    shown = drawn(
        hilly,
        terrain,
        INSIDE,
        StyleQuery(style="slope", colours="grey", low=0.0, high=60.0, baseline=1.1),
    )
    known = np.isfinite(expected)
    np.testing.assert_array_equal(shown[..., 3] > 0, known)
    grey = np.clip(expected / 60.0, 0.0, 1.0)[known] * 255
    assert np.abs(shown[known][:, 0] - grey).max() < 1.6


@pytest.mark.parametrize("style", [*OF_TERRAIN, "shaded-relief", "contours"])
@pytest.mark.parametrize("zoom", [OWN_ZOOM - 1, OWN_ZOOM, OWN_ZOOM + 1])
def test_tiles_meet_without_a_seam(hilly, terrain, style, zoom):
    """Two tiles side by side show what one drawn across their edge would show."""
    look = StyleQuery(style=style)
    west = tile_at(-0.1, -0.1, zoom)
    east = TileAddress(zoom, west.column + 1, west.row)
    both = np.hstack([drawn(hilly, terrain, at, look) for at in (west, east)])
    shifted = _drawn_at(hilly, terrain, west, look)
    off = np.abs(both[:, 128:384].astype(int) - shifted)
    assert off.max() <= 4  # a step of a ramp: tiles round differently in the last bit
    assert (off > 0).mean() < 1e-4


def _drawn_at(world, layer, west, look):
    """The tile between two, drawn from a raster whose own blocks begin half a tile later."""

    class Between(TileAddress):
        @property
        def west_north(self):
            left, north = TileAddress.west_north.fget(self)
            return left + 128 * self.cell_m, north

    return drawn(world, layer, Between(west.zoom, west.column, west.row), look)


@pytest.mark.parametrize("zoom", range(OWN_ZOOM - 4, OWN_ZOOM + 3))
def test_a_plane_has_the_same_shade_at_every_zoom(world, zoom):
    """A hillshade that took the cell of the raster for that of the tile would darken or fade."""
    layer = world.catalogue.layer(STOP.name, ProductKind.DTM)
    shown = drawn(world, layer, tile_at(5.0, 5.0, zoom), StyleQuery(style="hillshade"))
    seen = shown[shown[..., 3] > 0][:, 0]
    g_e, g_n = PLANE
    sine = np.sin(np.radians(45.0))
    light = (sine + sine * sine * (g_e - g_n)) / np.sqrt(1 + g_e**2 + g_n**2)
    assert len(seen) > 100
    assert np.median(seen) == pytest.approx(255 * light, abs=1.0)
    # At the edge of the unseen a plane is fitted to what is known, and is the same.
    assert np.abs(seen - 255 * light).max() < 2.0


def test_the_sun_follows_its_azimuth(hilly, terrain):
    looks = [StyleQuery(style="hillshade", azimuth=a, exaggeration=0.2) for a in (0, 90, 180)]
    suns = [drawn(hilly, terrain, INSIDE, look) for look in looks]
    for one, other in itertools.combinations(suns, 2):
        assert np.abs(one.astype(int) - other).max() > 50
    north, _, south = (sun[..., 0][sun[..., 3] > 0].astype(float) for sun in suns)
    assert np.corrcoef(north, south)[0, 1] < -0.9


def test_a_sun_overhead_shades_by_slope_alone_and_exaggeration_darkens(hilly, terrain):
    overhead = drawn(hilly, terrain, INSIDE, StyleQuery(style="hillshade", elevation=90.0))
    steeper = drawn(
        hilly, terrain, INSIDE, StyleQuery(style="hillshade", elevation=90.0, exaggeration=2.0)
    )
    seen = overhead[..., 3] > 0
    expected = np.cos(np.radians(block_of(OF_WHOLE_MODEL["slope"](hills()), INSIDE)))
    assert np.abs(overhead[..., 0] - 255 * expected)[seen].max() < 1.6
    assert (steeper[..., 0] <= overhead[..., 0])[seen].all()


@pytest.mark.parametrize("threshold", [-90.0, 0.0, 5.0, 20.0])
def test_north_facing_ground_leans_north_by_at_least_the_threshold(hilly, terrain, threshold):
    tilt = block_of(OF_WHOLE_MODEL["northerly-tilt"](hills()), INSIDE)
    shown = drawn(hilly, terrain, INSIDE, StyleQuery(style="north-facing", threshold=threshold))
    clear = np.abs(tilt - threshold) > 1e-3
    np.testing.assert_array_equal((shown[..., 3] > 0)[clear], (tilt >= threshold)[clear])


def test_north_facing_ground_of_the_tilt_layer_has_its_threshold_too(world):
    layer = world.catalogue.layer(STOP.name, ProductKind.NORTHERLY_TILT)  # -5 degrees everywhere
    for threshold, is_seen in ((-10.0, True), (0.0, False)):
        shown = drawn(world, layer, INSIDE, StyleQuery(style="north-facing", threshold=threshold))
        assert (shown[..., 3] > 0).all() == is_seen
    assert (shown[..., 3] == 0).all()


def test_uncertainty_shows_the_standard_deviation(world):
    layer = world.catalogue.layer(STOP.name, ProductKind.DTM)
    shown = drawn(
        world, layer, INSIDE, StyleQuery(style="uncertainty", colours="grey", low=0.0, high=0.04)
    )
    assert np.abs(shown[..., 0].astype(int) - 128).max() <= 1  # 0.02 m everywhere


def test_shaded_level_ground_keeps_its_colour(own_world):
    level = Dtm(
        GRID,
        np.full(GRID.shape, 3.0, np.float32),
        *(np.full(GRID.shape, value, np.float32) for value in (0.02, 1.0)),
        np.ones(GRID.shape, np.uint8),
    )
    layer = own_world.publish_raster(
        ProductKind.DTM, STOP, lambda path: write_dtm(path, level, CRS), version=2
    )
    look = StyleQuery(style="shaded-relief", low=0.0, high=6.0)
    shown = drawn(own_world, layer, INSIDE, look)
    np.testing.assert_allclose(
        shown[..., :3].reshape(-1, 3) - palette_of(VIRIDIS)[128].astype(int), 0, atol=1
    )


def test_contours_are_where_the_ground_has_their_elevation(world):
    """On a plane of 1 in 10 to the east contours of 1 m are lines 8.9 m apart."""
    layer = world.catalogue.layer(STOP.name, ProductKind.DTM)
    address = tile_at(5.0, 5.0, OWN_ZOOM)
    shown = drawn(world, layer, address, StyleQuery(style="contours", interval=1.0))
    west, north = address.west_north
    at = (np.arange(256) + 0.5) * CELL_M
    east, north = np.meshgrid(west + at, north - at)
    height = 5.0 + 0.1 * east + 0.05 * north
    away_m = np.abs(height - np.rint(height)) / np.hypot(*PLANE)
    is_index = np.rint(height) % 5 == 0
    width = np.where(is_index, 2.0, 1.0)
    expected = np.clip(width / 2 + 0.5 - away_m / CELL_M, 0.0, 1.0)
    assert (expected > 0.5).sum() > 200
    assert np.abs(shown[..., 3] / 255 - expected).max() < 0.03
    covered = shown[..., 3] > 0
    assert (shown[covered][:, :3] == palette_of(("#8c4a12",))[1]).all()


def test_an_image_is_stretched_by_its_palette(world):
    layer = world.catalogue.layer(STOP.name, ProductKind.ORTHOPHOTO)
    plain = drawn(world, layer, INSIDE, StyleQuery())
    low, high = 60.0, 180.0  # brightness, of 0 to 254
    shown = drawn(world, layer, INSIDE, StyleQuery(low=low, high=high))
    brightness = plain[..., 0] / 255 * 254
    expected = np.clip((brightness - low) / (high - low), 0.0, 1.0) * 255
    assert np.abs(shown[..., 0] - expected).max() < 4.5  # a grey step is 2.1 here
    tinted = drawn(world, layer, INSIDE, StyleQuery(colours="red-blue"))
    assert (tinted[0, 0, :3] == palette_of(RED_BLUE)[plain[0, 0, 0]]).all() or tinted.any()


def test_every_style_of_every_kind_has_a_painter_and_a_ramp():
    for kind in STYLES:
        for name, style in styles_of(kind).items():
            assert style.colours
            assert name == "default" or style.title


REQUESTED = "/tiles/{scope}/{kind}/{digest}/{z}/{x}/{y}.png"


def requested(client, world, kind, **query):
    ref = world.catalogue.layer(STOP.name, kind).ref
    address = f"{INSIDE.zoom}/{INSIDE.column}/{INSIDE.row}.png"
    return client.get(f"/tiles/{ref.scope.name}/{kind}/{ref.digest}/{address}", params=query)


def test_classes_of_the_ground_have_a_colour_each_and_a_legend(hilly, terrain):
    image = drawn(hilly, terrain, INSIDE, StyleQuery(style="class"))
    seen = image[..., 3] > 0
    assert {tuple(colour) for colour in image[seen][:, :3]} == {(0x21, 0x91, 0x8C)}  # measured
    assert 0.9 < seen.mean() < 1.0  # the holes have none
    classes = legend_of(terrain, styles_of(ProductKind.DTM)["class"]).classes
    assert [one.name for one in classes] == ["measured", "interpolated", "occluded"]


def test_the_query_selects_a_style(client, world):
    layer = world.catalogue.layer(STOP.name, ProductKind.DTM)
    query = {"style": "slope", "colours": "viridis", "low": 0, "high": 15, "baseline": 0.5}
    answer = requested(client, world, ProductKind.DTM, **query)
    assert answer.status_code == 200
    look = StyleQuery(style="slope", colours="viridis", low=0.0, high=15.0, baseline=0.5)
    drawn_so = render_tile(layer, INSIDE, world.store, RasterPool(), look)
    assert unpacked(answer.content) == unpacked(drawn_so)
    assert answer.headers["cache-control"].endswith("immutable")


@pytest.mark.parametrize(
    ("kind", "query", "text"),
    [
        ("dtm", {"style": "sepia"}, "stop/dtm has no style sepia; it has default, hillshade"),
        ("slope", {"style": "contours"}, "has no style contours; it has default, uncertainty"),
        ("dtm", {"colours": "jet"}, "there are no colours jet; there are grey, viridis"),
        ("dtm", {"low": 5, "high": 5}, "low=5 is not below high=5"),
        ("hazard", {"colours": "grey"}, "has colours of its own"),
        ("dtm", {"style": "slope", "baseline": 99}, "a baseline of 99 m is 1237 cells of 0.08 m"),
        ("dtm", {"low": "nan"}, "low"),
        ("dtm", {"azimuth": "inf"}, "azimuth"),
        ("dtm", {"elevation": 91}, "elevation"),
        ("dtm", {"interval": 0}, "interval"),
        ("dtm", {"threshold": "north"}, "threshold"),
        ("dtm", {"stile": "slope"}, "stile"),
        ("dtm", {"style": "../../etc"}, "style"),
    ],
)
def test_an_unknown_style_is_refused_with_the_reason(client, world, kind, query, text):
    answer = requested(client, world, kind, **query)
    assert answer.status_code == 422
    assert text.replace("stop/", f"{STOP.name}/") in answer.text
    assert answer.headers["cache-control"] == "no-store"


def test_the_styles_of_a_layer_and_their_legends_are_listed(client, world):
    ref = world.catalogue.layer(STOP.name, ProductKind.DTM).ref
    place = f"/api/layers/{ref.scope.name}/dtm/{ref.digest}"
    body = client.get(f"{place}/styles").json()
    assert [one["style"] for one in body["styles"]] == list(styles_of(ProductKind.DTM))
    assert "viridis" in body["colours"]
    legend = client.get(f"{place}/legend", params={"style": "slope", "high": 20}).json()
    assert legend["unit"] == "degree"
    assert (legend["stops"][0][0], legend["stops"][-1][0]) == (0.0, 20.0)
    assert client.get(f"{place}/legend", params={"style": "hillshade"}).status_code == 404


def test_the_legend_image_has_the_colours_of_the_ends(client, world):
    ref = world.catalogue.layer(STOP.name, ProductKind.SLOPE).ref
    place = f"/api/layers/{ref.scope.name}/slope/{ref.digest}"
    answer = client.get(f"{place}/legend.png", params={"colours": "grey"})
    shown = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    bar = shown[30:-10, 12, 0].astype(int)
    assert bar[0] == 255
    assert bar[-1] == 0
    assert (np.diff(bar) <= 0).all()


def contours_of(client, world, **query):
    ref = world.catalogue.layer(STOP.name, ProductKind.DTM).ref
    return client.get(f"/api/layers/{STOP.name}/dtm/{ref.digest}/contours.geojson", params=query)


def test_contours_of_any_interval_are_at_the_ground_of_their_elevation(client, world):
    body = contours_of(client, world, interval=0.25, bbox="-20,-20,20,20").json()
    assert body["solmap:interval_m"] == 0.25
    levels = set()
    for feature in body["features"]:
        points = np.array(feature["geometry"]["coordinates"])
        elevation = feature["properties"]["elevation_m"]
        levels.add(elevation)
        np.testing.assert_allclose(points[:, 2], elevation)
        inner = (np.abs(points[:, :2]) < 19.0).all(axis=1)
        there = 5.0 + points[inner, 0] * PLANE[0] + points[inner, 1] * PLANE[1]
        np.testing.assert_allclose(there, elevation, atol=2e-3)
        assert (np.abs(points[:, :2]) <= 20.1).all()
    steps = np.array(sorted(levels)) / 0.25
    np.testing.assert_allclose(steps, np.rint(steps))
    assert len(levels) >= 20


def test_contours_that_would_be_too_many_are_refused(client, world):
    answer = contours_of(client, world, interval=0.001)
    assert answer.status_code == 422
    assert "contours between" in answer.text
    assert contours_of(client, world, interval="nan").status_code == 422
    assert contours_of(client, world, bbox="900,900,901,901").json()["features"] == []


def test_a_layer_of_the_map_links_to_its_styles(client):
    layers = client.get("/api/missions/MER2/layers").json()
    for layer in layers:
        assert (layer["styles"] is None) == (layer["tiles"] is None)
        if layer["styles"]:
            listed = client.get(layer["styles"]).json()["styles"]
            assert listed[0]["style"] == "default"
            for style in listed:
                assert (style["legend"] is None) or set(style["legend"]) >= {"stops", "unit"}
