import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.archive.images.json_metadata import (
    camera_of_metadata,
    rover_image_of_metadata,
)
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.errors import LabelError
from solmap.photogrammetry.frames import Pose, rotation_of_quaternion, rover_frame, site_frame
from solmap.photogrammetry.imagery import Eye

VECTORS = (
    "(0.95,0.35,-1.89);(0.824195,0.0290508,0.565575);(2041.2,3032.24,1457.62);"
    "(-71.0941,9.0217,3538);(0.824089,0.0304646,0.565654);(0.0,0.05,-0.017)"
)


def metadata(model="CAHVORE", components=VECTORS + ";(0.0,0.0,0.0);2;0.0"):
    return json.dumps({"camera_model_type": model, "camera_model_component_list": components})


def test_the_navcam_of_perseverance_projects_and_back_projects(shared_data, rng):
    path = next(shared_data.rglob("NLF_0670_*-metadata.json"))
    text = path.read_text()
    camera = camera_of_metadata(text, path.name)
    assert isinstance(camera, Cahvore)
    assert (camera.type, camera.parameter) == (2, 0.0)
    np.testing.assert_array_equal(camera.c, [0.950849, 0.349753, -1.89429])
    # The image is the upper left tile of a sensor of 5120 x 3840 pixels, 16 tiles in all.
    image_points = rng.uniform(0, 1, (300, 2)) * [5119, 3839]
    points = camera.ray_origins(image_points) + 5 * camera.rays(image_points)
    np.testing.assert_allclose(camera.project(points), image_points, atol=1e-8)


def test_every_model_type_is_read():
    cahv = camera_of_metadata(metadata("CAHV", ";".join(VECTORS.split(";")[:4])), "x.json")
    cahvor = camera_of_metadata(metadata("CAHVOR", VECTORS), "x.json")
    assert isinstance(cahv, Cahv)
    assert isinstance(cahvor, Cahvor)
    np.testing.assert_array_equal(cahv.v, cahvor.v)
    assert np.linalg.norm(cahvor.o) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", "expected a JSON object"),
        ("{}", "camera_model_type should be CAHV, CAHVOR or CAHVORE, but is None"),
        (metadata("CAHV"), "should have 4 parts, but has 9"),
        (metadata("CAHVOR", VECTORS.replace("3538", "many")), "V of .* should be 3 numbers"),
        (metadata("CAHVOR", VECTORS.replace("3538", "1e999")), "V of a camera model must be"),
        (metadata("CAHVORE", VECTORS + ";(0,0,0);7;0"), "of type 1, 2 or 3, not 7"),
        (metadata("CAHVORE", VECTORS + ";(0,0,0);2.5;0"), "T of .* is 2.5, not 1, 2 or 3"),
        (metadata("CAHVORE", VECTORS + ";(0,0,0);(2,3);0"), "T of .* should be 1 number"),
    ],
)
def test_broken_metadata_are_refused(text, message):
    with pytest.raises(LabelError, match=message) as caught:
        camera_of_metadata(text, "x.json")
    assert str(caught.value).startswith("x.json: ")


@given(st.text(max_size=60).map(lambda part: metadata("CAHVOR", part)) | st.text(max_size=60))
def test_any_text_is_metadata_or_refused(text):
    with pytest.raises(LabelError):
        camera_of_metadata(text, "x.json")


WHOLE = {
    "imageid": "NLF_0670_0726421423_362ECM_N0320604NCAM08111_01_095J",
    "sol": 670,
    "instrument": "NAVCAM_LEFT",
    "sclk": 726421425.133,
    "dimension": "(1288,968)",
    "xyz": "(12.8213,60.1509,0.32331)",
    "site": 32,
    "drive": "604",
    "camera_model_type": "CAHVORE",
    "camera_model_component_list": VECTORS + ";(0.0,0.0,0.0);2;0.0",
    "attitude": "(0.8,0.0,0.0,0.6)",
}


def test_metadata_with_an_attitude_are_a_complete_record():
    image = rover_image_of_metadata(json.dumps(WHOLE), "x.json")
    assert (image.stop.mission, image.stop.site, image.stop.drive) == ("M20", 32, 604)
    assert (image.instrument, image.eye, image.sol) == ("NAVCAM", Eye.LEFT, 670)
    assert (image.samples, image.lines) == (1288, 968)
    assert (image.product_type, image.sequence) == ("ECM", "ncam08111")
    np.testing.assert_array_equal(image.site_from_rover.translation_m, [12.8213, 60.1509, 0.32331])
    turn = rotation_of_quaternion(np.array([0.8, 0.0, 0.0, 0.6]))
    np.testing.assert_allclose(image.site_from_rover.rotation, turn, atol=1e-15)


def test_the_nested_form_of_the_image_list_is_the_same_record():
    camera = {key: WHOLE[key] for key in WHOLE if key.startswith("camera") or key == "instrument"}
    extended = {key: str(WHOLE[key]) for key in ("sclk", "dimension", "xyz")}
    rest = {key: WHOLE[key] for key in WHOLE if key not in {*camera, *extended}}
    nested = rover_image_of_metadata(
        json.dumps({**rest, "camera": camera, "extended": extended}), "x.json"
    )
    flat = rover_image_of_metadata(json.dumps(WHOLE), "x.json")
    assert (nested.id, nested.clock, nested.stop) == (flat.id, flat.clock, flat.stop)
    np.testing.assert_array_equal(nested.camera.centre, flat.camera.centre)


def test_the_navcam_of_perseverance_needs_a_pose_from_another_source(shared_data):
    path = next(shared_data.rglob("NLF_0670_*-metadata.json"))
    with pytest.raises(LabelError, match="name site 32 and drive 604, but no attitude"):
        rover_image_of_metadata(path.read_text(), path.name)
    pose = Pose.identity(site_frame(32), rover_frame(32, 604))
    image = rover_image_of_metadata(path.read_text(), path.name, site_from_rover=pose)
    assert (image.samples, image.lines) == (1288, 968)
    assert image.clock == 726421425.133
    elsewhere = Pose.identity(site_frame(32), rover_frame(32, 605))
    with pytest.raises(LabelError, match="the pose of rover"):
        rover_image_of_metadata(path.read_text(), path.name, site_from_rover=elsewhere)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"attitude": "(0,0,0,0)"}, "not a unit quaternion"),
        ({"attitude": "(1,0,0)"}, "attitude should be 4 numbers"),
        ({"instrument": "EDL_CAM"}, "unknown instrument 'EDL_CAM'"),
        ({"site": -1}, "site should be a whole number, but is '-1'"),
        ({"sclk": None}, "sclk should be seconds, but is None"),
        ({"dimension": "(1288)"}, "dimension should be 2 numbers"),
        ({"dimension": "(0,0)"}, "is not that of an image"),
    ],
)
def test_incomplete_metadata_name_the_missing_part(change, message):
    with pytest.raises(LabelError, match=message) as caught:
        rover_image_of_metadata(json.dumps({**WHOLE, **change}), "x.json")
    assert str(caught.value).startswith("x.json: ")
