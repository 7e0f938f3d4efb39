"""`rig.toml`: which images are pairs, their poses, and faults of the file."""

import numpy as np
import pytest

from solmap.photogrammetry.archive.rig import read_rig, rig_shots
from solmap.photogrammetry.archive.tables.pose_table import parse_poses
from solmap.photogrammetry.cameras.calibrated import Fisheye
from solmap.photogrammetry.errors import LabelError
from solmap.photogrammetry.imagery import Eye
from tests.support.field_rig import rig_text
from tests.unit.archive.test_calibrations import KALIBR, TSAI

EYES = '[left]\nimages = "left*.png"\n{left}\n[right]\nimages = "right*.png"\n{right}\n'
NAMED = 'mission = "K10"\n' + EYES.format(
    left='calibration = "l.tsai"', right='calibration = "r.tsai"'
)
FILES = {"l.tsai": TSAI, "r.tsai": TSAI.replace("-0.065", "0.04"), "chain.yaml": KALIBR}
PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + b"\0\0\4\0\0\0\3\0" + b"\x08\0\0\0\0"
"""The first bytes of an image of 1024 x 768 pixels."""


def rig_of(text):
    return read_rig(text, "rig.toml", FILES.__getitem__)


def shots_of(text, files, poses=None):
    rows = None if poses is None else parse_poses(poses, "poses.csv")
    return rig_shots(rig_of(text), files, rows)


def test_the_first_pair_is_the_origin_and_unplaced_ones_have_separate_maps():
    shots, faults = shots_of(NAMED, [f"{eye}{n}.png" for eye in ("left", "right") for n in (9, 4)])
    assert not faults
    places = {file: (shot.stop.site, shot.stop.drive) for file, shot in shots.items()}
    assert places == {f"{e}{n}.png": (n > 4, n) for e in ("left", "right") for n in (4, 9)}
    assert {shot.image_id for shot in shots.values()} == {
        f"K10_S000_{eye}{n}" for eye in ("LEFT", "RIGHT") for n in (4, 9)
    }
    first = shots["left4.png"]
    np.testing.assert_array_equal(first.site_from_rover.translation_m, np.zeros(3))
    np.testing.assert_array_equal(first.site_from_rover.rotation, np.eye(3))


def test_poses_place_pairs_by_any_of_their_images_or_by_their_number():
    poses = (
        "image,site,drive,sol,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg\n"
        "right4.png,,,,1,2,-0.5,0,0,90\n,0,9,3,4,5,0,0,0,0\n"
    )
    files = [f"{eye}{n}.png" for eye in ("left", "right") for n in (9, 4)]
    shots, faults = shots_of(NAMED, files, poses)
    assert not faults
    by_right, by_number = shots["left4.png"], shots["right9.png"]
    np.testing.assert_array_equal(by_right.site_from_rover.translation_m, [1, 2, -0.5])
    np.testing.assert_allclose(by_right.site_from_rover.rotation[:, 0], [0, 1, 0], atol=1e-12)
    assert (by_right.sol, by_number.sol) == (1, 3)
    assert {shot.stop.site for shot in shots.values()} == {0}


def test_pairs_with_names_that_are_not_numbers_are_numbered():
    text = NAMED.replace("left*.png", "left/*.png").replace("right*.png", "right/*.png")
    names = ["1403636579763555584", "1403636579813555456"]
    shots, faults = shots_of(
        text, [f"{eye}/{name}.png" for eye in ("left", "right") for name in names]
    )
    assert not faults
    assert [shots[f"left/{name}.png"].stop.drive for name in names] == [0, 1]
    assert len({shot.image_id for shot in shots.values()}) == 4, "left and right are distinguished"


def test_image_files_without_a_pair_are_named():
    shots, faults = shots_of(NAMED, ["left4.png", "right4.png", "left5.png", "robot.jpg"])
    assert sorted(shots) == ["left4.png", "right4.png"]
    assert "its partner right5.png is missing" in faults["left5.png"]
    assert "neither left*.png nor right*.png" in faults["robot.jpg"]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("left5.png,1,2,0,0,0,0", "no row of the poses CSV .* image = left4.* drive = 4"),
        ("left4.png,1,2,0,,,", "row 1 has no attitude; give roll_deg"),
    ],
)
def test_a_pair_with_an_incomplete_pose_is_refused_with_the_missing_columns(row, message):
    poses = f"image,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg\n{row}\n"
    shots, faults = shots_of(NAMED, ["left4.png", "right4.png"], poses)
    assert not shots
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(faults["left4.png"])


