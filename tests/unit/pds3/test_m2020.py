import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from photogrammetry.cameras.cahv import Cahv
from photogrammetry.cameras.cahvor import Cahvor
from photogrammetry.cameras.cahvore import Cahvore
from photogrammetry.errors import LabelError
from photogrammetry.pds3.m2020 import camera_of_metadata

VECTORS = (
    "(0.95,0.35,-1.89);(0.824195,0.0290508,0.565575);(2041.2,3032.24,1457.62);"
    "(-71.0941,9.0217,3538);(0.824089,0.0304646,0.565654);(0.0,0.05,-0.017)"
)


def metadata(model="CAHVORE", components=VECTORS + ";(0.0,0.0,0.0);2;0.0"):
    return json.dumps({"camera_model_type": model, "camera_model_component_list": components})


def test_the_navcam_of_perseverance_projects_and_back(shared_data, rng):
    path = next(shared_data.rglob("NLF_0670_*-metadata.json"))
    text = path.read_text()
    camera = camera_of_metadata(text, path.name)
    assert isinstance(camera, Cahvore)
    assert (camera.type, camera.parameter) == (2, 0.0)
    np.testing.assert_array_equal(camera.c, [0.950849, 0.349753, -1.89429])
    # Components belong to the full sensor of 5120 x 3840, the image was averaged 4 x 4.
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
    ("text", "complaint"),
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
def test_broken_metadata_are_refused(text, complaint):
    with pytest.raises(LabelError, match=complaint) as caught:
        camera_of_metadata(text, "x.json")
    assert str(caught.value).startswith("x.json: ")


@given(st.text(max_size=60).map(lambda part: metadata("CAHVOR", part)) | st.text(max_size=60))
def test_any_text_is_metadata_or_refused(text):
    with pytest.raises(LabelError):
        camera_of_metadata(text, "x.json")
