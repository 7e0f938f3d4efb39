import numpy as np
import pytest

from solmap.photogrammetry.archive.labels.label import (
    MAX_LABEL_BYTES,
    Quantity,
    label_text,
    parse_label,
)
from solmap.photogrammetry.errors import LabelError


def label(text: str):
    return parse_label(text + "\nEND\n", "x.img")


def test_scalars_are_numbers_texts_or_words():
    read = label(
        ' A = 12\n B = -1.5e-3 \n C = "some  text\n  over lines"\n D = WORD\n E = 2#0101#\n'
        " F = 2009-04-06T08:48:13.468\n G = 'symbol'\n H = \"174\"\n I = 16#FF#\n J = 1.5D2"
    )
    expected = {
        "A": 12,
        "B": -1.5e-3,
        "C": "some text over lines",
        "D": "WORD",
        "E": 5,
        "F": "2009-04-06T08:48:13.468",
        "G": "symbol",
        "H": "174",
        "I": 255,
        "J": 150.0,
    }
    assert dict(read.groups[""]) == expected


def test_lists_break_anywhere_and_keep_their_units():
    read = label(
        "A = (1.5 <rad>\n  ,2 <rad>,\n\n 3)\nB = {X, 'Y', \"Z\"}\nC = ((1,2),(3,4))\nD = ()"
    )
    assert read.get("", "A") == (Quantity(1.5, "rad"), Quantity(2, "rad"), 3)
    assert read.get("", "B") == ("X", "Y", "Z")
    assert read.get("", "C") == ((1, 2), (3, 4))
    assert read.get("", "D") == ()


def test_values_on_the_next_line_and_comments_are_read():
    read = label('/* head */ A /* name */ =\n      "021_001.dat" /* tail */\n B=3')
    assert read.get("", "A") == "021_001.dat"
    assert read.get("", "B") == 3


def test_unknown_values_are_none():
    read = label('A = "NULL"\nB = "N/A"\nC = UNK\nD = N/A')
    assert all(read.get("", key) is None for key in "ABCD")


def test_groups_are_found_with_and_without_parms_and_in_both_spellings():
    old = label("GROUP = ROVER_COORDINATE_SYSTEM\n A = 1\nEND_GROUP = ROVER_COORDINATE_SYSTEM")
    new = label("GROUP = ROVER_COORD_SYSTEM_PARMS\n A = 1\nEND_GROUP")
    for read in (old, new):
        assert read.require("ROVER_COORDINATE_SYSTEM", "A", int) == 1
        assert read.has_group("ROVER_COORDINATE_SYSTEM")
    assert new.get("ROVER_COORD_SYSTEM", "A") == 1


def test_a_namespace_is_dropped():
    assert label("MSL:RADIANCE_OFFSET = 0.5").require("", "RADIANCE_OFFSET", float) == 0.5


def test_nested_objects_are_read_separately():
    read = label(
        "OBJECT = FILE\n A = 1\n OBJECT = IMAGE\n LINES = 5\n END_OBJECT\nEND_OBJECT = FILE"
    )
    assert read.get("IMAGE", "LINES") == 5
    assert read.get("FILE", "A") == 1


def test_text_after_end_is_not_read():
    assert parse_label('A = 1\nEND\n"(=\0\xff', "x").get("", "A") == 1


def test_angles_are_radians_for_any_unit():
    read = label("A = 180 <deg>\nB = 3.0 <rad>\nC = 90")
    found = [read.optional_angle("", key) for key in "ABC"]
    np.testing.assert_allclose(found, [np.pi, 3.0, np.pi / 2])
    assert read.optional_angle("", "D") is None


def test_numbers_may_be_quoted_and_whole_numbers_written_as_reals():
    read = label('A = "174"\nB = 3.0\nC = 3.5')
    assert read.require("", "A", int) == 174
    assert read.require("", "B", int) == 3
    assert read.require("", "C", float) == 3.5
    assert read.require("", "A", str) == "174"
    with pytest.raises(LabelError, match=r"x\.img: C should be a whole number, but is '3.5'"):
        read.require("", "C", int)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("A = 1", "x.img: the label ends in line 1 without END"),
        ("", "x.img: the label ends in line 1 without END"),
        ("A = 1\n\nB 2\nEND", r"x.img: line 3 of the label: expected = after 'B'"),
        ("A = \n = 3\nEND", r"line 2 of the label: expected a value, found '='"),
        (
            'A = "never closed\nEND\n',
            "line 1 of the label: a quotation, unit or comment is not closed",
        ),
        ("A = 1\nB = (1, 2\nEND", "line 3|ends in line 3"),
        ("GROUP = G\nA = 1\nEND", "END came before the END_GROUP of G, opened in line 1"),
        ("GROUP = G\nEND_GROUP = H\nEND", "expected END_GROUP of G, opened in line 1, found"),
        ("GROUP = G\nEND_OBJECT = G\nEND", "expected END_GROUP of G"),
        ("END_GROUP = G\nEND", "END_GROUP without a beginning"),
        ("GROUP = 5\nEND", "GROUP needs a name"),
        ("= 5\nEND", "expected KEYWORD = value, found '='"),
        ("END = 5\n", "ends in line 2 without END"),
        ("(((\nEND", "expected KEYWORD = value"),
    ],
)
def test_a_broken_label_is_refused_with_its_line(text, message):
    with pytest.raises(LabelError, match=message):
        parse_label(text, "x.img")


def test_a_missing_keyword_is_named_with_its_group():
    read = label("GROUP = IMAGE\n LINES = many\n SAMPLES = NULL\nEND_GROUP")
    with pytest.raises(LabelError, match=r"x\.img: IMAGE/BANDS is missing from the label"):
        read.require("IMAGE", "BANDS", int)
    with pytest.raises(LabelError, match="IMAGE/LINES should be a whole number, but is 'many'"):
        read.require("IMAGE", "LINES", int)
    with pytest.raises(LabelError, match="SAMPLES should be a whole number, but is an unknown"):
        read.require("IMAGE", "SAMPLES", int)
    with pytest.raises(LabelError, match=r"x\.img: the label has no group CAMERA"):
        read.require("CAMERA", "MODEL_TYPE", str)
    with pytest.raises(LabelError, match="IMAGE/LINES should be 3 numbers"):
        read.require_numbers("IMAGE", "LINES", 3)
    with pytest.raises(LabelError, match="IMAGE/LINES should be a number"):
        read.require_numbers("IMAGE", "LINES")


@pytest.mark.parametrize("opening", ["(", "GROUP=A ", "{"])
def test_depth_is_bounded(opening):
    with pytest.raises(LabelError, match="nested deeper than 16"):
        parse_label("A = " + opening * 10_000 if opening in "({" else opening * 10_000, "x.img")


@pytest.mark.parametrize(
    "text",
    [
        "A = (" + "1," * 500_000,
        "A = 1\n" * 170_000,
        '"' * 1_000_000,
        "/*" * 500_000,
        "A = " + "9" * 1_000_000,
        "A = 1 <" * 140_000,
        "A=((((" * 170_000,
        " " * 1_000_000,
    ],
)
def test_a_megabyte_of_nonsense_is_refused_quickly(text):
    with pytest.raises(LabelError):
        parse_label(text, "x.img")


def test_only_the_first_megabyte_is_read():
    assert len(label_text(b"\xff" * (MAX_LABEL_BYTES + 5))) == MAX_LABEL_BYTES
