from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.archive.images.reading import read_image, read_image_record
from solmap.photogrammetry.archive.images.rover_image import camera_model, rover_image
from solmap.photogrammetry.archive.labels.label import parse_label
from solmap.photogrammetry.archive.missions import MER, MISSIONS, Mission
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.errors import LabelError, PixelError
from solmap.photogrammetry.frames import rotation_of_quaternion, rover_frame, site_frame
from solmap.photogrammetry.imagery import Eye, StopId

NAME = "2n292280938effb100p0703l0m1.img"


def record(image, name=NAME):
    return read_image_record(image.data, name)


def test_a_label_becomes_a_record(small):
    read = read_image(small.data, "edr/" + NAME)
    image = read.image
    assert image.id == "2N292280938EFFB100P0703L0M1"
    assert image.stop == StopId("MER2", 137, 0)
    assert (image.sol, image.instrument, image.eye) == (1869, "NAVCAM", Eye.LEFT)
    assert image.filter_number is None
    assert image.clock == 292280938.496
    assert image.motion_counter == (137, 0, 0, 13, 7)
    assert (image.sequence, image.product_type, image.is_linearised) == ("p0703", "EFF", False)
    assert (image.lines, image.samples) == (40, 60)
    assert image.attitude_measured_by == "FINE"
    assert image.local_solar_time == "11:23:54"
    assert image.start_time == "2009-04-06T08:48:13.468"
    assert image.sun_azimuth == pytest.approx(np.radians(131.496))
    north, east, down = image.sun
    assert np.arctan2(east, north) == pytest.approx(image.sun_azimuth)
    assert -np.arcsin(down) == pytest.approx(image.sun_elevation)
    assert image.site_from_rover.target == site_frame(137)
    assert image.site_from_rover.source == rover_frame(137, 0)
    np.testing.assert_array_equal(image.site_from_rover.translation_m, [1.0, 2.0, -0.5])
    np.testing.assert_array_equal(image.camera.centre, [0.454993, 0.141198, -1.23312])
    np.testing.assert_array_equal(read.pixels, small.pixels)
    assert read.mask.all()


def test_a_sun_elevation_counted_downwards_is_reversed(small):
    flipped = small.but("-25.7423", "25.7423").but("78.801", "-78.801")
    for image in (small, flipped):
        assert record(image).sun_elevation == pytest.approx(np.radians(78.801))


def test_a_sun_below_the_horizon_is_kept_if_the_mast_agrees(small):
    assert record(small.but("78.801", "-3.0")).sun_elevation == pytest.approx(np.radians(-3.0))


def test_without_a_mast_the_sun_is_up_by_day_and_as_stated_at_night(small):
    hazcam = small.but("  INSTRUMENT_ELEVATION           = -25.7423 <deg>\n", "").but(
        "78.801", "-20"
    )
    assert record(hazcam).sun_elevation == pytest.approx(np.radians(20))
    night = hazcam.but("11:23:54", "19:05:00")
    assert record(night).sun_elevation == pytest.approx(np.radians(-20))
    assert record(hazcam.but("-20 <deg>", '"NULL"')).sun_elevation is None


@pytest.mark.parametrize(
    ("values", "names", "celsius"),
    [
        ("(3.6 <degC>,-15.0 <degC>,0.0 <degC>,-14.0 <degC>)",
         '("LEFT PAN ELECTRONICS","LEFT PAN CCD","RIGHT PAN CCD","LEFT NAV CCD")', -14.5),
        ("(-8.2 <degC>,1E30 <degC>)", '("B_LEFT_NAV_CCD","B_RIGHT_NAV_CCD")', -8.2),
        ("(0.0 <degC>,-8.2 <degC>)", '("LEFT NAV CCD","MI CCD")', None),
        ("(-8.2 <degC>,N/A)", '("LEFT NAV CCD","MI CCD")', None),
        ("-8.2 <degC>", '("LEFT NAV CCD","MI CCD")', None),
    ],
)  # fmt: skip
def test_the_temperature_of_the_mast_is_that_of_the_measured_detectors(
    small, values, names, celsius
):
    assert record(small).camera_celsius is None
    reported = f"  INSTRUMENT_TEMPERATURE = {values}\n  INSTRUMENT_TEMPERATURE_NAME = {names}\n"
    group = "GROUP                            = INSTRUMENT_STATE_PARMS\n"
    image = record(small.but(group, group + reported))
    assert image.camera_celsius == (None if celsius is None else pytest.approx(celsius))


