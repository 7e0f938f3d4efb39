"""Control that a person measured is read from CSV and GeoJSON, or refused with row and reason."""

import json

import pytest

from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId
from solmap.products.formats.documents.control_files import parse_control

HEAD = "stop,east_m,north_m,sigma_m"


def test_a_table_in_metres():
    text = f"{HEAD},azimuth_deg,sigma_azimuth_deg\n10/64,18.0,12.5,0.3,50,0.5\n\n10/70,1,2,3,,\n"
    first, second = parse_control(text, "MER2", "by_hand.csv")
    assert first.stop == StopId("MER2", 10, 64)
    assert (first.place, first.in_degrees, first.sigma_m) == ((18.0, 12.5), False, 0.3)
    assert first.azimuth == (50.0, 0.5)
    assert second.azimuth is None


def test_points_in_degrees_of_mars():
    document = {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": [175.48, -14.57]},
                "properties": {"stop": "mer2-site0010-drive0064", "sigma_m": 0.5,
                               "map_east_m": 20.0, "map_north_m": 10.0, "note": "the rim"},
            }
        ],
    }  # fmt: skip
    (row,) = parse_control(json.dumps(document), "MER2", "rim.geojson")
    assert (row.place, row.in_degrees) == ((175.48, -14.57), True)
    assert row.map_point == (20.0, 10.0)


def test_an_emptied_file_holds_nothing():
    assert parse_control("\n", "MER2", "by_hand.csv") == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "stop,x,y\n10/64,1,2",
            "by_hand.csv: the first line should name .* 'x' is not one of them",
        ),
        ("east_m,north_m\n1,2", "'stop' is missing"),
        (f"{HEAD}\n10/64,1,2", "row 1: 3 values for 4 columns"),
        (f"{HEAD}\n10/64,1,2,0.1\nsol 5,1,2,1", "row 2: 'sol 5' is not a stop.*10/64 is expected"),
        (f"{HEAD}\n10/64,here,2,1", "row 1: east_m should be a number, not 'here'"),
        (f"{HEAD}\n10/64,1,2,0", "sigma_m must be above zero, not 0"),
        (
            f"{HEAD}\n10/64,1,2,",
            "sigma_m, the standard deviation of the position in metres, is missing",
        ),
        (f"{HEAD}\n10/64,1,,1", "east_m and north_m must be given together"),
        (f"{HEAD},longitude,latitude\n10/64,1,2,1,175,-14", "as longitude and latitude, or as"),
        (f"{HEAD}\n10/64,nan,2,1", "east_m should be finite"),
        (
            '{"features": [{"properties": {}, "geometry": {"type": "LineString"}}]}',
            "row 1: a Point is expected as geometry",
        ),
        ('{"features": 3}', "a FeatureCollection of points is expected"),
    ],
)
def test_every_fault_is_reported_with_its_row(text, message):
    with pytest.raises(AdjustmentError, match=message):
        parse_control(text, "MER2", "by_hand.csv")
