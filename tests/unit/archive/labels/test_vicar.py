from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.archive.images.pixels import read_pixels
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.archive.labels.label import Quantity
from solmap.photogrammetry.archive.labels.vicar import parse_vicar_label, vicar_label_end
from solmap.photogrammetry.errors import LabelError, PixelError

TEXT = (
    "LBLSIZE=1024  FORMAT='HALF'  TYPE='IMAGE'  RECSIZE=40  ORG='BSQ'  NL=10  NS=20  NB=1  NBB=0 "
    "NLB=2  INTFMT='HIGH'  REALFMT='RIEEE'  PROPERTY='IDENTIFICATION'  FRAME_ID='LEFT'  "
    "OBSERVATION_ID='UNK'  NOTE='it''s (fine)'  ROVER_MOTION_COUNTER=(76,664,103)  "
    "PROPERTY='GEOMETRIC_CAMERA_MODEL'  MODEL_DESC__PTR='GEOMETRIC_CM.TXT' "
    "MODEL_COMPONENT_ID=('C','A') MODEL_COMPONENT_1=(0.357562,0.173905,-1.20369) "
    "PROPERTY='SITE_DERIVED_GEOMETRY_PARMS' SOLAR_ELEVATION=78.801 SOLAR_ELEVATION__UNIT='deg' "
    "ANGLES=(1.0,2.0) ANGLES__UNIT=('rad','rad') TASK='X' USER='me' DAT_TIM='Fri Sep 11' "
)


def file_of(text: str, pixels: bytes = b"") -> bytes:
    return text.encode().ljust(1024, b"\0") + bytes(80) + pixels


def test_properties_become_groups():
    label = parse_vicar_label(b"some head " + file_of(TEXT), "x.vic")
    assert label.get("", "FRAME_ID") == "LEFT"
    assert label.get("", "OBSERVATION_ID") is None
    assert label.get("", "NOTE") == "it's (fine)"
    assert label.get("", "ROVER_MOTION_COUNTER") == (76, 664, 103)
    assert label.get("GEOMETRIC_CAMERA_MODEL", "^MODEL_DESC") == "GEOMETRIC_CM.TXT"
    assert label.get("GEOMETRIC_CAMERA_MODEL", "MODEL_COMPONENT_ID") == ("C", "A")
    assert label.get("SITE_DERIVED_GEOMETRY_PARMS", "SOLAR_ELEVATION") == Quantity(78.801, "deg")
    assert label.get("SITE_DERIVED_GEOMETRY_PARMS", "ANGLES") == (
        Quantity(1.0, "rad"),
        Quantity(2.0, "rad"),
    )
    assert label.get("HISTORY", "USER") == "me"


@pytest.mark.parametrize(
    ("form", "stored"),
    [
        ("FORMAT='HALF'", ">i2"),
        ("FORMAT='HALF' INTFMT='LOW'", "<i2"),
        ("FORMAT='BYTE'", "u1"),
        ("FORMAT='REAL'", "<f4"),
        ("FORMAT='REAL' REALFMT='IEEE'", ">f4"),
    ],
)
def test_pixels_are_located_by_the_system_items(rng, form, stored):
    values = rng.integers(1, 200, (10, 20))
    text = TEXT.replace("FORMAT='HALF'", form)
    if "INTFMT='LOW'" in form:
        text = text.replace("INTFMT='HIGH'", "")
    if "'IEEE'" in form:
        text = text.replace("REALFMT='RIEEE'", "")
    data = file_of(text, values.astype(stored).tobytes())
    pixels, mask = read_pixels(data, parse_vicar_label(data, "x"), "x")
    np.testing.assert_array_equal(pixels, values)
    assert mask.all()


def test_the_end_of_a_label_is_found_in_the_first_bytes():
    assert vicar_label_end(b"0123456789" + file_of(TEXT)) == 1034
    assert vicar_label_end(b"nothing") is None


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"nothing", "not a VICAR label"),
        (b"LBLSIZE=99999 FORMAT='BYTE'", "LBLSIZE is 99999, but 27 bytes follow"),
        (b"LBLSIZE=20 ((((((((((", "expected KEY=value"),
        (b"LBLSIZE=50 FORMAT='X' ", "FORMAT of the VICAR label 'X' is not read"),
    ],
)
def test_a_broken_label_is_refused(data, message):
    with pytest.raises(LabelError, match=message):
        parse_vicar_label(data + bytes(0 if b"999" in data else 50), "x.vic")


def test_a_truncated_file_with_an_intact_vicar_label_is_reported_as_altered(small):
    vicar = file_of("LBLSIZE=1024 FORMAT='HALF' ").ljust(1024)[:1024]
    image = replace(small).but("^IMAGE                           = 9", "^IMAGE = 30")
    data = image.data[: 8 * 512] + vicar + image.data[8 * 512 :]
    with pytest.raises(PixelError, match=r"ends at byte 5120, so .IMAGE was probably altered"):
        read_image(data, "2n292280938effb100p0703l0m1.img")


FIRST = TEXT.replace("TYPE='IMAGE'", "TYPE='IMAGE' EOL=1 N1=20 N2=10 N3=1")
SECOND = b"LBLSIZE=120  USER='you'  PROPERTY='GEOMETRIC_CAMERA_MODEL' MODEL_TYPE='CAHV' "


def test_the_label_after_the_pixels_continues_the_first_part(rng):
    values = rng.integers(1, 200, (10, 20))
    data = file_of(FIRST, values.astype(">i2").tobytes()) + SECOND.ljust(120, b"\0")
    label = parse_vicar_label(data, "x.vic")
    assert label.get("GEOMETRIC_CAMERA_MODEL", "MODEL_TYPE") == "CAHV"
    assert label.get("GEOMETRIC_CAMERA_MODEL", "MODEL_COMPONENT_ID") == ("C", "A")
    assert label.get("HISTORY", "USER") == "me"  # of two, the first
    np.testing.assert_array_equal(read_pixels(data, label, "x.vic")[0], values)
    behind = parse_vicar_label(b"a label before it " + data, "x.vic")
    assert behind.get("GEOMETRIC_CAMERA_MODEL", "MODEL_TYPE") == "CAHV"


def test_the_first_bytes_are_read_without_the_second_label_part():
    label = parse_vicar_label(file_of(FIRST, bytes(100)), "x.vic")
    assert label.get("", "FRAME_ID") == "LEFT"
    assert label.get("GEOMETRIC_CAMERA_MODEL", "MODEL_TYPE") is None


@pytest.mark.parametrize(
    ("text", "behind", "message"),
    [
        (FIRST, b"pixels and no label", "EOL=1, but byte 1504 starts no second label"),
        (FIRST.replace("N2=10", "N2=-10"), SECOND, "RECSIZE, N2, N3, NLB do not locate"),
        (FIRST.replace("RECSIZE=40", "RECSIZE='x'"), SECOND, "RECSIZE, N2, N3, NLB do not locate"),
        (FIRST, SECOND.replace(b"PROPERTY=", b"PROPERTY "), "expected KEY=value"),
    ],
)
def test_a_broken_second_label_part_is_refused(text, behind, message):
    data = file_of(text, bytes(400)) + behind
    with pytest.raises(LabelError, match=message):
        parse_vicar_label(data, "x.vic")
