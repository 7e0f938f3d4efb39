"""What cannot be true of a rover's image is refused when its label is read."""

import pytest

from solmap.photogrammetry.archive.images.reading import read_image_record
from solmap.photogrammetry.errors import LabelError

NAME = "2n292280938effb100p0703l0m1.img"
OFFSET, TURN = "(1.0,2.0,-0.5)", "(0.994261,-0.095668,-0.0233068,0.0418276)"
CENTRE, VERTICAL = "(0.454993,0.141198,-1.23312)", "(50.6594,-19.3653,1294.76)"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("= 1869", "= 100001", "the sol should be from 0 to 100,000, but is 100001"),
        ("= 1869", f"= {'9' * 38}", r"the sol should be from 0 to 100,000, but is 1e\+38"),
        ("= 1869", "= -1", "the sol should be from 0"),
        ("292280938.496", "-5", "the spacecraft clock should be from 0 to 4,294,967,296"),
        ("292280938.496", "1e300", "the spacecraft clock should be"),
        ("(137,0,0,13,7)", "(137,9999999)", "the motion counter should be from 0 to 1,000,000"),
        (OFFSET, "(1e12,0,0)", "within 100,000 m of their reference site, but 1e\\+12 m are given"),
        (OFFSET, "(0,0,100001)", "within 100,000 m of their reference site"),
        (TURN, "(0,0,0,0)", "is not a unit quaternion: its length is 0"),
        (TURN, "(0.9,0,0,0)", "is not a unit quaternion: its length is 0.9"),
        (CENTRE, "(30,0,0)", "within 10 m of the rover's origin"),
        (VERTICAL, "(5e-8,-2e-8,1e-6)", "cannot belong to an image of 60 x 40 pixels"),
        (VERTICAL, "(5e8,-2e8,1e10)", "cannot belong to an image of 60 x 40 pixels"),
        ("78.801 <deg>", "1e9 <deg>", "the Sun's angles should be within one turn"),
        ('"p0703"', '"p\0"', "not a plain text of one line"),
    ],
)
def test_an_impossible_value_is_named(small, old, new, message):
    with pytest.raises(LabelError, match=message):
        read_image_record(small.but(old, new).data, NAME)


def test_values_at_the_limits_are_read(small):
    far = small.but(OFFSET, "(0,-99999.9,0)").but("= 1869", "= 100000")
    assert read_image_record(far.data, NAME).sol == 100_000


@pytest.mark.parametrize("stem", ["", ".", "-rf", "A\0", "\u202eX", "A" * 101, "A/..\\B\n", "É"])
def test_an_identifier_is_a_plain_word(small, stem):
    unnamed = small.but('"2N292280938EFFB100P0703L0M1"', '"x"')
    assert read_image_record(unnamed.data, "a (1).img").id == "A (1)"
    if stem not in {"", "."}:
        with pytest.raises(LabelError, match="the product identifier"):
            read_image_record(unnamed.data, f"{stem}.img")
