import hashlib
import json
from dataclasses import replace

import geopandas
import numpy as np
import pytest
import rasterio
from fastapi.testclient import TestClient
from pyproj import CRS as ProjCrs

from solmap.gis_server.app import create_app
from solmap.products.catalogue.catalogue import Catalogue, MissionEntry
from solmap.products.formats.raster.raster import write_raster
from solmap.products.model import Layer, ProductKind, Recipe
from tests.support.tile_at import tile_at
from tests.unit.gis_server.conftest import (
    CRS,
    GRID,
    IMAGE_BYTES,
    LANDING,
    REGION,
    STOP,
    constant,
    elevation_at,
    image_in,
    plane,
    ref_of,
)

EARTH_LIKE = ("4326", "WGS 84", "WGS84")


def layers_of(client):
    return {layer["id"]: layer for layer in client.get("/api/missions/MER2/layers").json()}


def test_a_mission_states_the_place_of_its_map_on_mars(client):
    (mission,) = client.get("/api/missions").json()
    assert mission["mission"] == "MER2"
    assert mission["landing"]["longitude"] == LANDING.longitude
    assert ProjCrs.from_wkt(mission["crs"]["wkt"]).equals(CRS)
    assert f"+R={LANDING.radius_m}" in mission["crs"]["proj4"]
    west, south, east, north = mission["bounds"]
    assert (west, south) <= (GRID.bounds[0], GRID.bounds[1])
    assert (east, north) >= (GRID.bounds[2], GRID.bounds[3])
    tiles = mission["tile_matrix_set"]
    side = tiles["extent"][2] - tiles["extent"][0]
    for zoom, cell_m in enumerate(tiles["cell_sizes"]):
        assert tiles["tile_size"] * cell_m * 2**zoom == pytest.approx(side)


def test_a_layer_without_features_does_not_extend_the_map_to_the_lander(tmp_path):
    far = (1000.0, 2000.0, 1040.0, 2050.0)
    layers = [
        Layer(ref, "MER2", "a title", "vector", bounds, None, None, None, (), "2026-01-01")
        for ref, bounds in (
            (Recipe(ProductKind.STOPS, REGION).ref, far),
            (Recipe(ProductKind.CONTOURS, REGION).ref, (0.0, 0.0, 0.0, 0.0)),
        )
    ]
    entry = MissionEntry("MER2", "a title", LANDING, None)
    catalogue = Catalogue.open(tmp_path)
    catalogue.publish(missions=[entry], layers=layers[1:])
    with TestClient(create_app(tmp_path)) as client:
        (empty,) = client.get("/api/missions").json()
        catalogue.publish(layers=layers[:1])
        (filled,) = client.get("/api/missions").json()
    assert empty["bounds"] == [-50.0, -50.0, 50.0, 50.0]
    assert filled["bounds"] == list(far)


def test_every_url_of_every_layer_answers(client):
    layers = layers_of(client)
    assert len(layers) == 10
    for layer in layers.values():
        assert client.get(layer["provenance"]).json()["recipe"]["kind"] == layer["kind"]
        assert client.get(layer["download"]).status_code == 200
        if layer["type"] == "raster":
            inside = tile_at(1.0, 1.0, layer["minzoom"])
            address = layer["tiles"].format(z=inside.zoom, x=inside.column, y=inside.row)
            assert client.get(address).headers["content-type"] == "image/webp"
            assert layer["features"] is None
        else:
            assert client.get(layer["features"]).json()["type"] == "FeatureCollection"
            assert layer["tiles"] is None


def test_no_answer_claims_to_be_on_earth(client):
    answers = [client.get("/api/missions").text, client.get("/api/missions/MER2/layers").text]
    answers += [client.get(layer["download"]).content[:4000].decode("latin-1")
                for layer in layers_of(client).values()]  # fmt: skip
    for answer in answers:
        assert not any(name in answer for name in EARTH_LIKE)


def test_a_raster_layer_ends_at_the_zoom_of_its_cells(client):
    layer = layers_of(client)[f"{STOP.name}/dtm"]
    mission = client.get("/api/missions").json()[0]
    assert mission["tile_matrix_set"]["cell_sizes"][layer["maxzoom"]] == layer["cell_m"] == 0.08
    assert layer["minzoom"] < layer["maxzoom"]
    assert layer["unit"] == layer["legend"]["unit"] == "m"
    low, high = layer["range"]
    assert (layer["legend"]["stops"][0][0], layer["legend"]["stops"][-1][0]) == pytest.approx(
        (low, high), abs=1e-3
    )


