import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.archive.file_names import (
    camera_string,
    decode_counter,
    encode_counter,
    parse_file_name,
)
from solmap.photogrammetry.errors import LabelError


def test_file_names_are_decoded_as_in_the_facts(test_vectors):
    for row in test_vectors["file_names"]:
        found = parse_file_name(f"data/sol1869/edr/{row['name'].lower()}.img")
        assert found.product_id == row["name"]
        assert found.mission == row["spacecraft"]
        assert found.instrument == row["instrument"]
        assert found.clock == row["sclk"]
        assert found.product_type == row["product_type"]
        assert (found.site, found.drive) == (row["site"], row["drive"])
        assert found.sequence == row["sequence"]
        assert (found.eye, found.filter_number) == (row["eye"], row["filter"])
        assert (found.producer, found.version) == (row["producer"], str(row["version"]))


def test_the_sol_of_a_name_equals_that_of_the_facts():
    """sol = floor((clock - e) / 88775.42064), e = 126322960 for Spirit."""
    first = math.ceil(126_322_960 + 1869 * 88_775.42064)
    found = [parse_file_name(f"2N{clock}EFFB100P0703L0M1").sol for clock in (first - 1, first)]
    assert found == [1868, 1869]


def test_codes_of_site_and_drive_equal_those_of_the_facts(test_vectors):
    for row in test_vectors["site_drive_codes"]:
        assert decode_counter(row["code"]) == row["value"]
        assert encode_counter(row["value"]) == row["code"]


@given(st.integers(0, 1295))
def test_every_code_is_decoded_back(counter):
    assert decode_counter(encode_counter(counter)) == counter


def test_a_counter_beyond_the_code_is_read_from_the_label():
    found = parse_file_name("1f211278125idl75__p1151l0m1.im")
    assert (found.site, found.drive) == (75, None)
    assert encode_counter(1296) == "##"
    assert decode_counter("##") is None


def test_names_of_curiosity_are_read():
    found = parse_file_name("NLB_517261274EDR_F0541610CCAM15900M1.IMG")
    assert (found.mission, found.instrument, found.eye) == ("MSL", "NAVCAM", "L")
    assert (found.clock, found.product_type) == (517261274, "EDR")
    assert (found.site, found.drive, found.sequence) == (54, 1610, "ccam15900")


def test_names_distinguish_the_two_camera_sets_of_curiosity():
    names = ("NLA_399620372ARMLD0030266TRAV00004M1", "NLB_517261274EDR_F0541610CCAM15900M1")
    assert [camera_string(name) for name in names] == ["A", "B"]
    assert not camera_string("2N292280938EFFB100P0703L0M1")


@pytest.mark.parametrize("name", ["", "notes.img", "5N292280938EFFB100P0703L0M1.IMG", "a" * 500])
def test_another_name_is_refused(name):
    with pytest.raises(LabelError, match="matches no known pattern"):
        parse_file_name(name)


@pytest.mark.parametrize("code", ["", "A", "#1", "AAA", "é0"])
def test_another_code_is_refused(code):
    with pytest.raises(LabelError, match="is not a site or drive code"):
        decode_counter(code)


def test_a_negative_counter_has_no_code():
    with pytest.raises(LabelError, match="must not be negative"):
        encode_counter(-1)


def test_names_of_mars_2020_are_decoded():
    name = parse_file_name("ids/edr/NLF_0629_0722782785_631ECM_N0301344NCAM00427_06_095J01.IMG")
    assert (name.mission, name.instrument, name.eye) == ("M20", "NAVCAM", "L")
    assert (name.clock, name.product_type, name.site, name.drive) == (722782785, "ECM", 30, 1344)
    assert (name.sequence, name.producer, name.version) == ("ncam00427", "J", "01")
    zoom = parse_file_name("zr3_0709_0729888971_069rad_n0332864zcam07114_0340lma01.img")
    assert (zoom.instrument, zoom.eye, zoom.filter_number) == ("MASTCAM", "R", 3)
    far = parse_file_name("FLF_1629_0722782785_631ECM_NA001344HAZ_00427_0A00LLJ02.IMG")
    assert (far.site, far.drive) == (None, 1344)