def test_a_renamed_file_is_identified_by_its_product_id(small):
    assert record(small, "copy of it.img").id == "2N292280938EFFB100P0703L0M1"
    nameless = small.but('"2N292280938EFFB100P0703L0M1"', '"SLLARC_1"')
    image = record(nameless, "a/b/somewhere.img")
    assert (image.id, image.product_type) == ("SOMEWHERE", "UNKNOWN")


def test_the_file_name_has_priority_over_the_product_id(small):
    image = record(small, "2n292280938ilfb100p0703l0m2.img")
    assert (image.id, image.product_type) == ("2N292280938ILFB100P0703L0M2", "ILF")


def test_the_pancam_filter_is_that_of_the_file_name(small):
    pancam = replace(small, instrument="PANCAM")
    assert record(pancam, "2p295043688fflb1dnp2380l2m1.img").filter_number == 2


def test_the_half_pixel_of_averaged_images_is_corrected_or_kept(small):
    averaged = small.but("PIXEL_AVERAGING_WIDTH          = 1", "PIXEL_AVERAGING_WIDTH = 4")
    plain, left, right = (
        record(small).camera,
        camera_model(parse_label(averaged.label, NAME)),
        record(averaged).camera,
    )
    np.testing.assert_array_equal(plain.h, left.h)
    points = plain.centre + 5 * plain.rays(np.array([[10.0, 20.0]]))
    # The label is larger by (1 - s) / 2, 0.375 px for blocks of four.
    np.testing.assert_allclose(right.project(points), [[9.625, 20.0]], atol=1e-9)


def test_a_camera_in_the_site_frame_is_transformed_to_the_rover(small):
    in_site = small.but(
        "REFERENCE_COORD_SYSTEM_NAME    = ROVER_FRAME", "REFERENCE_COORD_SYSTEM_NAME = SITE_FRAME"
    )
    rotation = rotation_of_quaternion(np.array([0.994261, -0.095668, -0.0233068, 0.0418276]))
    expected = rotation.T @ (np.array([0.454993, 0.141198, -1.23312]) - [1.0, 2.0, -0.5])
    np.testing.assert_allclose(record(in_site).camera.centre, expected, atol=1e-12)


def test_components_are_found_by_their_letters(small):
    text = small.but('("C","A","H","V","O","R")', '("A","C","H","V","O","R")').label
    swapped = text.replace("COMPONENT_1 ", "X").replace("COMPONENT_2 ", "COMPONENT_1 ")
    camera = camera_model(parse_label(swapped.replace("MODEL_X", "MODEL_COMPONENT_2"), "x"))
    np.testing.assert_array_equal(camera.c, [0.454993, 0.141198, -1.23312])


def test_a_fisheye_is_read_with_its_type_and_parameter(small):
    text = small.but("= CAHVOR", "= CAHVORE").but(
        '("C","A","H","V","O","R")', '("C","A","H","V","O","R","E","T","P")'
    )
    text = text.but(
        "  REFERENCE_COORD_SYSTEM_NAME    = ROVER_FRAME",
        "  MODEL_COMPONENT_7 = (0.001,0.002,0.0)\n  MODEL_COMPONENT_8 = 3.0\n"
        "  MODEL_COMPONENT_9 = 0.37\n  REFERENCE_COORD_SYSTEM_NAME    = ROVER_FRAME",
    )
    camera = record(text).camera
    assert (camera.type, camera.parameter) == (3, 0.37)
    with pytest.raises(LabelError, match=r"T should be 1, 2 or 3, but is 2\.5"):
        record(text.but("MODEL_COMPONENT_8 = 3.0", "MODEL_COMPONENT_8 = 2.5"))