def test_identify_reads_the_plane_at_the_place(client):
    place = client.get("/api/missions/MER2/identify", params={"east": 7.0, "north": 6.5}).json()
    # The value is that of the cell the place lies in: at most half a cell of the slopes away.
    assert place["elevation_m"] == pytest.approx(elevation_at(7.0, 6.5), abs=0.04 * 0.15 + 1e-5)
    assert place["elevation_sigma_m"] == pytest.approx(0.02)
    assert (place["lon"], place["lat"]) == pytest.approx((175.473022132, -14.569090238), abs=1e-9)
    values = {value["kind"]: value for value in place["layers"]}
    assert values["slope"]["value"] == 20.0
    assert values["slope"]["unit"] == "degree"
    assert values["aspect"]["value"] == 90.0
    grey = (7.0 - GRID.west) / 0.08 / GRID.cols * 254.0
    assert values["orthophoto"]["value"] == pytest.approx(grey, abs=1.0)


def test_identify_names_the_footprints_around_the_place_and_the_stop_near_it(client):
    place = client.get("/api/missions/MER2/identify", params={"east": 7.0, "north": 6.5}).json()
    found = [(f["kind"], f["id"], f["distance_m"]) for f in place["features"]]
    assert found == [("footprints", "B", 0.0), ("footprints", "A", 0.0), ("stops", "stop", 0.5)]
    away = client.get("/api/missions/MER2/identify", params={"east": 15.0, "north": 15.0}).json()
    assert [f["id"] for f in away["features"]] == ["A"]


@pytest.mark.parametrize("east", [-35.0, 5000.0])
def test_identify_has_no_elevation_on_unseen_ground(client, east):
    place = client.get("/api/missions/MER2/identify", params={"east": east, "north": 0.0}).json()
    assert place["elevation_m"] is None
    assert place["layers"] == []


@pytest.mark.parametrize(
    "query", ["east=nan&north=0", "east=inf&north=0", "east=1", "east=a&north=0"]
)
def test_identify_refuses_an_invalid_place(client, query):
    assert client.get(f"/api/missions/MER2/identify?{query}").status_code == 422


def test_features_are_in_metres_of_the_local_map(client):
    layer = layers_of(client)["mer2/stops"]
    answer = client.get(layer["features"])
    assert answer.headers["content-type"].startswith("application/geo+json")
    assert answer.json()["features"][0]["geometry"]["coordinates"] == [7.0, 6.0, 6.1]


@pytest.mark.parametrize(
    ("bbox", "ids"), [("1,1,2,2", ["A"]), ("6,6,7,7", ["A", "B"]), ("30,30,40,40", [])]
)
def test_features_are_clipped_to_a_box(client, bbox, ids):
    address = layers_of(client)["mer2/footprints"]["features"]
    features = client.get(address, params={"bbox": bbox}).json()["features"]
    assert [feature["id"] for feature in features] == ids


@pytest.mark.parametrize("bbox", ["1,2,3", "a,b,c,d", "2,2,1,1", "nan,0,1,1"])
def test_an_invalid_box_is_refused(client, bbox):
    address = layers_of(client)["mer2/footprints"]["features"]
    assert client.get(address, params={"bbox": bbox}).status_code == 422


def test_a_download_is_the_product_under_a_readable_name(client, world):
    layer = layers_of(client)[f"{STOP.name}/dtm"]
    answer = client.get(layer["download"])
    path = world.store.path(ref_of(world, ProductKind.DTM))
    assert hashlib.sha256(answer.content).digest() == hashlib.sha256(path.read_bytes()).digest()
    name = "MER2_sol0156_site010_drive0064_dtm_8cm.tif"
    assert name in answer.headers["content-disposition"]
    with rasterio.MemoryFile(answer.content) as file, file.open() as dataset:
        assert ProjCrs.from_wkt(dataset.crs.to_wkt(version="WKT2_2019")).equals(CRS)


def test_a_download_supports_ranges(client):
    address = layers_of(client)[f"{STOP.name}/dtm"]["download"]
    whole = client.get(address).content
    part = client.get(address, headers={"Range": "bytes=1000-1999"})
    assert part.status_code == 206
    assert part.content == whole[1000:2000]
    assert part.headers["content-range"] == f"bytes 1000-1999/{len(whole)}"
    assert client.head(address).headers["content-length"] == str(len(whole))
    beyond = client.get(address, headers={"Range": f"bytes={len(whole)}-"})
    assert beyond.status_code == 416


