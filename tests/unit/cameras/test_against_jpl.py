"""The numbers of JPL's own C library (tests/fixtures/jpl_vectors.json)."""

import numpy as np
import pytest

from solmap.photogrammetry.cameras.cahv import Cahv, interior_orientation
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.frames import (
    LSL,
    Frame,
    FrameKind,
    FrameTree,
    Pose,
    roll_pitch_yaw_of_rotation,
    rotation_of_quaternion,
    rover_frame,
    site_frame,
)

PIXELS = 1e-9
"""The vectors carry 12 decimals, the largest disagreement of their two sources is 3e-13 px."""


def rows(test_vectors, table, name, *columns):
    """Columns of a table's rows for one camera, as arrays."""
    chosen = [row for row in test_vectors[table] if row["camera"] == name]
    return [np.array([row[column] for row in chosen], dtype=float) for column in columns]


def test_every_camera_projects_like_jpls_library(test_vectors, cameras):
    for name, camera in cameras.items():
        assert isinstance(camera, CameraModel)
        points, pixels = rows(test_vectors, "point_to_pixel", name, "point", "pixel")
        assert len(points) == 6
        np.testing.assert_allclose(camera.project(points), pixels, atol=PIXELS, err_msg=name)


def test_every_camera_has_jpls_rays(test_vectors, cameras):
    for name, camera in cameras.items():
        pixels, origins, directions = rows(
            test_vectors, "pixel_to_ray", name, "pixel", "origin", "direction"
        )
        assert len(pixels) == 6
        np.testing.assert_allclose(camera.rays(pixels), directions, atol=2e-12, err_msg=name)
        np.testing.assert_allclose(camera.ray_origins(pixels), origins, atol=2e-12, err_msg=name)


def test_every_partial_derivative_equals_jpls(test_vectors, cameras):
    for name, camera in cameras.items():
        points, expected = rows(test_vectors, "partials", name, "point", "d_sample_line_d_point")
        image_points, partials = camera.partials(points)
        largest = np.abs(expected).max()
        np.testing.assert_allclose(partials / largest, expected / largest, atol=1e-12)
        np.testing.assert_array_equal(image_points, camera.project(points))


def test_the_interior_orientation_equals_jpls(test_vectors, cameras):
    for row in test_vectors["internal_parameters"]:
        camera = cameras[row["camera"]]
        inner = interior_orientation(camera.a, camera.h, camera.v)
        found = [inner.hs, inner.vs, inner.hc, inner.vc, np.degrees(inner.theta)]
        expected = [row[key] for key in ("hs", "vs", "hc", "vc", "theta_deg")]
        np.testing.assert_allclose(found, expected, atol=1e-8)


def test_quaternions_rotate_rover_vectors_into_the_site(test_vectors):
    for row in test_vectors["quaternions"]:
        rotation = rotation_of_quaternion(np.array(row["quaternion_scalar_first"]))
        np.testing.assert_allclose(rotation, row["site_from_rover"], atol=1e-12)
        angles = np.degrees(roll_pitch_yaw_of_rotation(rotation))
        np.testing.assert_allclose(angles, row["roll_pitch_yaw_deg"], atol=1e-8)
        for key in ("vector", "point"):
            if f"{key}_in_rover" in row:
                offset = np.array(row.get("offset", [0.0, 0.0, 0.0]))
                site = rotation @ np.array(row[f"{key}_in_rover"]) + offset
                np.testing.assert_allclose(site, row[f"{key}_in_site"], atol=1e-11)


def test_azimuths_and_elevations_of_the_label_follow_from_the_quaternion(test_vectors):
    for row in test_vectors["quaternions"]:
        if "rover_azimuth_elevation" not in row:
            continue
        azimuth, elevation = np.radians(row["rover_azimuth_elevation"])
        forward = np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                -np.sin(elevation),
            ]
        )
        x, y, z = rotation_of_quaternion(np.array(row["quaternion_scalar_first"])) @ forward
        found = np.degrees([np.arctan2(y, x), np.arcsin(-z)])
        np.testing.assert_allclose(found, row["site_azimuth_elevation_computed"], atol=1e-6)
        # A label's angles have six digits.
        np.testing.assert_allclose(found, row["site_azimuth_elevation_label"], atol=2e-3)


def mast_pose(quaternion, origin):
    """The mast in the rover, of a label's numbers."""
    mast, rover = Frame(FrameKind.MAST), rover_frame(0, 0)
    return Pose.of_quaternion(rover, mast, np.array(quaternion), np.array(origin))


def test_the_mast_points_in_the_direction_of_the_label(test_vectors):
    for row in test_vectors["mast_kinematics"][:4]:
        x, y, z = mast_pose(row["mast_quaternion_in_rover"], [0.0, 0.0, 0.0]).rotation[:, 0]
        found = np.degrees([np.arctan2(y, x), np.arcsin(-z)])
        np.testing.assert_allclose(found, row["mast_x_axis_azimuth_elevation_computed"], atol=1e-6)


