import math

import numpy as np
import pytest

from solmap.photogrammetry.archive.frame_tree import (
    frames_of_label,
    mars_tree,
    mast_frame,
    rover_from_mast,
)
from solmap.photogrammetry.archive.labels.label import parse_label
from solmap.photogrammetry.archive.missions import MER
from solmap.photogrammetry.archive.tables.vector_files import parse_vector_file
from solmap.photogrammetry.errors import LabelError
from solmap.photogrammetry.frames import BODY_FIXED, LSL, Frame, FrameKind, Pose, site_frame
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.mars import MarsPoint, geographic

CLOCK = 194463440.996
STOP = StopId("MER2", 125, 100)
CAMERA = Frame(FrameKind.CAMERA, (125, 100, 194463440))
GUSEV = MarsPoint(math.radians(175.4729), math.radians(-14.5692))


@pytest.fixture
def label(shared_data):
    path = next(shared_data.rglob("2n194463440effapa0p0685l0m1.excerpt.lbl"))
    return parse_label(path.read_text(), path.name)


@pytest.fixture
def tree(shared_data, test_vectors, label):
    row = test_vectors["site_chain"]["camera_to_lsl"]
    svf = (shared_data / "traverse" / "mer_spirit" / "mer2_master.svf").read_text()
    site_from_rover = Pose.of_quaternion(
        site_frame(125),
        STOP.frame,
        np.array(row["rover_quaternion_scalar_first"]),
        np.array(row["rover_offset_in_site"]),
    )
    of_label = [site_from_rover, *frames_of_label(label, MER, STOP, CLOCK)]
    return mars_tree([parse_vector_file(svf, "x.svf")], of_label, GUSEV)


def test_the_papers_equations_hold_along_the_tree(tree, test_vectors):
    """(1) M = M_R M_S M_0 and (2) C, of a real label and the real site chain."""
    row = test_vectors["site_chain"]["camera_to_lsl"]
    lsl_from_camera = tree.pose(LSL, CAMERA)
    c_lsl = row["C_lsl_north_east_down"]
    np.testing.assert_allclose(lsl_from_camera.translation_m, c_lsl, atol=1e-6)
    right, up, back = np.array(row["M_camera_from_lsl"])
    np.testing.assert_allclose(lsl_from_camera.rotation[:, 0], right, atol=2e-6)
    np.testing.assert_allclose(lsl_from_camera.rotation[:, 2], -back, atol=2e-6)
    # V' of a real camera is not quite at right angles to H': 0.3 px at the edge of the frame.
    np.testing.assert_allclose(lsl_from_camera.rotation[:, 1], -up, atol=1e-3)


def test_the_camera_hangs_on_the_mast_and_the_mast_on_the_rover(tree):
    camera_on_mast = tree.pose(mast_frame(STOP, CLOCK), CAMERA)
    # The true Spirit Navcam rig in the mast frame (facts 2.6), C to 1 micrometre of the label.
    expected = [0.00564067, -0.08762517, -0.15419121]
    np.testing.assert_allclose(camera_on_mast.translation_m, expected, atol=1e-6)
    on_rover = tree.pose(STOP.frame, mast_frame(STOP, CLOCK)).translation_m
    np.testing.assert_allclose(on_rover, [0.45781, 0.02779, -1.09668])


def test_the_tree_reaches_the_body_of_mars(tree):
    body_from_camera = tree.pose(BODY_FIXED, CAMERA)
    longitude, latitude, _ = np.degrees(geographic(body_from_camera.translation_m[None])).T[0]
    # Site 125 lies at 175.527404771585 E, 14.602488269806 S; the rover stood 24 m beside it.
    assert longitude == pytest.approx(175.5274048, abs=0.0006)
    assert latitude == pytest.approx(-14.6024883, abs=0.0003)


def test_a_label_without_mast_hangs_its_camera_on_the_rover(small):
    plain = parse_label(small.but("PMA_COORDINATE", "IDD_COORDINATE").label, "x.img")
    (in_rover,) = frames_of_label(plain, MER, STOP, CLOCK)
    assert (in_rover.target, in_rover.source) == (STOP.frame, CAMERA)
    assert rover_from_mast(plain, MER, mast_frame(STOP, CLOCK), STOP.frame) is None


def test_a_mast_without_length_is_refused(small):
    broken = small.but(
        "(0.317432,0.21062,-0.0725336,0.921746)",
        "(0.0,0.0,0.0,0.0)\n  ORIGIN_OFFSET_VECTOR = (0.4,0.0,-1.1)",
    )
    with pytest.raises(LabelError, match=r"PMA_COORDINATE_SYSTEM: .* not a unit quaternion"):
        frames_of_label(parse_label(broken.label, "x.img"), MER, STOP, CLOCK)