def test_a_downloaded_feature_file_is_in_degrees_of_mars(client):
    document = client.get(layers_of(client)["mer2/stops"]["download"]).json()
    assert document["crs"]["properties"]["name"] == "urn:ogc:def:crs:IAU:2015:49900"
    longitude, latitude, _ = document["features"][0]["geometry"]["coordinates"]
    assert (longitude, latitude) == pytest.approx((175.473022, -14.569099), abs=1e-5)


def test_images_name_their_partner_or_the_reason_for_none(client):
    (image,) = client.get("/api/missions/MER2/images").json()
    assert image["unpaired_because"] == "the right image was never sent"
    assert client.get(image["original"]).content == IMAGE_BYTES
    shown = client.get(image["browse"])
    assert shown.headers["content-type"] == "image/png"


@pytest.mark.parametrize(
    ("query", "count"), [("sol=156", 1), ("sol=1", 0), (f"stop={STOP.name}", 1), ("stop=x", 0)]
)
def test_images_are_selected_by_sol_and_stop(client, query, count):
    assert len(client.get(f"/api/missions/MER2/images?{query}").json()) == count


PROBLEM = {"type", "title", "status", "detail", "instance"}
"""Members of RFC 9457."""


@pytest.mark.parametrize(
    "address",
    [
        "/api/missions/MSL/layers",
        "/api/missions/MSL/images",
        "/api/missions/MSL/identify?east=0&north=0",
        "/api/layers/mer2/dtm/0123456789abcdef/provenance",
        "/tiles/mer2/dtm/0123456789abcdef/0/0/0.png",
        "/download/mer2/dtm/0123456789abcdef",
        "/images/NONE/original",
        "/api/nothing",
    ],
)
def test_unknown_resources_are_answered_with_a_name_and_advice(client, address):
    answer = client.get(address)
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"
    reported = answer.json()
    assert set(reported) == {*PROBLEM, "code", "description", "hint"}
    assert reported["type"] == "about:blank"
    assert (reported["title"], reported["status"]) == ("Not Found", 404)
    assert reported["instance"] == address.split("?")[0]
    assert (reported["code"], reported["description"]) == (reported["title"], reported["detail"])
    assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    ("method", "address", "status"),
    [
        ("GET", "/api/missions/MER2/identify?east=here&north=0", 422),
        ("GET", "/ogc/MER2/collections/stops/items?limit=0", 400),
        ("PUT", "/api/missions", 405),
        ("POST", "/api/runs", 413),
    ],
)
def test_every_refusal_is_a_problem_document(client, method, address, status):
    body = b" " * 4_000_000 if status == 413 else None
    answer = client.request(method, address, content=body)
    assert (answer.status_code, answer.headers["content-type"]) == (
        status,
        "application/problem+json",
    )
    reported = answer.json()
    assert reported.keys() >= PROBLEM
    assert (reported["status"], reported["instance"]) == (status, address.split("?")[0])
    if status == 422:
        assert [one["loc"] for one in reported["errors"]] == [["query", "east"]]
        assert "query.east" in reported["detail"]


def test_a_raster_has_no_features_and_features_have_no_tiles(client, world):
    dtm, stops = ref_of(world, ProductKind.DTM), ref_of(world, ProductKind.STOPS, REGION)
    answer = client.get(f"/api/layers/{STOP.name}/dtm/{dtm.digest}/features.geojson")
    assert answer.status_code == 404
    assert "is a raster" in answer.json()["detail"]
    answer = client.get(f"/tiles/mer2/stops/{stops.digest}/0/0/0.png")
    assert answer.status_code == 404
    assert "stops has no tiles" in answer.json()["detail"]


UP = ["../../../../etc/passwd", "..%2f..%2f..%2fetc%2fpasswd", "%2e%2e/%2e%2e/etc/passwd",
      "....//etc/passwd", "%00", "..\\..\\etc", "/etc/passwd", "%c0%ae%c0%ae/etc"]  # fmt: skip