def test_a_camera_moved_by_the_mast_equals_that_of_the_next_label(test_vectors, cameras):
    before, after, *_, carried = test_vectors["mast_kinematics"]
    origin = before["mast_origin_in_rover"]
    rover_from_mast_before = mast_pose(before["mast_quaternion_in_rover"], origin)
    rover_from_mast_after = mast_pose(after["mast_quaternion_in_rover"], origin)
    camera = cameras["navcam_left_spirit_sol767"].transform(
        rover_from_mast_after @ rover_from_mast_before.inverse
    )
    for key, expected in carried["predicted"].items():
        np.testing.assert_allclose(getattr(camera, key.lower()), expected, atol=1e-6)
    points = camera.rays(np.random.default_rng(0).uniform(0, 1023, (50, 2))) * 10 + camera.c
    of_label = cameras[carried["label_camera"]]
    # A label gives C to 0.01 mm and H, V to 0.01 px.
    np.testing.assert_allclose(camera.project(points), of_label.project(points), atol=0.02)


def test_sub_frame_and_averaging_give_the_model_of_the_label(test_vectors, cameras):
    (row,) = test_vectors["subframe_and_averaging"]
    origin = row["mast_origin_in_rover"]
    full = mast_pose(row["full_frame_mast_quaternion"], origin)
    sub = mast_pose(row["sub_frame_mast_quaternion"], origin)
    there = cameras[row["full_frame_camera"]].transform(sub @ full.inverse)
    cut = there.subframe(row["first_line_sample_1_based"] - 1, row["first_line_1_based"] - 1)
    size = row["pixel_averaging_width"], row["pixel_averaging_height"]
    as_in_label = cut.average(*size, correct_half_pixel=False)
    for key, expected in row["predicted"].items():
        np.testing.assert_allclose(getattr(as_in_label, key.lower()), expected, atol=1e-6)
    corrected = cut.average(*size)
    inner = interior_orientation(corrected.a, corrected.h, corrected.v)
    # The facts subtract (1 - s)/2 |A|^2 of the label's model, which has six digits.
    np.testing.assert_allclose(
        [inner.hc, inner.vc], row["hc_vc_if_pixel_centres_are_integers"], atol=5e-3
    )


def test_the_stereo_pair_of_the_facts_triangulates_its_points(test_vectors, cameras):
    stereo = test_vectors["stereo"]
    left, right = cameras[stereo["left"]], cameras[stereo["right"]]
    common = {k.lower(): np.array(v) for k, v in stereo["linearised_common_model_mer_era"].items()}
    for row in stereo["points"]:
        point = np.array([row["point_in_rover"]])
        for camera, key in ((left, "left"), (right, "right")):
            assert isinstance(camera, Cahvor)
            np.testing.assert_allclose(camera.project(point)[0], row[f"{key}_pixel"], atol=PIXELS)
            linear = Cahv(c=camera.c, **common).project(point)[0]
            # The common model is given with nine decimals.
            np.testing.assert_allclose(linear, row[f"linearised_{key}_pixel"], atol=1e-6)


def test_the_papers_equations_place_a_camera_in_the_landing_frame(test_vectors, cameras):
    """Equations (1) and (2) of Di et al. 2008: M = M_R M_S M_0, C by the three origins."""
    row = test_vectors["site_chain"]["camera_to_lsl"]
    site, rover = site_frame(row["site"]), rover_frame(row["site"], 100)
    tree = FrameTree().with_poses(
        [
            Pose(LSL, site, np.eye(3), np.array(row["site_origin_in_lsl"])),
            Pose.of_quaternion(
                site,
                rover,
                np.array(row["rover_quaternion_scalar_first"]),
                np.array(row["rover_offset_in_site"]),
            ),
        ]
    )
    camera = cameras[row["camera"]]
    lsl_from_rover = tree.pose(LSL, rover)
    np.testing.assert_allclose(
        camera.transform(lsl_from_rover).centre, row["C_lsl_north_east_down"], atol=1e-6
    )
    m_r, m_s = np.array(row["MR_camera_from_rover_rows"]), np.array(row["MS_rover_from_site"])
    np.testing.assert_allclose(m_s, lsl_from_rover.rotation.T, atol=1e-9)
    np.testing.assert_allclose(m_r @ m_s, row["M_camera_from_lsl"], atol=2e-9)
    inner = interior_orientation(camera.a, camera.h, camera.v)
    right = (camera.h - inner.hc * camera.a) / inner.hs
    np.testing.assert_allclose(right, m_r[0], atol=1e-9)


def test_a_vector_of_wrong_length_is_refused(cameras):
    camera = cameras["navcam_left_spirit_sol1869_linearised"]
    with pytest.raises(
        Exception, match="A of a camera model should be a unit vector, but has length 2"
    ):
        Cahv(camera.c, 2 * camera.a, camera.h, camera.v)
