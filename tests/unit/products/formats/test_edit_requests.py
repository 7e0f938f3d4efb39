"""Files of edit requests: what is read, and the message for each fault."""

import json

import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.manual.editing import EditAction, EditPoint, EditRequest
from solmap.products.formats.documents.edit_requests import parse_edit_requests

ONE, OTHER = "2N151760178EFF1000P1500L0M1", "2N151760814EFF1064P1501L0M1"
CSV = f"""action,first_image,first_sample,first_line,second_image,second_sample,second_line,note
add,{ONE},512.5,700,{OTHER},100,655.25,a bright rock
veto,{ONE},20,30,{OTHER},,,
move,{ONE},20,30,{OTHER.lower()},40,50,

veto,mer2-site0010-drive0000,,,mer2-site0010-drive0064,,,
"""


def geojson(*rows):
    features = [{"type": "Feature", "geometry": None, "properties": row} for row in rows]
    return json.dumps({"type": "FeatureCollection", "features": features})


def test_a_table_is_read_row_by_row():
    ties = parse_edit_requests(CSV, "x.ties.csv")
    assert [tie.action for tie in ties] == ["add", "veto", "move", "veto"]
    assert ties[0] == EditRequest(
        EditAction.ADD,
        EditPoint(ONE, (512.5, 700.0)),
        EditPoint(OTHER, (100.0, 655.25)),
        row="x.ties.csv, row 1",
    )
    assert ties[1].second == EditPoint(OTHER)
    assert ties[2].second.image == OTHER  # identifiers are upper case
    assert ties[3].first.is_stop
    assert ties[3].row == "x.ties.csv, row 5"


def test_geojson_and_table_give_the_same_edits():
    rows = [
        {
            "action": "add",
            "first_image": ONE,
            "first_sample": 512.5,
            "first_line": 700,
            "second_image": OTHER,
            "second_sample": 100,
            "second_line": 655.25,
        },
        {
            "action": "veto",
            "first_image": ONE,
            "first_sample": 20,
            "first_line": 30,
            "second_image": OTHER,
        },
    ]
    from_table = parse_edit_requests(CSV, "f")[:2]
    assert parse_edit_requests(geojson(*rows), "f") == from_table


def test_right_points_sigma_and_tolerance_are_read():
    row = {
        "action": "add",
        "first_image": ONE,
        "first_sample": 5,
        "first_line": 6,
        "first_right_sample": 1,
        "first_right_line": 6.5,
        "second_image": OTHER,
        "second_sample": 7,
        "second_line": 8,
        "sigma_px": 2,
        "tolerance_px": 9,
    }
    (tie,) = parse_edit_requests(geojson(row), "f")
    assert tie.first.right == (1.0, 6.5)
    assert (tie.sigma_px, tie.tolerance_px) == (2.0, 9.0)


def test_an_emptied_file_revokes_all_edit_requests():
    assert parse_edit_requests(CSV.splitlines()[0], "f") == ()
    assert parse_edit_requests(geojson(), "f") == ()


HEAD = "action,first_image,first_sample,first_line,second_image,second_sample,second_line\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "f: the first line should name the columns, of action, .* 'action' is missing"),
        ("image,x,y\n", "f: the first line should name the columns"),
        (HEAD + "join,A,1,2,B,3,4", "f, row 1: action should be add, veto or move, not 'join'"),
        (HEAD + "add,A,1,2,B,3,", "row 1: second_sample and second_line must be given together"),
        (HEAD + "add,A,1,2,B,,", "row 1: add needs second_image, second_sample and second_line"),
        (HEAD + "add,A,one,2,B,3,4", "row 1: first_sample should be a number, not 'one'"),
        (HEAD + "add,A,inf,2,B,3,4", "row 1: first_sample should be a number, not 'inf'"),
        (HEAD + "add,A,1,2,a,3,4", "row 1: both points are in A"),
        (HEAD + "\nadd,,1,2,B,3,4", "row 2: first_image is empty"),
        (HEAD + "veto,A,,,,,", "row 1: a veto needs a second image, or a point in the first"),
        (HEAD + "veto,A,,,B,3,4", "row 1: a veto with a point in the second image needs one"),
        (HEAD + "add,A,1,2,B,3,4,5", "row 1: 8 values for 7 columns"),
        (HEAD + "add,mer2-site0010-drive0000,1,2,B,3,4", "mer2-site0010-drive0000 is a stop"),
        (
            "action,colour\nveto,red",
            "f: the first line should name .*; 'colour' is not one of them",
        ),
        ('{"type": "FeatureCollection"}', "f: a FeatureCollection of features with properties"),
        (
            geojson({"action": "veto", "colour": 1}),
            "row 1: there is no column 'colour'; there are",
        ),
        ('{"features": [{"properties": null}]}', "f, row 1: a feature without properties"),
        ("{broken", "f: a FeatureCollection of features with properties"),
    ],
)
def test_every_fault_is_reported_in_one_line(text, message):
    with pytest.raises(MatchingError, match=message) as caught:
        parse_edit_requests(text, "f")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("wrong", [{"sigma_px": 0.0}, {"tolerance_px": -1.0}])
def test_a_sigma_or_tolerance_of_zero_is_refused(wrong):
    with pytest.raises(MatchingError, match="must be above zero"):
        EditRequest(EditAction.VETO, EditPoint("A", (1.0, 2.0)), EditPoint(""), **wrong)