@pytest.mark.parametrize("up", UP)
def test_no_url_reaches_outside_the_store(client, up):
    digest = "0123456789abcdef"
    for address in (
        f"/download/{up}/dtm/{digest}",
        f"/download/mer2/{up}/{digest}",
        f"/download/mer2/dtm/{up}",
        f"/api/layers/{up}/dtm/{digest}/provenance",
        f"/tiles/{up}/dtm/{digest}/0/0/0.png",
        f"/images/{up}/original",
        f"/images/{up}/browse.png",
        f"/api/missions/{up}/layers",
        f"/{up}",
    ):
        answer = client.get(address)
        assert answer.status_code in (404, 422), address
        assert "root:" not in answer.text


def test_no_url_reaches_outside_the_viewer(world, tmp_path):
    (tmp_path / "secret").write_text("root:")
    dist = tmp_path / "dist"
    dist.mkdir()
    (dist / "index.html").write_text("<h1>the map</h1>")
    with TestClient(create_app(world.root, dist)) as client:
        assert client.get("/").text == "<h1>the map</h1>"
        for up in ("../secret", "..%2fsecret", "%2e%2e/secret", "x/../../secret"):
            assert client.get(f"/{up}").status_code == 404
        assert client.get("/api/nothing").status_code == 404
        assert client.get("/healthz").json() == {"status": "ok"}


def test_without_the_built_viewer_the_first_page_explains_how_to_build_it(world, tmp_path):
    with TestClient(create_app(world.root, tmp_path)) as client:
        assert "has not been built" in client.get("/").text
        assert "GET /api/missions" in client.get("/docs").text


def test_the_api_documentation_loads_from_no_other_host(world, tmp_path):
    swagger = tmp_path / "swagger"
    swagger.mkdir()
    (tmp_path / "index.html").write_text("")
    for name in ("swagger-ui-bundle.js", "swagger-ui.css"):
        (swagger / name).write_text("/* */")
    with TestClient(create_app(world.root, tmp_path)) as client:
        page = client.get("/docs").text
        assert "http" not in page
        for address in ("/swagger/swagger-ui-bundle.js", "/swagger/swagger-ui.css"):
            assert address.removeprefix("/") in page  # beside the page, below any path
            assert client.get(address).status_code == 200
        assert "openapi.json" in client.get("/docs/start.js").text
        paths = client.get("/openapi.json").json()["paths"]
        assert all(operation["description"] for path in paths.values()
                   for operation in path.values())  # fmt: skip


def test_no_other_origin_is_allowed_and_nothing_loads_from_elsewhere(client):
    for address in ("/", "/api/missions", "/api/nothing"):
        headers = client.get(address, headers={"Origin": "https://elsewhere.example"}).headers
        assert "access-control-allow-origin" not in headers
        assert headers["x-content-type-options"] == "nosniff"
        assert "default-src 'self'" in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]


def test_long_answers_are_compressed_and_downloads_are_not(client):
    assert client.get("/api/missions").headers["content-encoding"] == "gzip"
    layer = layers_of(client)["mer2/stops"]
    assert "content-encoding" not in client.get(layer["download"]).headers


def test_a_layer_published_while_serving_is_listed_at_once(own_world):
    client, world = TestClient(create_app(own_world.root)), own_world
    before = ref_of(world, ProductKind.SLOPE)
    world.publish_raster(ProductKind.SLOPE, STOP, constant(35.0), version=1)
    layer = layers_of(client)[f"{STOP.name}/slope"]
    assert layer["digest"] != before.digest
    place = client.get("/api/missions/MER2/identify", params={"east": 1, "north": 1}).json()
    assert {v["kind"]: v["value"] for v in place["layers"]}["slope"] == 35.0
    old = layer["tiles"].replace(layer["digest"], before.digest).format(z=17, x=65536, y=65535)
    new = layer["tiles"].format(z=17, x=65536, y=65535)
    colours = [image_in(client.get(address).content)[128, 128] for address in (old, new)]
    assert not np.array_equal(*colours)


def test_the_terrain_model_of_the_region_gives_the_elevation(own_world):
    client = TestClient(create_app(own_world.root))

    def write(path):
        write_raster(path, GRID, {"elevation": plane() + np.float32(100.0)}, CRS, unit="m")

    layer = own_world.publish_raster(ProductKind.DTM, REGION, write)
    place = client.get("/api/missions/MER2/identify", params={"east": 7.0, "north": 6.5}).json()
    assert place["elevation_m"] == pytest.approx(100.0 + elevation_at(7.0, 6.5), abs=0.01)
    assert [v["scope"] for v in place["layers"] if v["kind"] == "dtm"] == ["mer2", STOP.name]
    assert layer.id == "mer2/dtm"


