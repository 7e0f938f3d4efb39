import json
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import geopandas
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS

from solmap.products.crs import IAU_RADIUS_M, MARS, LandingPoint, local_crs, lon_lat
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.features import texts
from solmap.products.features.texts import feature_texts
from solmap.products.formats.vector.geojson import (
    Feature,
    FeatureCollection,
    read_features,
    read_placed,
    write_features,
)
from solmap.products.formats.vector.geopackage import write_geopackage

GUSEV = LandingPoint("floor of Gusev", 175.4729, -14.5692, 3_393_000.0, "a test")
ON_IAU = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, IAU_RADIUS_M, "a test")
FEATURES = [
    Feature("Point", np.array([[3104.65, -2034.05, 80.97]]), {"site": 138, "held": False}, "p"),
    Feature("LineString", np.array([[0.0, 0.0], [10.0, 5.0], [20.0, 5.0]]), {"elevation_m": 1.5}),
    Feature("Polygon", np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 0.0]])),
]


def test_written_features_are_read_back_in_metres(tmp_path):
    write_features(tmp_path / "f.geojson", FEATURES, GUSEV, tags={"interval_m": 0.5})
    read = read_features(tmp_path / "f.geojson")
    assert read.landing == GUSEV
    assert read.tags == {"interval_m": 0.5}
    for there, here in zip(read.features, FEATURES, strict=True):
        assert (there.geometry, there.id, there.properties) == (
            here.geometry,
            here.id,
            here.properties,
        )
        np.testing.assert_allclose(there.points, here.points, atol=1.1e-4)  # 4 decimals kept


def test_features_of_an_untied_map_are_in_its_metres_and_gdal_reads_its_name(tmp_path):
    landing = GUSEV.untied("site 137")
    write_features(tmp_path / "f.geojson", FEATURES, landing)
    frame = geopandas.read_file(tmp_path / "f.geojson")
    assert CRS(frame.crs).name == "origin: site 137, not tied to the lander (east, north)"
    point = frame.geometry.iloc[0]
    assert (point.x, point.y, point.z) == (3104.65, -2034.05, 80.97)
    read = read_features(tmp_path / "f.geojson")
    assert read.landing == landing
    np.testing.assert_array_equal(read.features[0].points, FEATURES[0].points)
    write_geopackage(tmp_path / "f.gpkg", FeatureCollection(landing, (FEATURES[0],)), "points")
    assert geopandas.read_file(tmp_path / "f.gpkg").crs.name == CRS(frame.crs).name


@pytest.mark.parametrize("landing", [GUSEV, ON_IAU])
def test_gdal_reads_the_file_as_mars_and_transforms_it_to_the_local_map(tmp_path, landing):
    write_features(tmp_path / "f.geojson", FEATURES, landing)
    frame = geopandas.read_file(tmp_path / "f.geojson")
    assert CRS(frame.crs).equals(CRS(MARS), ignore_axis_order=True)
    point = frame.to_crs(local_crs(landing)).geometry.iloc[0]
    assert (point.x, point.y, point.z) == pytest.approx((3104.65, -2034.05, 80.97), abs=1e-4)


def test_the_file_has_degrees_of_mars_and_names_the_crs(tmp_path):
    write_features(tmp_path / "f.geojson", FEATURES, GUSEV)
    document = json.loads((tmp_path / "f.geojson").read_text())
    assert document["crs"]["properties"]["name"] == "urn:ogc:def:crs:IAU:2015:49900"
    longitude, latitude, height = document["features"][0]["geometry"]["coordinates"]
    expected = np.concatenate(lon_lat(GUSEV, 3104.65, -2034.05))
    assert (longitude, latitude) == pytest.approx(tuple(expected), abs=1e-9)
    assert height == 80.97
    assert "metres above the tangent plane" in document["solmap"]["elevation"]


