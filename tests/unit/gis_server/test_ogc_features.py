"""OGC API Features over a small world whose every feature is known."""

import csv
import io
import json
from datetime import datetime

import jsonschema
import numpy as np
import pyogrio
import pytest
from fastapi.testclient import TestClient
from pyproj import CRS, Transformer

from solmap.gis_server.app import create_app
from solmap.products.catalogue.edits import EditKind, EditLog
from solmap.products.crs import MARS, local_crs
from solmap.products.formats.vector.geojson import Feature
from solmap.products.model import ProductKind
from tests.unit.gis_server.conftest import LANDING, STOP

BASE = "http://testserver/ogc/MER2"
MARS_URI = "http://www.opengis.net/def/crs/IAU/2015/49900"
TIES = np.array([[float(k % 40), float(k // 40) - 20.0, 0.01 * k] for k in range(1200)])


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    from tests.unit.gis_server.conftest import build  # noqa: PLC0415

    world = build(tmp_path_factory.mktemp("features"))
    image = world.catalogue.images("MER2")[0].id
    world.publish_features(
        ProductKind.POINTING,
        [
            Feature(
                "LineString", np.array([[7.0, 6.0, 7.2], [17.0, 6.0, 5.0]]), {"image": image}, image
            )
        ],
    )
    known = {"stop": STOP.name, "site": 10, "drive": 64, "sols": [156]}
    world.publish_features(
        ProductKind.STOPS,
        [
            Feature("Point", np.array([[7.0, 6.0, 6.1]]), {**known, "solution": "telemetry"}, "t"),
            Feature("Point", np.array([[7.5, 5.0, 6.0]]), {**known, "solution": "adjusted"}, "a"),
        ],
        version=1,
    )
    world.publish_features(
        ProductKind.TIE_POINTS,
        [
            Feature("Point", place[None], {"kind": "cross-site", "pairs": [image]}, str(k))
            for k, place in enumerate(TIES)
        ],
    )
    with TestClient(create_app(world.root)) as opened:
        yield opened


def get(client, path, **query):
    answer = client.get(f"/ogc/MER2{path}", params=query)
    assert answer.status_code == 200, answer.text
    return answer


def features(client, collection, **query):
    return get(client, f"/collections/{collection}/items", **query).json()["features"]


def test_the_landing_page_links_to_everything(client):
    rels = {link["rel"]: link["href"] for link in get(client, "").json()["links"]}
    assert {"self", "service-desc", "conformance", "data"} <= set(rels)
    for rel in ("conformance", "data", "service-desc"):
        assert client.get(rels[rel]).status_code == 200
    conforms = get(client, "/conformance").json()["conformsTo"]
    assert "http://www.opengis.net/spec/ogcapi-features-2/1.0/conf/crs" in conforms


def test_collections_have_their_extent_in_space_and_time(client):
    listed = get(client, "/collections").json()["collections"]
    by_id = {one["id"]: one for one in listed if one.get("itemType") == "feature"}
    assert {"stops", "traverse-differences", "images", "footprints", "tie-points"} <= set(by_id)
    assert "dips" not in by_id  # nobody published any
    ties = by_id["tie-points"]
    assert ties["storageCrs"] == MARS_URI
    assert set(ties["crs"]) == {f"{BASE}/crs/lon-lat", MARS_URI, f"{BASE}/crs/local"}
    west, south, east, north = ties["extent"]["spatial"]["bbox"][0]
    to_degrees = Transformer.from_crs(
        local_crs(LANDING), local_crs(LANDING).geodetic_crs, always_xy=True
    )
    assert (west, south) == pytest.approx(to_degrees.transform(0.0, -20.0), abs=1e-7)
    assert (east, north) == pytest.approx(to_degrees.transform(39.0, 9.0), abs=1e-7)
    assert ties["extent"]["temporal"]["interval"] == [["2004-06-11T10:00:00.000Z"] * 2]
    assert get(client, "/collections/tie-points").json() == ties


def test_next_links_return_every_feature_once(client):
    seen, href = [], f"{BASE}/collections/tie-points/items?limit=500"
    while href:
        page = client.get(href).json()
        assert page["numberMatched"] == 1200
        assert page["numberReturned"] == len(page["features"])
        seen += [one["id"] for one in page["features"]]
        href = next((link["href"] for link in page["links"] if link["rel"] == "next"), None)
    assert seen == [str(k) for k in range(1200)]


@pytest.mark.parametrize(
    ("crs", "expected"),
    [
        (None, lambda lon, lat: (lon, lat)),
        (MARS_URI, lambda lon, lat: (lat, lon)),
        (f"{BASE}/crs/local", lambda _lon, _lat: (7.5, 5.0)),
    ],
)
def test_axes_are_in_the_order_of_the_requested_crs(client, crs, expected):
    answer = get(client, "/collections/stops/items", **({"crs": crs} if crs else {}))
    place = answer.json()["features"][0]["geometry"]["coordinates"]
    local = local_crs(LANDING)
    lon, lat = Transformer.from_crs(local, local.geodetic_crs, always_xy=True).transform(7.5, 5.0)
    assert place[:2] == pytest.approx(expected(lon, lat), abs=1e-9)
    assert place[2] == 6.0
    assert answer.headers["content-crs"] == f"<{crs or BASE + '/crs/lon-lat'}>"


def box_around(east, north, half):
    local = local_crs(LANDING)
    carry = Transformer.from_crs(local, local.geodetic_crs, always_xy=True).transform
    return *carry(east - half, north - half), *carry(east + half, north + half)


@pytest.mark.parametrize("crs", ["lon-lat", "mars", "local"])
def test_a_box_selects_its_features_in_any_crs(client, crs):
    west, south, east, north = box_around(10.0, -5.0, 2.5)
    query = {
        "lon-lat": {"bbox": f"{west},{south},{east},{north}"},
        "mars": {"bbox": f"{south},{west},{north},{east}", "bbox-crs": MARS_URI},
        "local": {"bbox": "7.5,-7.5,12.5,-2.5", "bbox-crs": f"{BASE}/crs/local"},
    }[crs]
    found = features(client, "tie-points", limit=1000, crs=f"{BASE}/crs/local", **query)
    places = {tuple(one["geometry"]["coordinates"][:2]) for one in found}
    inside = (np.abs(TIES[:, :2] - (10.0, -5.0)) <= 2.5).all(axis=1)
    assert places == {tuple(row) for row in TIES[inside][:, :2].tolist()}
    assert len(found) == inside.sum() == 25


@pytest.mark.parametrize(
    ("bbox", "count"),
    [
        ("-180,-90,180,90", 1200),
        ("170,-20,-170,0", 1200),  # over the antimeridian
        ("-190,-20,-180,0", 1200),  # the same place, a turn to the west
        ("0,0,10,10", 0),  # the other side of Mars
        ("175.4,-14.6,175.45,-14.5", 0),
    ],
)
def test_boxes_in_degrees_may_cross_the_antimeridian(client, bbox, count):
    page = get(client, "/collections/tie-points/items", bbox=bbox, limit=1).json()
    assert page["numberMatched"] == count


@pytest.mark.parametrize(
    ("query", "count"),
    [
        ({"sol": "156"}, 1200),
        ({"sol": "157/.."}, 0),
        ({"sol": "../155"}, 0),
        ({"datetime": "2004-06-11T10:00:00Z"}, 1200),
        ({"datetime": "2004-06-11T12:00:00+02:00"}, 1200),
        ({"datetime": "2004-06-12T00:00:00Z/.."}, 0),
        ({"datetime": "../2004-06-11"}, 0),
        ({"kind": "cross-site"}, 1200),
        ({"kind": "inter-stereo"}, 0),
    ],
)
def test_sol_time_and_properties_select(client, query, count):
    page = get(client, "/collections/tie-points/items", limit=1, **query).json()
    assert page["numberMatched"] == count


@pytest.mark.parametrize(
    ("query", "content"),
    [
        ({"bbox": "1,2,3"}, "four or six numbers"),
        ({"bbox": "nan,0,1,1"}, "four or six numbers"),
        ({"bbox": "0,5,1,1"}, "smaller coordinates"),
        ({"crs": "http://www.opengis.net/def/crs/OGC/1.3/CRS84"}, "is none of"),
        ({"limit": "0"}, "from 1 on"),
        ({"limit": "-1"}, "from 1 on"),
        ({"offset": "1e9"}, "from 0 on"),
        ({"datetime": "noon"}, "2004-06-11T10:00:00Z"),
        ({"datetime": "2004-06-12/2004-06-11"}, "later than the last"),
        ({"datetime": "../.."}, "one value, or two"),
        ({"sol": "x"}, "whole number"),
        ({"f": "shp"}, "is none of json"),
        ({"colour": "red"}, "neither a parameter nor a property"),
    ],
)
def test_an_invalid_request_answers_400_with_the_reason(client, query, content):
    answer = client.get("/ogc/MER2/collections/tie-points/items", params=query)
    assert answer.status_code == 400
    assert content in answer.json()["description"]


@pytest.mark.parametrize(
    "path",
    [
        "/ogc/NONE",
        "/ogc/MER2/collections/none",
        "/ogc/MER2/collections/none/items",
        "/ogc/MER2/collections/stops/items/none",
        "/ogc/MER2/crs/lon-lat",
    ],
)
def test_an_unknown_resource_answers_404(client, path):
    assert client.get(path).status_code == 404


def test_one_feature_links_back_to_its_collection(client):
    one = get(client, "/collections/stops/items/a").json()
    assert one["properties"]["solution"] == "adjusted"
    assert {link["rel"] for link in one["links"]} == {"self", "alternate", "collection"}


def test_differences_join_telemetry_and_adjusted(client):
    (one,) = features(client, "traverse-differences", crs=f"{BASE}/crs/local")
    assert one["geometry"]["coordinates"] == [[7.0, 6.0, 6.1], [7.5, 5.0, 6.0]]
    known = one["properties"]
    assert (known["east_m"], known["north_m"], known["up_m"]) == (0.5, -1.0, -0.1)
    assert known["horizontal_m"] == pytest.approx(np.hypot(0.5, 1.0), abs=1e-4)


def test_the_profile_has_both_elevations_over_the_distance_driven(client):
    (one,) = features(client, "traverse-profile")
    known = one["properties"]
    assert (known["distance_m"], known["elevation_telemetry_m"]) == (0.0, 6.1)
    assert known["elevation_adjusted_m"] == 6.0


def test_stops_without_elevations_have_differences_and_a_profile_on_the_map(own_world):
    places = {"first": [(0.0, 0.0), (0.0, 0.0, 1.0)], "second": [(3.0, 4.0, 2.0), (6.0, 8.0)]}
    own_world.publish_features(
        ProductKind.STOPS,
        [
            Feature(
                "Point", np.array([place]), {"stop": stop, "solution": solution}, stop[0] + str(k)
            )
            for stop, both in places.items()
            for k, (solution, place) in enumerate(zip(("telemetry", "adjusted"), both, strict=True))
        ],
        version=1,
    )
    with TestClient(create_app(own_world.root)) as client:
        second = features(client, "traverse-differences", crs=f"{BASE}/crs/local")[1]
        assert second["geometry"]["coordinates"] == [[3.0, 4.0], [6.0, 8.0]]
        assert second["properties"]["up_m"] is None
        assert second["properties"]["horizontal_m"] == 5.0
        known = [one["properties"] for one in features(client, "traverse-profile")]
        assert [one["distance_m"] for one in known] == [0.0, 10.0]
        assert [one["elevation_telemetry_m"] for one in known] == [None, 2.0]
        assert [one["elevation_adjusted_m"] for one in known] == [1.0, None]


def test_annotations_are_features_as_soon_as_they_are_written(own_world):
    log = EditLog.of(own_world.root)

    def annotate(kind, coordinates, **more):
        shape = {"type": kind, "coordinates": coordinates}
        document = {"geometry": shape, "text": "layered rock", **more}
        edit = log.append("MER2", EditKind.ANNOTATION, document, "Ada")
        own_world.catalogue.append_event("edits.changed", {"mission": "MER2"})
        return edit

    with TestClient(create_app(own_world.root)) as client:
        assert features(client, "annotations") == []
        point = annotate("Point", [3.0, 4.0])
        annotate("LineString", [[0.0, 0.0], [5.0, 5.0]], category="waypoint")
        annotate("Point", [5.0, 6.0], state="draft")  # not for other programs yet
        found = features(client, "annotations", crs=f"{BASE}/crs/local")
        assert [one["geometry"]["type"] for one in found] == ["Point", "LineString"]
        assert found[0]["geometry"]["coordinates"] == [3.0, 4.0]
        assert found[0]["properties"]["author"] == "Ada"
        assert [one["properties"]["category"] for one in found] == ["note", "waypoint"]
        files = [get(client, "/collections/annotations/items", f=form) for form in ("gpkg", "fgb")]
        assert all(answer.content for answer in files)
        log.undo("MER2", point.id, "Ben")
        own_world.catalogue.append_event("edits.changed", {"mission": "MER2"})
        assert len(features(client, "annotations")) == 1


def test_images_are_at_their_camera_position_and_link_to_their_files(client):
    (one,) = features(client, "images", crs=f"{BASE}/crs/local")
    assert one["geometry"]["coordinates"] == [7.0, 6.0, 7.2]
    assert datetime.fromisoformat(one["properties"]["start_time"]).year == 2004
    for file in ("browse", "original"):
        assert client.get(one["properties"][file]).status_code == 200


def test_csv_has_a_row_for_each_feature_and_columns_for_the_axes(client):
    text = get(client, "/collections/stops/items", f="csv", crs=f"{BASE}/crs/local").text
    (row,) = csv.DictReader(io.StringIO(text))
    assert (row["id"], row["east_m"], row["north_m"], row["elevation_m"]) == (
        "a",
        "7.5",
        "5.0",
        "6.0",
    )
    assert json.loads(row["sols"]) == [156]


@pytest.mark.parametrize("form", ["gpkg", "fgb"])
@pytest.mark.parametrize("local", [False, True])
def test_files_have_all_features_in_a_crs_that_gdal_reads(client, tmp_path, form, local):
    query = {"crs": f"{BASE}/crs/local"} if local else {"crs": MARS_URI}
    body = get(client, "/collections/tie-points/items", f=form, **query).content
    file = tmp_path / f"ties.{form}"
    file.write_bytes(body)
    frame = pyogrio.read_dataframe(file)
    assert len(frame) == 1200
    requested = local_crs(LANDING) if local else CRS(MARS)
    assert CRS(frame.crs).equals(requested, ignore_axis_order=True)
    on_map = frame.to_crs(local_crs(LANDING)).sort_values("feature_id", key=lambda c: c.astype(int))
    places = np.column_stack([on_map.geometry.x, on_map.geometry.y])
    np.testing.assert_allclose(places, TIES[:, :2], atol=1e-4)  # nine decimals of a degree


def test_browsers_get_html_pages(client):
    for path in (
        "",
        "/collections",
        "/collections/stops",
        "/collections/stops/items",
        "/collections/stops/items/a",
        "/conformance",
    ):
        answer = client.get(f"/ogc/MER2{path}", headers={"accept": "text/html,*/*;q=0.8"})
        assert answer.headers["content-type"].startswith("text/html"), path
        assert "<h1>" in answer.text


def test_a_new_layer_is_served_at_once(own_world):
    with TestClient(create_app(own_world.root)) as client:
        assert [one["id"] for one in features(client, "havens")] == ["haven-1"]
        square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
        later = Feature("Polygon", square, {}, "later")
        own_world.publish_features(ProductKind.HAVENS, [later], version=1)
        assert [one["id"] for one in features(client, "havens")] == ["later"]


def listed(items, **more):
    return {"type": "array", "items": items, **more}


def record(required, **members):
    return {"type": "object", "required": required, "properties": members}


TEXT, WHOLE, NUMBER = {"type": "string"}, {"type": "integer", "minimum": 0}, {"type": "number"}
LINKS = listed(record(["href", "rel", "type"], href=TEXT, rel=TEXT, type=TEXT, title=TEXT))
PLACE = listed(NUMBER, minItems=2)
GEOMETRY = {
    "oneOf": [
        {"type": "null"},
        record(["type", "coordinates"], type={"const": "Point"}, coordinates=PLACE),
        record(
            ["type", "coordinates"],
            type={"const": "LineString"},
            coordinates=listed(PLACE, minItems=2),
        ),
        record(
            ["type", "coordinates"],
            type={"const": "Polygon"},
            coordinates=listed(listed(PLACE, minItems=4)),
        ),
    ]
}
FEATURE = record(
    ["type", "geometry", "properties"],
    type={"const": "Feature"},
    geometry=GEOMETRY,
    properties={"type": "object"},
    id=TEXT,
    links=LINKS,
)
EXTENT = record(
    ["spatial"],
    spatial=record(["bbox"], bbox=listed(listed(NUMBER, minItems=4, maxItems=4), minItems=1)),
    temporal=record(["interval"], interval=listed(listed(TEXT, minItems=2, maxItems=2))),
)
COLLECTION = record(
    ["id", "links"], id=TEXT, title=TEXT, links=LINKS, extent=EXTENT, crs=listed(TEXT, minItems=1)
)
DOCUMENTS = {
    "": record(["links"], title=TEXT, description=TEXT, links=LINKS),
    "/conformance": record(["conformsTo"], conformsTo=listed(TEXT, minItems=1)),
    "/collections": record(["links", "collections"], links=LINKS, collections=listed(COLLECTION)),
    "/collections/stops": COLLECTION,
    "/collections/images/items": record(
        ["type", "features", "links", "numberMatched", "numberReturned", "timeStamp"],
        type={"const": "FeatureCollection"},
        features=listed(FEATURE),
        links=LINKS,
        numberMatched=WHOLE,
        numberReturned=WHOLE,
        timeStamp=TEXT,
    ),
    "/collections/footprints/items": record(["features"], features=listed(FEATURE)),
    "/collections/stops/items/a": FEATURE,
}


@pytest.mark.parametrize("path", DOCUMENTS)
def test_documents_have_the_members_that_the_standard_requires(client, path):
    jsonschema.validate(get(client, path).json(), DOCUMENTS[path])


def test_errors_have_a_code_and_a_description(client):
    for path, status in (("/collections/none", 404), ("/collections/stops/items?limit=0", 400)):
        answer = client.get(f"/ogc/MER2{path}")
        assert answer.status_code == status
        jsonschema.validate(answer.json(), record(["code"], code=TEXT, description=TEXT))