def test_a_linearised_product_has_a_perspective_camera(small):
    linear = replace(small, projection="LINEARIZED").but("= CAHVOR", "= CAHV")
    image = record(linear, "2n292280938fflb100p0703l0m1.img")
    assert image.is_linearised
    assert isinstance(image.camera, Cahv)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("GROUP                            = GEOMETRIC_CAMERA_MODEL\n", "GROUP = OTHER\n", None),
        ("MODEL_TYPE                     = CAHVOR", "MODEL_TYPE = PSPH", "should be CAHV, CAHVOR"),
        (
            "(-0.69585,0.571462,0.435)",
            "(0.0,0.0,0.0)",
            "A of a camera model should be a unit vector",
        ),
        ("(-0.61985,0.672629,0.404174)", "(0,0,0)", "O should be a unit vector, but has length 0"),
        ("(-0.69585,0.571462,0.435)", "(1.0,0.0)", "MODEL_COMPONENT_2 should be 3 numbers"),
        (
            '"MER2"',
            '"LRO"',
            "INSTRUMENT_HOST_ID should be one of MER1, MER2, MSL, M20, M2020, but is 'LRO'",
        ),
        ('"NAVCAM_LEFT"', '"APXS"', "unknown camera INSTRUMENT_ID 'APXS'"),
        ("= REGULAR", "= THUMBNAIL", "not a mapping image: IMAGE_TYPE is 'THUMBNAIL'"),
        ("(137,0,0,13,7)", "(137)", "ROVER_MOTION_COUNTER should be whole numbers"),
        ("(137,0,0,13,7)", "(137,-1,0)", "ROVER_MOTION_COUNTER should be whole numbers"),
        ('"292280938.496"', '"noon"', "SPACECRAFT_CLOCK_START_COUNT should be seconds"),
        ("= 1869", "= UNK", "PLANET_DAY_NUMBER should be a whole number, but is an unknown value"),
        ("(0.994261,-0.095668,-0.0233068,0.0418276)", "(0,0,0,0)", "is not a unit quaternion"),
        ("NAME    = SITE_FRAME", "NAME    = LANDER_FRAME", "should be SITE_FRAME"),
        ("NAME    = ROVER_FRAME", "NAME    = MOON", "should be ROVER_FRAME or SITE_FRAME"),
        ("WIDTH          = 1", "WIDTH = 0", "PIXEL_AVERAGING_WIDTH should be 1 or more"),
    ],
)
def test_an_unusable_label_is_refused_in_one_line(small, old, new, message):
    if message is None:
        new, message = "GROUP = GEO\n", r"the label has no camera model"
        small = small.but("END_GROUP                        = GEOMETRIC_CAMERA_MODEL", "END_GROUP")
        old = "GROUP                            = GEOMETRIC_CAMERA_MODEL\n"
    with pytest.raises(LabelError, match=message) as caught:
        read_image(small.but(old, new).data, NAME)
    assert NAME in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["ETH", "ITH", "ERP", "EHG", "DIS", "XYL", "SLL", "MSK"])
def test_rasters_without_grey_values_are_refused(small, kind):
    with pytest.raises(LabelError, match=f"not a mapping image: product type {kind}"):
        record(small, f"2n292280938{kind.lower()}b100p0703l0m1.img")


def test_a_derived_raster_of_another_mission_is_refused_by_its_label(small):
    derived = small.but(
        "GROUP                            = PMA",
        "GROUP = DERIVED_IMAGE_PARMS\n DERIVED_IMAGE_TYPE = XYZ_MAP\nEND_GROUP\nGROUP = PMA",
    )
    with pytest.raises(LabelError, match="DERIVED_IMAGE_TYPE is 'XYZ_MAP'"):
        record(derived)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "x.img: the file is empty"),
        (b"Dear reader,\nthis is a letter.\n", "not a PDS3 image: it starts with 'Dear reader,"),
        (b"\xff\xd8\xff\xe0\x00\x10JFIF", "not a PDS3 image"),
        (b"PDS_VERSION_ID = PDS3\n", "x.img: the label ends in line 2 without END"),
        (b"PDS_VERSION_ID = PDS3\nEND\n", "x.img: INSTRUMENT_HOST_ID is missing"),
    ],
)
def test_a_file_without_an_image_is_named_with_its_fault(data, message):
    with pytest.raises(LabelError, match=message):
        read_image(data, "x.img")


