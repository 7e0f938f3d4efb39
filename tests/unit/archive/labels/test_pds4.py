import contextlib
import math
import random
from pathlib import Path

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.archive.images.reading import (
    read_colour,
    read_image,
    read_image_record,
)
from solmap.photogrammetry.archive.images.rover_image import rover_image
from solmap.photogrammetry.archive.labels.detached import join_label
from solmap.photogrammetry.archive.labels.pds4 import parse_pds4_label
from solmap.photogrammetry.cameras.cahv import interior_orientation
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.errors import LabelError
from solmap.photogrammetry.frames import rotation_of_quaternion, rover_frame, site_frame
from solmap.photogrammetry.imagery import Eye

NAME = "NLF_0629_0722782785_631ECM_N0301344NCAM00427_06_095J01.IMG"
XML = (Path(__file__).parent / "navcam_of_perseverance.xml").read_text()
QUATERNION = np.array([0.174493, 0.034765, 0.0422949, -0.983135])


@pytest.fixture
def pixels(rng):
    return rng.integers(1, 255, (3, 2, 3), dtype=np.uint8)


def test_a_pds4_product_is_read_as_an_image(pixels):
    read = read_image(bytes(16) + pixels.tobytes(), NAME, detached_label=XML)
    np.testing.assert_allclose(read.pixels, pixels.mean(axis=0), rtol=1e-6)
    assert read.mask.all()
    image = read.image
    assert (image.stop.mission, image.stop.site, image.stop.drive) == ("M20", 30, 1344)
    assert (image.instrument, image.eye, image.filter_number) == ("NAVCAM", Eye.LEFT, None)
    assert (image.sol, image.clock, image.sequence) == (629, 722782785.631, "ncam00427")
    assert image.product_type == "ECM"
    assert image.motion_counter == (30, 1344, 4)
    assert image.attitude_measured_by == "SUN_FIND"
    assert not image.is_linearised
    assert image.start_time == "2022-11-27T01:08:36.002Z"
    assert math.degrees(image.sun_elevation) == pytest.approx(58.718)
    assert math.degrees(image.sun_azimuth) == pytest.approx(6.01225)


ONE_BAND = (
    XML.replace("<axes>3</axes>", "<axes>2</axes>")
    .replace(
        "      <Axis_Array><axis_name>Band</axis_name><elements>3</elements>"
        "<sequence_number>1</sequence_number></Axis_Array>\n",
        "",
    )
    .replace("Array_3D_Image>", "Array_2D_Image>")
)
FILTERS = (
    "<img:Color_Filter_Array><img:color_filter_array_type>Bayer RGGB</img:color_filter_array_type>"
    "<img:color_filter_array_state>{}</img:color_filter_array_state></img:Color_Filter_Array>"
    "</img:Imaging>"
)


@pytest.mark.parametrize(
    ("name", "state", "is_mosaic"),
    [
        (NAME, "Encoded", True),
        (NAME, "Decoded", False),
        (NAME.replace("NLF", "NLE"), None, True),
        (NAME.replace("ECM", "EBY"), None, True),
        (NAME.replace("NLF", "NLE"), "No CFA", False),
    ],
)
def test_a_bayer_frame_is_recognised_by_its_label_or_name(name, state, is_mosaic):
    mosaic = np.full((2, 3), 30, np.uint8)
    mosaic[0, ::2], mosaic[1, 1] = 60, 90  # red 60, green 30, blue 90 everywhere
    label = ONE_BAND.replace(NAME[:-4], name[:-4])
    label = label if state is None else label.replace("</img:Imaging>", FILTERS.format(state))
    data = join_label(label.encode(), bytes(16) + mosaic.tobytes(), name)
    read, colours = read_image(data, name), read_colour(data, name)
    if is_mosaic:
        np.testing.assert_array_equal(read.pixels, np.full((2, 3), 60))
        np.testing.assert_array_equal(colours[0], np.full((3, 2, 3), [[[60]], [[30]], [[90]]]))
    else:
        np.testing.assert_array_equal(read.pixels, mosaic)
        assert colours is None


def test_a_colour_image_is_not_a_bayer_frame_under_any_name(pixels):
    name = NAME.replace("NLF", "NLE")
    png = cv2.imencode(".png", pixels.transpose(1, 2, 0)[:, :, ::-1])[1].tobytes()
    data = join_label(XML.replace(NAME[:-4], name[:-4]).encode(), png, name)
    np.testing.assert_allclose(read_image(data, name).pixels, pixels.mean(axis=0), rtol=1e-6)
    np.testing.assert_array_equal(read_colour(data, name)[0], pixels)


