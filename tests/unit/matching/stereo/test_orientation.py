from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.stereo.orientation import (
    VerticalParallax,
    rig_rotation,
    turn_in_place,
    vertical_parallax,
)


def shifted_down(images: EpipolarImages, pixels: float) -> EpipolarImages:
    right = ndimage.shift(images.right, (pixels, 0), order=3, mode="mirror").astype(np.float32)
    return replace(images, right=right)


@pytest.mark.parametrize("pixels", [0.0, -2.67, 3.4])
def test_row_offsets_between_the_eyes_are_measured(scene, ground, pixels):
    world = scene([ground])
    measured = vertical_parallax(shifted_down(world.images, pixels))
    assert len(measured.vertical_px) > 100
    assert measured.median_px == pytest.approx(pixels, abs=0.03)
    assert measured.mad_px < 0.1
    assert measured.fits_the_rig == (abs(pixels) < 0.5)


def test_a_wrong_rig_is_reported(scene, ground):
    world = scene([ground])
    assert "rows correspond" in str(vertical_parallax(world.images))
    text = str(vertical_parallax(shifted_down(world.images, -2.67)))
    assert text.startswith("vertical parallax -2.6")
    assert "another exposure, or a bent stereo rig" in text


def test_the_rotation_of_a_bent_rig_is_found_and_corrected(scene, ground, rng):
    geometry = scene([ground]).images.geometry
    left, right = geometry.cameras()
    rotation = np.array([0.002, -0.004, 0.001])
    turn = Rotation.from_rotvec(rotation).as_matrix()
    rover = geometry.rover_from_pair.target
    bent = right.transform(Pose(rover, rover, turn, right.centre - turn @ right.centre))
    points = rng.uniform([-3, -2, 4], [3, 2, 20], (500, 3))
    seen, partner = left.project(points), bent.project(points)
    measured = VerticalParallax(
        seen, partner[:, 1] - seen[:, 1], seen[:, 0] - right.project(points)[:, 0], geometry
    )
    found = rig_rotation(measured)
    np.testing.assert_allclose(found, rotation, atol=2e-5)  # second order in the rotation
    pose = geometry.rover_from_pair
    repaired = turn_in_place(right, rover, pose.rotation @ found).project(points)
    np.testing.assert_allclose(repaired[:, 1], partner[:, 1], atol=0.05)


def test_inconsistent_row_offsets_are_not_corrected(scene, ground, rng):
    geometry = scene([ground]).images.geometry
    points = rng.uniform(0, 256, (50, 2))
    loose = VerticalParallax(points, rng.normal(size=50) * 3, np.full(50, 9.0), geometry)
    assert not loose.fits_the_rig


def test_too_few_points_determine_no_rotation(scene, ground):
    geometry = scene([ground]).images.geometry
    few = VerticalParallax(np.zeros((3, 2)), np.zeros(3), np.ones(3), geometry)
    assert "too few to check" in str(few)
    assert not few.fits_the_rig
    with pytest.raises(MatchingError, match="3 points with vertical parallax are too few"):
        rig_rotation(few)