def test_a_truncated_image_still_has_its_record(small):
    data = small.data[:5000]
    assert read_image_record(data, NAME).sol == 1869
    with pytest.raises(PixelError, match="truncated"):
        read_image(data, NAME)


def test_a_detached_label_is_joined_to_its_pixels(small):
    label = small.but("^IMAGE                           = 9", '^IMAGE = "X.DAT"').label
    read = read_image(small.pixels.astype(">i2").tobytes(), NAME, detached_label=label)
    np.testing.assert_array_equal(read.pixels, small.pixels)


def test_a_new_mission_needs_one_new_record(small):
    other = Mission(
        hosts=("VIPER",),
        instruments={"NAVCAM_LEFT": ("NAVCAM", Eye.LEFT)},
        mast_group=MER.mast_group,
        stereo_filters={},
        mapping_products=None,
    )
    viper = small.but('"MER2"', '"VIPER"')
    label = parse_label(viper.label, "x.img")
    assert rover_image(label, "x.img", (other,)).stop.mission == "VIPER"


def test_both_names_of_a_spacecraft_give_the_same_mission(small):
    of_mars_2020 = replace(MER, hosts=("M20", "M2020"), mapping_products=None)
    for host in ("M20", "M2020"):
        label = parse_label(small.but('"MER2"', f'"{host}"').label, "x.img")
        assert rover_image(label, "x.img", (of_mars_2020,)).stop.mission == "M20"


def averaged(small):
    """The image averaged over 2 x 4 pixels."""
    return small.but("AVERAGING_HEIGHT         = 1", "AVERAGING_HEIGHT         = 4").but(
        "AVERAGING_WIDTH          = 1", "AVERAGING_WIDTH          = 2"
    )


def test_the_half_pixel_is_corrected_for_the_mission_that_omits_it(small):
    """MER scaled about a pixel's corner; software after 2011 does not."""
    label = parse_label(averaged(small).label, "x.img")
    later = replace(MER, leaves_out_half_pixel=False)
    stated = camera_model(label)
    of_mer, of_later = (rover_image(label, "x.img", (each,)).camera for each in (MER, later))
    np.testing.assert_array_equal(of_later.h, stated.h)
    np.testing.assert_allclose(of_mer.h, stated.h - 0.25 * stated.a, atol=1e-12)
    np.testing.assert_allclose(of_mer.v, stated.v - 0.375 * stated.a, atol=1e-12)
    assert not any(mission.leaves_out_half_pixel for mission in MISSIONS if mission is not MER)


SITE = """GROUP = SITE_COORD_SYSTEM_PARMS
  COORDINATE_SYSTEM_INDEX = 137
  ORIGIN_OFFSET_VECTOR = (-33.9025,-56.6548,7.36923)
  ORIGIN_ROTATION_QUATERNION = (1.0,0.0,0.0,0.0)
  REFERENCE_COORD_SYSTEM_NAME = "SITE_FRAME"
  REFERENCE_COORD_SYSTEM_INDEX = {parent}
END_GROUP = SITE_COORD_SYSTEM_PARMS
"""
ROVER_GROUP = "GROUP                            = ROVER_COORDINATE_SYSTEM\n"


def test_a_label_may_place_its_site_in_another(small):
    placed = small.but(ROVER_GROUP, SITE.format(parent=136) + ROVER_GROUP)
    pose = rover_image(parse_label(placed.label, "x.img"), "x.img").parent_from_site
    assert (pose.target, pose.source) == (site_frame(136), site_frame(137))
    np.testing.assert_array_equal(pose.translation_m, [-33.9025, -56.6548, 7.36923])
    assert rover_image(parse_label(small.label, "x.img"), "x.img").parent_from_site is None


@pytest.mark.parametrize("parent", ["137", '"N/A"'])
def test_a_site_placed_in_itself_or_in_an_unknown_one_is_not_placed(small, parent):
    placed = small.but(ROVER_GROUP, SITE.format(parent=parent) + ROVER_GROUP)
    assert rover_image(parse_label(placed.label, "x.img"), "x.img").parent_from_site is None