def test_the_same_features_are_written_as_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_features(tmp_path / name, FEATURES, GUSEV)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_ring_is_closed_in_the_file_and_open_in_the_record(tmp_path):
    write_features(tmp_path / "f.geojson", FEATURES[2:], GUSEV)
    document = json.loads((tmp_path / "f.geojson").read_text())
    (ring,) = document["features"][0]["geometry"]["coordinates"]
    assert len(ring) == 4
    assert ring[0] == ring[-1]
    assert read_features(tmp_path / "f.geojson").features[0].points.shape == (3, 2)


@given(
    st.lists(
        st.tuples(st.floats(-9e3, 9e3), st.floats(-9e3, 9e3), st.floats(-500, 500)),
        min_size=2,
        max_size=9,
    )
)
def test_texts_in_local_metres_have_points_to_a_tenth_of_a_millimetre(points):
    line = Feature("LineString", np.array(points))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "f.geojson"
        write_features(path, [line], GUSEV)
        document = json.loads(feature_texts(path).collection())
    coordinates = np.array(document["features"][0]["geometry"]["coordinates"])
    # in degrees and back; PROJ takes what lies within 1e-10 radii of the origin for the origin
    at_origin = np.hypot(line.points[:, 0], line.points[:, 1]) < 1e-10 * GUSEV.radius_m
    np.testing.assert_allclose(coordinates[~at_origin], line.points[~at_origin], atol=1.1e-4)
    np.testing.assert_allclose(coordinates[at_origin], line.points[at_origin], atol=4e-4)


def test_texts_are_selected_by_a_box_or_by_names(tmp_path):
    far = Feature("Point", np.array([[500.0, 0.0]]), {"n": 1}, "far")
    near = [Feature("Point", np.array([[k, 0.0]]), {"n": k}, f"near-{k}") for k in range(3)]
    write_features(tmp_path / "f.geojson", [far, *near], GUSEV)
    texts = feature_texts(tmp_path / "f.geojson")
    assert texts.within((-1.0, -1.0, 1.5, 1.0)) == [1, 2]
    assert texts.find(["far", "nothing", "near-2"]) == [0, 3]
    some = json.loads(texts.collection([3, 0]))["features"]
    assert [(one["id"], one["properties"]) for one in some] == [
        ("near-2", {"n": 2}),
        ("far", {"n": 1}),
    ]
    assert len(json.loads(texts.collection())["features"]) == 4


def test_no_features_are_an_empty_collection(tmp_path):
    write_features(tmp_path / "f.geojson", [], GUSEV)
    read = read_features(tmp_path / "f.geojson")
    assert read.features == ()
    assert read_placed(tmp_path / "f.geojson").bounds is None


def test_the_bounds_include_all_points(tmp_path):
    write_features(tmp_path / "f.geojson", FEATURES, GUSEV)
    expected = (0.0, -2034.05, 3104.65, 10.0)
    assert read_placed(tmp_path / "f.geojson").bounds == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("geometry", "points", "message_"),
    [
        ("Point", [[0.0, 0.0], [1.0, 1.0]], "a Point has one row"),
        ("LineString", [[0.0, 0.0]], "at least 2 rows"),
        ("Polygon", [[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]], "at least 3 rows"),
        ("Point", [[0.0, np.nan]], "not all finite"),
        ("Circle", [[0.0, 0.0]], "'Circle' is not one of"),
        ("Point", [[0.0, 0.0, 0.0, 0.0]], r"not \(1, 4\)"),
    ],
)
def test_a_feature_that_cannot_be_drawn_is_refused_on_creation(geometry, points, message_):
    with pytest.raises(ProductError, match=message_):
        Feature(geometry, np.array(points))


def test_a_property_that_is_not_json_is_refused(tmp_path):
    feature = Feature("Point", np.zeros((1, 2)), {"sigma_m": float("nan")})
    with pytest.raises(ProductError, match=r"f\.geojson: a property is not a plain JSON"):
        write_features(tmp_path / "f.geojson", [feature], GUSEV)
    assert not (tmp_path / "f.geojson").exists()


