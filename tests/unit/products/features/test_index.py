"""The index of features: stored features are returned, and only the requested ones."""

import json
import sqlite3

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from solmap.products.features.index import Area, FeatureIndex, IndexedFeature, Selection

NOON = "2004-06-11T12:00:00.000Z"


def point(name, east, north, sol=1, **properties):
    shape = shapely.to_wkb(shapely.Point(east, north, 1.0))
    time = f"2004-06-{sol:02d}T12:00:00.000Z"
    return IndexedFeature(name, shape, json.dumps(properties), (sol, sol), (time, time))


def names(found):
    return [one.name for one in found]


@pytest.fixture
def index(tmp_path):
    made = FeatureIndex.open(tmp_path / "index" / "features.sqlite")
    made.put("a/1", "a", [point(f"a{k}", k, -k, sol=k + 1, even=k % 2 == 0) for k in range(10)])
    made.put("b/1", "b", [point(f"b{k}", 100 + k, k, sol=20) for k in range(5)])
    return made


def test_a_page_has_the_features_of_the_layers_in_order(index):
    selection = Selection(["a/1", "b/1"])
    assert index.count(selection) == 15
    assert names(index.page(selection, 3, offset=8)) == ["a8", "a9", "b0"]
    assert names(index.page(Selection(["b/1"]), 100)) == [f"b{k}" for k in range(5)]
    assert index.page(Selection([]), 100) == []


def test_a_feature_is_read_back_unchanged(index):
    requested = point("a3", 3, -3, sol=4, even=False)
    assert index.find(["a/1"], "a3") == requested
    assert index.find(["b/1"], "a3") is None


def test_the_extent_covers_place_and_time(index):
    extent = index.extent(["a/1", "b/1"])
    assert extent.count == 15
    assert extent.bounds == (0.0, -9.0, 104.0, 4.0)
    assert extent.times == ("2004-06-01T12:00:00.000Z", "2004-06-20T12:00:00.000Z")
    assert index.extent([]).bounds is None


def test_sols_times_and_properties_select(index):
    keys = ["a/1", "b/1"]
    assert names(index.page(Selection(keys, sols=(4, 5)), 9)) == ["a3", "a4"]
    assert names(index.page(Selection(keys, sols=(None, 1)), 9)) == ["a0"]
    assert index.count(Selection(keys, sols=(9, None))) == 7
    noon = "2004-06-03T12:00:00.000Z"
    assert names(index.page(Selection(keys, times=(noon, noon)), 9)) == ["a2"]
    assert index.count(Selection(keys, equal={"even": "1"})) == 5


def test_a_new_version_of_a_layer_replaces_the_old(index):
    index.put("a/2", "a", [point("new", 0, 0)])
    assert index.missing(["a/1", "a/2", "b/1"]) == ["a/1"]
    assert names(index.page(Selection(["a/2"]), 9)) == ["new"]
    assert index.count(Selection(["a/1"])) == 0
    near = Area.of_box((-1.0, -1.0, 1.0, 1.0))
    assert index.count(Selection(["a/2"], near)) == 1


def test_entries_of_another_process_are_kept(index):
    index.put("b/1", "b", [point("late", 0, 0)])
    assert index.extent(["b/1"]).count == 5


def test_a_feature_without_a_place_is_listed_without_extent(index):
    index.put("c", "c", [IndexedFeature("lost", None, "{}")])
    assert names(index.page(Selection(["c"]), 9)) == ["lost"]
    everywhere = Area.of_box((-1e9, -1e9, 1e9, 1e9))
    assert index.count(Selection(["c"], everywhere)) == 0
    assert index.extent(["c"]).bounds is None


def test_shapes_near_the_edge_are_tested_exactly(index):
    diagonal = IndexedFeature("line", shapely.to_wkb(shapely.LineString([(0, 0), (10, 10)])), "{}")
    index.put("d", "d", [diagonal])
    beside = Selection(["d"], Area.of_box((6.0, 1.0, 9.0, 4.0)))  # in its box, off the line
    across = Selection(["d"], Area.of_box((6.0, 1.0, 9.0, 7.0)))
    assert (index.count(beside), index.count(across)) == (0, 1)


def test_an_index_of_an_earlier_schema_is_rebuilt(index):
    with sqlite3.connect(index.path) as connection:
        connection.executescript("DROP TABLE boxes; PRAGMA user_version=1;")
    again = FeatureIndex.open(index.path)
    assert again.missing(["a/1"]) == ["a/1"]
    again.put("a/1", "a", [point("a0", 0, 0)])
    assert again.count(Selection(["a/1"], Area.of_box((-1.0, -1.0, 1.0, 1.0)))) == 1


def test_a_damaged_index_is_rebuilt(index, caplog):
    for file in index.path.parent.iterdir():
        file.write_bytes(b"no database" * 1000)
    again = FeatureIndex.open(index.path)
    assert again.missing(["a/1"]) == ["a/1"]
    assert "is damaged and rebuilt" in caplog.text


coordinates = st.floats(-5_000, 5_000, width=32)


@settings(max_examples=25)
@given(
    places=st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=30),
    corner=st.tuples(coordinates, coordinates),
    size=st.tuples(st.floats(0, 3_000), st.floats(0, 3_000)),
)
def test_an_area_selects_what_geometry_intersects(tmp_path_factory, places, corner, size):
    index = FeatureIndex.open(tmp_path_factory.mktemp("i") / "i.sqlite")
    index.put("k", "k", [point(str(k), *place) for k, place in enumerate(places)])
    box = (*corner, corner[0] + size[0], corner[1] + size[1])
    found = index.page(Selection(["k"], Area.of_box(box)), 100)
    there = np.array(places)
    inside = (there >= box[:2]).all(axis=1) & (there <= box[2:]).all(axis=1)
    assert names(found) == [str(k) for k in np.flatnonzero(inside)]