def test_a_calibration_of_both_cameras_is_mounted_on_the_rover():
    text = 'mission = "car"\ncalibration = "chain.yaml"\n' + EYES.format(left="", right="")
    text += "[mount]\nposition_m = [0.2, 0.1, -1.0]\npitch_deg = -30\n"
    cameras = rig_of(text).cameras
    np.testing.assert_allclose(cameras[Eye.LEFT].camera.centre, [0.2, 0.1, -1.0])
    ahead = cameras[Eye.LEFT].camera.rays(np.array([[362.680, 246.049]]))
    slope = np.radians(30)
    np.testing.assert_allclose(ahead, [[np.cos(slope), 0, np.sin(slope)]], atol=1e-9)
    apart = cameras[Eye.RIGHT].camera.centre - cameras[Eye.LEFT].camera.centre
    np.testing.assert_allclose(apart, [0, 0.11, 0], atol=2e-3)


def test_camera_parameters_may_be_in_the_file_itself():
    rig = read_rig(rig_text("fisheye"), "rig.toml", str)
    left, right = (rig.cameras[eye] for eye in (Eye.LEFT, Eye.RIGHT))
    assert isinstance(left.camera, Fisheye)
    assert left.size == (640, 480)
    np.testing.assert_allclose(right.camera.centre - left.camera.centre, [0, 0.24, 0], atol=1e-12)


@pytest.mark.parametrize("size", [(512, 384), (768, 1024)])
def test_images_of_another_size_than_the_calibration_are_refused(size):
    png = PNG[:16] + b"".join(n.to_bytes(4, "big") for n in size) + PNG[24:]
    for text in (NAMED, rig_text()):
        rig = rig_of(text)
        names = [pattern.replace("*", "4") for pattern in rig.images.values()]
        shots, _ = rig_shots(rig, names, None)
        shot = shots[names[0]]
        with pytest.raises(LabelError, match=rf"{names[0]}: {size[0]} x {size[1]} pixels, but"):
            shot.record(png, names[0], None)


def test_a_record_belongs_to_its_image_file():
    shots, _ = shots_of(NAMED, ["left4.png", "right4.png"])
    image = shots["left4.png"].record(PNG, "left4.png", "2026-11-23T00:00:00")
    assert (image.samples, image.lines, image.created) == (1024, 768, "2026-11-23T00:00:00")
    assert (image.stop.mission, image.eye, image.instrument) == ("K10", Eye.LEFT, "STEREO")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mission = ", "rig.toml: "),
        ('mission = "K10"\n', r"\[left\] is missing"),
        (NAMED.replace('"K10"', '"Spirit"'), "MER2 is a rover on Mars"),
        (NAMED.replace('"K10"', '"my rover!"'), "letters and digits"),
        (NAMED.replace("mission", "name"), "no setting 'name'; it has mission"),
        (NAMED.replace("left*.png", "left.png"), r"should contain one \*"),
        (NAMED.replace("right*.png", "left*.png"), "different images"),
        (NAMED.replace("r.tsai", "l.tsai"), "both cameras have the same position"),
        (NAMED.replace("l.tsai", "chain.yaml"), "chain.yaml: both cameras"),
        ('calibration = "l.tsai"\n' + NAMED, "l.tsai: one camera"),
        (NAMED.replace('calibration = "l.tsai"', ""), "names no calibration and no model"),
        (rig_text().replace("brown-conrady", "scaramuzza"), "'scaramuzza' is not known"),
        (rig_text().replace("size_px = [640, 480]", ""), "size_px should be 2 numbers"),
        (rig_text().replace("-0.28, 0.09, 0.0006,", ""), "coefficients, not 2"),
        (rig_text().replace("pitch_deg = -22.0", 'pitch_deg = "steep"'), "pitch_deg should be"),
        ("site = -1\n" + NAMED, "site should be a whole number"),
    ],
)
def test_a_broken_file_is_refused_in_one_line(text, message):
    with pytest.raises(LabelError, match=message) as refused:
        rig_of(text)
    assert "\n" not in str(refused.value).strip()
