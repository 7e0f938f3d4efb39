import json

import numpy as np
import pytest

from solmap.photogrammetry.errors import TraverseError
from solmap.photogrammetry.traverse.sources import Equirectangular, parse_mission_table

HEAD = "SITE,DRIVE,START_SOL,END_SOL,RAW_X,RAW_Y,RAW_Z,CORRECTED_X,CORRECTED_Y\n"
ROWS = (
    "0,0,1,1,0.0,-0.06,0.0,-1432.26,-863385.06\n"
    "0,0,1,1,0.0,-0.06,0.0,-1432.26,-863385.06\n"
    "1,10,3,4,5.5,2.0,-0.4,-1426.0,-863383.0\n"
    "1,10,5,9,5.5,2.0,-0.4,-1426.0,-863383.0\n"
)


def test_a_stop_in_several_rows_is_one_stop_on_its_first_sol():
    table = parse_mission_table(HEAD + ROWS, "path.csv")
    assert table.stops == ("0/0", "1/10")
    assert table.sols.tolist() == [1, 3]
    np.testing.assert_allclose(table.telemetry().places_m, [[0, -0.06, 0], [5.5, 2.0, -0.4]])
    assert table.notes == ("2 rows of 4 repeat a stop",)


def test_corrected_places_are_degrees_of_mars_in_true_metres():
    table = parse_mission_table(HEAD + ROWS, "path.csv")
    radius_m, latitude = 3396190.0, np.radians(table.localised_deg[0, 1])
    assert table.localised_deg[0] == pytest.approx([175.4758369, -14.5658282], abs=1e-7)
    east = np.radians(np.diff(table.localised_deg[:, 0])[0]) * radius_m * np.cos(latitude)
    assert east == pytest.approx(6.26 * np.cos(latitude), abs=1e-3)  # not 6.26 m
    other = parse_mission_table(HEAD + ROWS, "path.csv", Equirectangular(0.0))
    assert other.localised_deg[0, 0] == pytest.approx(table.localised_deg[0, 0] - 175.5)


def test_tabs_with_decimal_commas_are_read_the_same():
    tabs = (HEAD + ROWS).replace(",", "\t").replace(".", ",")
    plain, tabbed = (parse_mission_table(text, "path") for text in (HEAD + ROWS, tabs))
    np.testing.assert_array_equal(plain.telemetry_m, tabbed.telemetry_m)
    np.testing.assert_array_equal(plain.localised_deg, tabbed.localised_deg)


def test_a_header_with_another_separator_than_its_rows_is_read():
    text = "latitude\tlongitude,rmcSite,rmcDrive,firstSol\n-14.5,175.4,1,0,2\n"
    table = parse_mission_table(text, "sites.csv")
    np.testing.assert_allclose(table.localised_deg, [[175.4, -14.5]])
    with pytest.raises(TraverseError, match="contains no telemetry"):
        table.telemetry()


def test_geojson_with_an_earth_crs_is_read_as_mars_with_a_note():
    document = {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": "EPSG:4326"}},
        "features": [
            {
                "geometry": {"type": "Point", "coordinates": [175.4758, -14.5658]},
                "properties": {"rmcSite": 3, "rmcDrive": 7, "firstSol": 20},
            }
        ],
    }
    table = parse_mission_table(json.dumps(document), "sites.geojson")
    assert (table.stops, table.sols.tolist()) == (("3/7",), [20])
    assert "degrees are those of Mars" in table.notes[0]


def test_elevations_that_are_all_zero_are_missing():
    table = parse_mission_table(HEAD + "0,0,1,1,0,0,0,1,1\n1,0,2,2,5,5,0,6,6\n", "path.csv")
    assert np.isnan(table.telemetry_m[:, 2]).all()


def test_a_stop_with_rows_at_two_places_is_reported():
    table = parse_mission_table(HEAD + "0,0,1,1,0,0,1,1,1\n0,0,2,2,5,5,1,6,6\n", "path.csv")
    assert any("several positions" in note and "0/0" in note for note in table.notes)
    np.testing.assert_allclose(table.telemetry_m, [[0, 0, 1]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no row"),
        ("time,place\n1,2\n", "lacks SITE and DRIVE"),
        (HEAD + "0,0,1,1,0,0\n", "line 2 has 6 fields"),
        (HEAD + "0,0,1,1,x,0,0,1,1\n", "line 2: raw_x"),
        (HEAD + "0,0,1,1,nan,0,0,1,1\n", "line 2: raw_x"),
        (HEAD + "a,0,1,1,0,0,0,1,1\n", "site should be a whole number"),
        ("SITE,DRIVE,START_SOL\n1,2,3\n", "neither RAW_X"),
        ('{"features": [{"geometry": null}]}', "not a GeoJSON"),
        ('{"features": 5}', "not a GeoJSON"),
        ("{", "not a GeoJSON"),
    ],
)
def test_an_invalid_table_is_refused_with_the_place_of_the_fault(text, message):
    with pytest.raises(TraverseError, match=message):
        parse_mission_table(text, "table")


def test_the_whole_traverse_of_spirit_is_read(shared_data):
    folder = shared_data / "traverse" / "mer_spirit"
    name = "MERA-MER2-Spirit_traverse_path.csv"
    table = parse_mission_table((folder / name).read_text(), name)
    assert len(table.stops) == 8528
    assert "276 rows of 8804 repeat a stop" in table.notes
    assert table.telemetry().length_m == pytest.approx(7279, abs=1)  # the data's README
    for other in ("sites.csv", "sites.tsv", "sites.geojson", "drives.tsv", "drives.geojson"):
        sites = parse_mission_table((folder / other).read_text(), other)
        here = dict(zip(table.stops, table.localised_deg, strict=True))
        apart_deg = [
            np.abs(place - here[stop]).max()
            for stop, place in zip(sites.stops, sites.localised_deg, strict=True)
            if stop in here
        ]
        assert np.median(apart_deg) < 1e-9, other
