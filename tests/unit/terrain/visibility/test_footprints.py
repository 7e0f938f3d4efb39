"""Footprints and pointing lines of single frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import Polygon

from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.frames import (
    LSL,
    Pose,
    rotation_of_roll_pitch_yaw,
    rover_frame,
    site_frame,
)
from solmap.photogrammetry.terrain.visibility.footprints import (
    Ground,
    footprint,
    pointing_line,
)

SIZE = (1024, 1024)
LEVEL = Ground(0.0)


def mast_camera(dip_deg, focal_px=1222.0):
    """A camera 1.5 m above the rover's origin, which looks ahead and down."""
    d = np.radians(dip_deg)
    a, down = np.array([np.cos(d), 0, np.sin(d)]), np.array([-np.sin(d), 0, np.cos(d)])
    right = np.array([0.0, 1.0, 0.0])
    return Cahv(
        c=np.array([0.0, 0.0, -1.5]),
        a=a,
        h=focal_px * right + 511.5 * a,
        v=focal_px * down + 511.5 * a,
    )


def standing(east=0.0, north=0.0, yaw_deg=0.0, frame=LSL):
    rotation = rotation_of_roll_pitch_yaw(0.0, 0.0, np.radians(yaw_deg))
    return Pose(frame, rover_frame(1, 0), rotation, np.array([north, east, 0.0]))


def test_the_middle_of_the_image_meets_level_ground_at_its_range():
    line = pointing_line(mast_camera(30), SIZE, standing(100.0, 50.0, yaw_deg=90.0), LEVEL, 60.0)
    reach = 1.5 / np.tan(np.radians(30))
    np.testing.assert_allclose(line, [[100.0, 50.0], [100.0 + reach, 50.0]], atol=1e-9)


def test_a_line_above_the_horizon_has_the_largest_length():
    line = pointing_line(mast_camera(-10), SIZE, standing(yaw_deg=45.0), LEVEL, 40.0)
    np.testing.assert_allclose(line[1], 40.0 * np.sqrt([0.5, 0.5]), atol=1e-9)


def test_the_outline_of_a_frame_below_the_horizon_is_the_image_of_its_border():
    camera, pose = mast_camera(40), standing(3.0, -2.0, yaw_deg=120.0)
    outline = footprint(camera, SIZE, pose, LEVEL, 60.0)
    np.testing.assert_array_equal(outline[0], outline[-1])
    ground = np.column_stack([outline[:, 1], outline[:, 0], np.zeros(len(outline))])
    image = camera.project(pose.inverse.apply(ground))
    on_border = np.abs(np.abs(image - 511.5).max(axis=1) - 512.0)
    np.testing.assert_allclose(on_border, 0, atol=1e-6)


def test_a_frame_with_sky_reaches_the_stated_range():
    outline = footprint(mast_camera(5), SIZE, standing(), LEVEL, 30.0)
    distance = np.hypot(*outline.T)
    assert distance.max() == pytest.approx(30.0)
    assert distance.min() == pytest.approx(
        1.5 / np.tan(np.radians(5) + np.arctan(512 / 1222)), rel=1e-6
    )
    azimuth = np.degrees(np.arctan2(*outline.T))
    assert np.abs(azimuth).max() == pytest.approx(np.degrees(np.arctan(512 / 1222)), abs=4)


@given(
    dip_deg=st.floats(-15, 60),
    roll_deg=st.floats(-15, 15),
    pitch_deg=st.floats(-15, 15),
    yaw_deg=st.floats(-180, 180),
    focal_px=st.sampled_from([450.0, 1222.0, 3580.0]),
)
def test_outlines_do_not_cross_themselves_at_any_attitude(
    dip_deg, roll_deg, pitch_deg, yaw_deg, focal_px
):
    rotation = rotation_of_roll_pitch_yaw(*np.radians([roll_deg, pitch_deg, yaw_deg]))
    pose = Pose(LSL, rover_frame(1, 0), rotation, np.array([10.0, -20.0, 0.5]))
    outline = footprint(mast_camera(dip_deg, focal_px), SIZE, pose, Ground(-0.5), 30.0)
    if len(outline) > 3:
        assert np.hypot(*(outline - [-20.0, 10.0]).T).max() < 32.0
        assert Polygon(outline).is_valid


def test_a_frame_of_sky_shows_no_ground():
    assert footprint(mast_camera(-40), SIZE, standing(), LEVEL, 30.0).shape == (0, 2)


def test_with_a_terrain_model_the_outline_lies_on_the_terrain(scenes):
    dtm = scenes.dtm_of(lambda e, n: 0.15 * n + 0.0 * e, side=400)
    camera, pose = mast_camera(35), standing(0.0, -1.5)
    flat = footprint(camera, SIZE, pose, LEVEL, 30.0)
    outline = footprint(camera, SIZE, pose, Ground(0.0, dtm), 30.0)
    assert outline[:, 1].max() < flat[:, 1].max() - 0.1  # rising ground is met earlier
    ground = np.column_stack([outline[:, 1], outline[:, 0], -0.15 * outline[:, 1]])
    image = camera.project(pose.inverse.apply(ground))
    np.testing.assert_allclose(np.abs(image - 511.5).max(axis=1), 512.0, atol=0.5)


def test_outside_the_terrain_model_the_plane_is_used(scenes):
    dtm = scenes.dtm_of(scenes.level)
    dtm.elevation[:] = np.nan
    with_model = footprint(mast_camera(30), SIZE, standing(), Ground(0.2, dtm), 30.0)
    np.testing.assert_allclose(
        with_model, footprint(mast_camera(30), SIZE, standing(), Ground(0.2), 30.0)
    )


def test_a_rover_placed_in_a_site_is_refused():
    with pytest.raises(TerrainError, match=r"not of site\[1\]"):
        footprint(mast_camera(30), SIZE, standing(frame=site_frame(1)), LEVEL, 30.0)