def test_far_ground_gives_the_elevation_where_no_stop_has_any(own_world):
    client = TestClient(create_app(own_world.root))
    beyond = replace(GRID, west=GRID.west - GRID.cols * GRID.cell_m, cols=2 * GRID.cols)
    elevation = np.full(beyond.shape, 7.5, np.float32)

    def write(path):
        write_raster(path, beyond, {"elevation": elevation}, CRS, unit="m")

    own_world.publish_raster(ProductKind.FAR_DTM, REGION, write)
    for east, expected in ((7.0, elevation_at(7.0, 6.5)), (GRID.west - 1.0, 7.5)):
        query = {"east": east, "north": 6.5}
        place = client.get("/api/missions/MER2/identify", params=query).json()
        assert place["elevation_m"] == pytest.approx(expected, abs=0.01)
    layer = layers_of(client)["mer2/far-dtm"]
    assert layer["legend"]["unit"] == "m"


def test_a_damaged_or_removed_product_is_named_and_the_rest_is_served(own_world):
    client = TestClient(create_app(own_world.root))
    layers = layers_of(client)
    dtm, slope = layers[f"{STOP.name}/dtm"], layers[f"{STOP.name}/slope"]
    damaged = own_world.store.path(ref_of(own_world, ProductKind.DTM))
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[: len(whole) // 3])
    own_world.store.path(ref_of(own_world, ProductKind.SLOPE)).unlink()
    address = {"z": 17, "x": 65536, "y": 65536}
    broken = client.get(dtm["tiles"].format(**address))
    assert broken.status_code == 500
    assert f"{dtm['digest']}.tif is broken" in broken.json()["detail"]
    gone = client.get(slope["tiles"].format(**address))
    assert gone.status_code == 404
    assert "run the processing that makes it" in gone.json()["detail"]
    hillshade = layers[f"{STOP.name}/hillshade"]["tiles"].format(**address)
    assert client.get(hillshade).status_code == 200
    place = client.get("/api/missions/MER2/identify", params={"east": 3.0, "north": 3.0}).json()
    assert {"hillshade", "aspect"} <= {value["kind"] for value in place["layers"]}
    assert not {"dtm", "slope"} & {value["kind"] for value in place["layers"]}


def test_the_answers_are_plain_json(client):
    for address in ("/api/missions", "/api/missions/MER2/layers", "/api/missions/MER2/images"):
        json.loads(client.get(address).content, parse_constant=pytest.fail)


def layer_of(client, kind):
    layers = client.get("/api/missions/MER2/layers").json()
    return next(layer for layer in layers if layer["kind"] == kind)


def test_the_legend_of_a_class_layer_names_its_classes(client):
    legend = layer_of(client, "hazard")["legend"]
    assert [one["name"] for one in legend["classes"]] == [
        "traversable", "too rough", "step too high", "too steep",
    ]  # fmt: skip
    assert legend["stops"] == []
    assert layer_of(client, "northerly-tilt")["legend"]["classes"] == []


@pytest.mark.parametrize(("north", "name"), [(5.0, "too steep"), (-5.0, "traversable")])
def test_identify_names_the_class_at_the_place(client, north, name):
    found = client.get(f"/api/missions/MER2/identify?east=5&north={north}").json()
    (hazard,) = (layer for layer in found["layers"] if layer["kind"] == "hazard")
    assert hazard["label"] == name


@pytest.mark.parametrize(("place", "count"), [((-19.0, -19.0), 1), ((-15.0, -15.0), 0)])
def test_identify_finds_the_haven_around_a_place_but_not_in_its_hole(client, place, count):
    found = client.get(f"/api/missions/MER2/identify?east={place[0]}&north={place[1]}").json()
    assert sum(feature["kind"] == "havens" for feature in found["features"]) == count


def test_features_are_served_as_a_geopackage_too(client, tmp_path):
    layer = layer_of(client, "havens")
    answer = client.get(f"{layer['download']}.gpkg")
    assert answer.headers["content-disposition"].endswith('"MER2_sol0156_havens.gpkg"')
    (tmp_path / "havens.gpkg").write_bytes(answer.content)
    frame = geopandas.read_file(tmp_path / "havens.gpkg")
    assert frame.area.tolist() == pytest.approx([96.0])
    assert frame.area_m2.tolist() == [96.0]
    refused = client.get(f"{layer_of(client, 'dtm')['download']}.gpkg")
    assert refused.status_code == 404
    assert "is a raster" in refused.json()["detail"]