def test_the_geometry_of_telemetry_is_used():
    image = read_image_record(b"", NAME, detached_label=XML)
    assert isinstance(image.camera, Cahvore)
    assert (image.camera.type, image.camera.parameter) == (2, 0.0)
    np.testing.assert_array_equal(image.camera.c, [0.955584, 0.764515, -1.95254])
    np.testing.assert_array_equal(image.camera.e, [-8.0e-09, 1.0e-08, -2.9e-08])
    pose = image.site_from_rover
    assert (pose.target, pose.source) == (site_frame(30), rover_frame(30, 1344))
    np.testing.assert_array_equal(pose.translation_m, [94.6281, -118.938, -7.51133])
    np.testing.assert_allclose(pose.rotation, rotation_of_quaternion(QUATERNION), atol=1e-15)


def test_a_tile_has_the_camera_model_of_the_tile():
    """Tile 6 of 16 starts some 1272 pixels into a sensor whose axis is at about (2595, 1945)."""
    camera = read_image_record(b"", NAME, detached_label=XML).camera
    inner = interior_orientation(camera.a, camera.h, camera.v)
    assert 0 < inner.hc - 2 * (1296 / 2) + 1272 < 2600
    assert inner.hc == pytest.approx(2595 - 1272, abs=30)


def test_the_label_places_the_site_in_the_one_before():
    pose = read_image_record(b"", NAME, detached_label=XML).parent_from_site
    assert pose is not None
    assert (pose.target, pose.source) == (site_frame(29), site_frame(30))
    np.testing.assert_array_equal(pose.translation_m, [36.576, -10.604, -1.15378])


def test_a_reverse_quaternion_is_inverted():
    reverse = XML.replace("Forward", "Reverse", 1)
    pose = read_image_record(b"", NAME, detached_label=reverse).site_from_rover
    np.testing.assert_allclose(pose.rotation, rotation_of_quaternion(QUATERNION).T, atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mars2020_navcam", "cassini_iss", "names no mission known here"),
        ("Product_Observational", "Product_Browse", "expected <Product_Observational>, found <Pr"),
        (
            "UnsignedByte",
            "ComplexMSB16",
            "an array of 'ComplexMSB16' with axes 'BAND, LINE, SAMPLE'",
        ),
        (">Band<", ">Time<", "with axes 'TIME, LINE, SAMPLE' is not"),
        ("<sequence_number>1<", "<sequence_number>x<", "<sequence_number> of Axis_Array should"),
        ('<offset unit="byte">16', '<offset unit="byte">-16', "<offset> of Array_3D_Image"),
        ("Forward", "Sideways", "<rotation_direction> should be Forward or Reverse"),
        ("NAVCAM_LEFT", "EDL_CAM", "unknown camera INSTRUMENT_ID 'EDL_CAM'"),
        ("<geom:qcos>0.174493", "<geom:qcos>many", "ORIGIN_ROTATION_QUATERNION should be a num"),
        ("<geom:c1>0.0501396", "<geom:c1>", "MODEL_COMPONENT_6 should be a number"),
        ("SITE_FRAME_30", "", "site"),
        ("<?xml version", "<!DOCTYPE a []><?xml version", "line 1: <!DOCTYPE is not allowed"),
    ],
)
def test_a_broken_label_is_refused_in_one_line(old, new, message):
    changed = XML.replace(old, new)
    assert changed != XML
    if message == "site":  # the site is then that of the rover's own counters
        record = read_image_record(b"", NAME, detached_label=changed)
        assert record.site_from_rover.target == site_frame(30)
        return
    with pytest.raises(LabelError, match=message) as caught:
        rover_image(parse_pds4_label(changed, NAME), NAME)
    assert "\n" not in str(caught.value)


def test_a_label_with_characters_changed_is_read_or_refused():
    chance = random.Random(2021)  # noqa: S311 - no secrets
    refused = 0
    for _ in range(300):
        text = list(XML)
        for _ in range(chance.randint(1, 6)):
            text[chance.randrange(len(text))] = chance.choice("<>/&\"'=;09-eE.\0 x")
        with contextlib.suppress(LabelError):
            read_image_record(b"", NAME, detached_label="".join(text))
            continue
        refused += 1
    assert 0 < refused < 300


@pytest.mark.parametrize("depth", [1, 25, 20_000])
def test_a_megabyte_of_elements_is_refused_quickly(depth):
    """One took 38 s: every nested class was searched down to its last descendant."""
    space = "Coordinate_Space_Definition"
    nested = f"<{space}>" * depth + "<a/>" * 100_000 + f"</{space}>" * depth
    text = f"<Product_Observational><Geometry_Lander>{nested}</Geometry_Lander>"
    with pytest.raises(LabelError, match=r"nested deeper than 32|more than 30000 elements"):
        parse_pds4_label(f"{text}</Product_Observational>", "x.xml")