def test_a_missing_and_a_foreign_file_are_distinguished(tmp_path):
    with pytest.raises(ProductNotFoundError, match="does not exist"):
        read_features(tmp_path / "f.geojson")
    (tmp_path / "g.geojson").write_text('{"type": "FeatureCollection", "features": []}')
    with pytest.raises(ProductError, match="not a feature collection of a landing site"):
        read_features(tmp_path / "g.geojson")


SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0], [0.0, 0.0]])


def test_holes_of_polygons_are_kept(tmp_path):
    whole = Feature("Polygon", SQUARE, {"area_m2": 96.0}, holes=[SQUARE / 5 + 2.0])
    write_features(tmp_path / "f.geojson", [whole, *FEATURES], GUSEV)
    assert geopandas.read_file(tmp_path / "f.geojson").to_crs(local_crs(GUSEV)).area.iloc[
        0
    ] == pytest.approx(96.0, abs=1e-3)
    read = read_features(tmp_path / "f.geojson")
    (hole,) = read.features[0].holes
    np.testing.assert_allclose(hole, SQUARE[:-1] / 5 + 2.0, atol=1.1e-4)
    assert [len(feature.holes) for feature in read.features[1:]] == [0, 0, 0]
    drawn = json.loads(feature_texts(tmp_path / "f.geojson").collection())["features"]
    drawn = drawn[0]["geometry"]["coordinates"]
    assert [ring[0] == ring[-1] for ring in drawn] == [True, True]


@pytest.mark.parametrize(
    ("geometry", "holes", "message"),
    [
        ("LineString", [SQUARE], "a LineString cannot have holes"),
        ("Polygon", [SQUARE[:2]], "holes must be rings of 2 columns"),
        ("Polygon", [np.column_stack([SQUARE, SQUARE[:, 0]])], "holes must be rings of 2 columns"),
    ],
)
def test_invalid_holes_are_refused(geometry, holes, message):
    with pytest.raises(ProductError, match=message):
        Feature(geometry, SQUARE, holes=holes)


def test_a_geopackage_has_contours_in_metres_with_their_elevation(tmp_path):
    lines = [
        Feature(
            "LineString",
            np.array([[0.0, 0.0, up], [10.0, 5.0, up]]),
            {"elevation_m": up, "is_index": up == 2.0, "sols": [156], "note": None},
        )
        for up in (1.5, 2.0)
    ]
    write_geopackage(tmp_path / "f.gpkg", FeatureCollection(GUSEV, tuple(lines)), "contours")
    read = geopandas.read_file(tmp_path / "f.gpkg", layer="contours")
    assert read.elevation_m.tolist() == [1.5, 2.0]
    assert read.is_index.tolist() == [False, True]
    assert [json.loads(value) for value in read.sols] == [[156], [156]]
    assert list(read.geometry.iloc[1].coords) == [(0.0, 0.0, 2.0), (10.0, 5.0, 2.0)]
    crs = CRS(read.crs)
    assert crs.ellipsoid.semi_major_metre == GUSEV.radius_m
    assert crs.coordinate_operation.method_name == "Orthographic"


def test_a_geopackage_of_mixed_features_or_none_is_refused(tmp_path):
    for features in (FEATURES, ()):
        with pytest.raises(ProductError, match="features of one geometry"):
            write_geopackage(tmp_path / "f.gpkg", FeatureCollection(GUSEV, tuple(features)), "x")


def test_a_file_is_read_once_for_concurrent_requests(tmp_path, monkeypatch):
    write_features(tmp_path / "f.geojson", FEATURES, GUSEV)
    reads = []
    read_placed = texts.read_placed

    def slowly(path):
        reads.append(path)
        time.sleep(0.2)
        return read_placed(path)

    monkeypatch.setattr(texts, "read_placed", slowly)
    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(feature_texts, [tmp_path / "f.geojson"] * 6))
    assert len(reads) == 1
    assert all(one is found[0] for one in found)
