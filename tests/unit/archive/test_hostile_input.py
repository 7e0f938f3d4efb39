"""Whatever is thrown at the readers, they answer with their own errors and stay bounded."""

import random

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from solmap.photogrammetry.archive.images.reading import read_image, read_image_record
from solmap.photogrammetry.archive.labels.label import parse_label
from solmap.photogrammetry.archive.labels.vicar import parse_vicar_label
from solmap.photogrammetry.archive.tables.vector_files import best_poses, parse_vector_file
from solmap.photogrammetry.errors import LabelError, PixelError, VectorFileError

NAME = "2n292280938effb100p0703l0m1.img"
FEW = settings(
    max_examples=80,
    deadline=10_000,  # milliseconds; some 10 each, types checked at every call on a busy machine
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

WORDS = """
A = GROUP END_GROUP OBJECT END_OBJECT END ( ) { } , " ' <deg> < > /* */ 1 -1.5e3 1e999 2#01# 9#9# ^
NULL "N/A" MSL: IMAGE 0x nan inf == \xff
"""
PIECES = st.sampled_from([*WORDS.split(), "\n", "\r\n", " ", "\0"])
NUMBERS = ["-1", "0", "1e999", "NULL", "(1,2)", '"x"', "99999999999999999999", "1e-320", "nan"]


def own_errors_only(read, *arguments):
    """Call a reader; anything but one of our errors is a failure of the test."""
    try:
        read(*arguments)
        message = "fine"
    except (LabelError, PixelError, VectorFileError) as error:
        message = str(error)
    assert message
    assert "\n" not in message


@FEW
@given(st.lists(PIECES, max_size=200).map("".join))
@example("A=(" * 500)
@example("GROUP=A END_GROUP=A END")
def test_any_arrangement_of_label_words_is_a_label_or_refused(text):
    own_errors_only(parse_label, text, "x.img")


@FEW
@given(st.text(max_size=500))
def test_any_text_is_a_label_or_refused(text):
    own_errors_only(parse_label, text, "x.img")


@FEW
@given(st.binary(max_size=500))
def test_any_bytes_are_an_image_or_refused(data):
    own_errors_only(read_image, data, NAME)
    own_errors_only(read_image, b"PDS_VERSION_ID = PDS3\n" + data, NAME)
    own_errors_only(read_image, b"LBLSIZE=" + data, NAME)
    own_errors_only(parse_vicar_label, b"LBLSIZE=100 FORMAT='BYTE' " + data.ljust(80), NAME)


@FEW
@given(seed=st.integers(0, 2**32), changes=st.integers(1, 20))
def test_a_real_label_with_bytes_changed_is_an_image_or_refused(small, seed, changes):
    chance = random.Random(seed)  # noqa: S311 - no secrets
    data = bytearray(small.data)
    for _ in range(changes):
        data[chance.randrange(len(data))] = chance.randrange(256)
    own_errors_only(read_image, bytes(data), NAME)


@FEW
@given(seed=st.integers(0, 2**32))
def test_a_real_label_with_values_exchanged_is_an_image_or_refused(small, seed):
    chance = random.Random(seed)  # noqa: S311 - no secrets
    lines = small.label.splitlines()
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(lines))
        other = lines[chance.randrange(len(lines))].partition("=")[2]
        value = chance.choice([*NUMBERS, other])
        lines[at] = f"{lines[at].partition('=')[0]}= {value}"
    data = "\n".join(lines).encode().ljust(4096) + small.data[4096:]
    own_errors_only(read_image, data, NAME)
    own_errors_only(read_image_record, data, NAME)


@FEW
@given(cut=st.integers(0, 9000))
def test_a_file_cut_off_anywhere_is_an_image_or_refused(small, cut):
    own_errors_only(read_image, small.data[:cut], NAME)


VECTOR_FILE = """<?xml version="1.0"?>
<rmc_file mission="MER2" variant="x"><priority><entry solution_id="telemetry"/></priority>
<solution solution_id="telemetry" name="ROVER_FRAME" index1="10" index2="64">
<reference_frame name="SITE_FRAME" index1="10"/>
<offset x="1" y="2" z="3"/><orientation s="1" v1="0" v2="0" v3="0"/></solution></rmc_file>
"""


def read_vector_file(text):
    best_poses([parse_vector_file(text, "x.rvf")])


@FEW
@given(seed=st.integers(0, 2**32), changes=st.integers(1, 10))
def test_a_vector_file_with_characters_changed_is_read_or_refused(seed, changes):
    chance = random.Random(seed)  # noqa: S311 - no secrets
    text = list(VECTOR_FILE)
    for _ in range(changes):
        text[chance.randrange(len(text))] = chance.choice("<>\"'/=&;1-eE.\0\n!é x")
    own_errors_only(read_vector_file, "".join(text))


@FEW
@given(st.text(max_size=300))
def test_any_text_is_a_vector_file_or_refused(text):
    own_errors_only(read_vector_file, text)
    own_errors_only(read_vector_file, f"<rmc_file mission='M'>{text}</rmc_file>")


def test_a_billion_laughs_are_refused_before_expansion():
    laughs = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10))
    bomb = f'<!DOCTYPE rmc_file [<!ENTITY l0 "ha">{laughs}]><rmc_file>&l9;</rmc_file>'
    with pytest.raises(VectorFileError, match="<!DOCTYPE is not allowed"):
        parse_vector_file(bomb, "x.svf")


def test_a_hundred_thousand_nested_elements_are_refused():
    with pytest.raises(VectorFileError):
        parse_vector_file("<rmc_file mission='M'>" + "<a>" * 100_000, "x.svf")
    with pytest.raises(VectorFileError, match="nested deeper than 32"):
        parse_vector_file(
            "<rmc_file mission='M'>" + "<a>" * 100_000 + "</a>" * 100_000 + "</rmc_file>", "x.svf"
        )


def test_unclosed_elements_are_refused_quickly():
    """Each of these took minutes once: comments were sought to the end, quotes in 2^n ways."""
    with pytest.raises(LabelError, match="comment is not closed"):
        parse_label("PDS_VERSION_ID=PDS3 A=(" + "/* " * 300_000, "x.img")
    with pytest.raises(LabelError, match="expected KEY=value"):
        parse_vicar_label(b"LBLSIZE=100000 FORMAT='BYTE' A=(" + b"''" * 50_000, "x.img")
