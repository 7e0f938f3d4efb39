"""Poses CSV: columns, units, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from solmap.photogrammetry.archive.tables.pose_table import is_pose_table, parse_poses
from solmap.photogrammetry.errors import VectorFileError
from solmap.photogrammetry.frames import (
    quaternion_of_rotation,
    rotation_of_roll_pitch_yaw,
)

QUATERNION = quaternion_of_rotation(rotation_of_roll_pitch_yaw(*np.radians([1.0, 2.0, 120.0])))


def test_rows_by_image_or_counters_come_with_attitude_sigmas_and_source():
    text = (
        "# total station, 3 June\n\n"
        "image, site, drive, reference_site, x_m, y_m, z_m, qw, qx, qy, qz, sigma_m, source\n"
        f"2n292280938.img,,,,1,2.5,-3,{','.join(map(repr, QUATERNION.tolist()))},0.05,survey\n"
        ",10,64,0,100,50,1,,,,,,\n"
    )
    assert is_pose_table(text)
    by_image, by_stop = parse_poses(text, "poses.csv")
    assert (by_image.image, by_image.site, by_image.source) == ("2N292280938", None, "survey")
    np.testing.assert_allclose(by_image.quaternion, QUATERNION)
    np.testing.assert_array_equal(by_image.position_m, [1.0, 2.5, -3.0])
    assert (by_image.sigma_m, by_image.sigma_deg) == (0.05, None)
    assert (by_stop.image, by_stop.site, by_stop.drive, by_stop.reference_site) == (None, 10, 64, 0)
    assert (by_stop.quaternion, by_stop.sigma_m) == (None, None)


def test_angles_and_quaternion_give_the_same_attitude():
    text = "site,drive,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,sigma_deg\n1,2,0,0,0,1,2,120,0.5\n"
    (row,) = parse_poses(text, "poses.csv")
    np.testing.assert_allclose(row.quaternion, QUATERNION, atol=1e-12)
    assert row.sigma_deg == 0.5


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("x_m,y_m,z_m\n1,2,3\n", r"poses\.csv: .* lacks image, or site and drive"),
        ("site,drive,x_m,y_m,z_m,heading\n", "has 'heading'"),
        ("site,drive,x_m,y_m,z_m\n", "expected at least one pose"),
        ("site,drive,x_m,y_m,z_m\n1,,0,0,0\n", r"poses\.csv, row 1: the stop is missing"),
        ("site,drive,x_m,y_m,z_m\n1,2,0,0,north\n", "x_m, y_m, z_m should be numbers"),
        ("site,drive,x_m,y_m,z_m\n1,2,0,0,\n", "x_m, y_m, z_m should be numbers"),
        ("site,drive,x_m,y_m,z_m,qw,qx,qy,qz\n1,2,0,0,0,2,0,0,0\n", "not a unit quaternion"),
        ("site,drive,x_m,y_m,z_m,qw,qx,qy,qz\n1,2,0,0,0,1,0,0,\n", "qw, qx, qy, qz should be num"),
        ("site,drive,x_m,y_m,z_m,sigma_m\n1,2,0,0,0,0\n", "sigma_m is a standard deviation"),
        ("site,drive,x_m,y_m,z_m\n1.5,2,0,0,0\n", "site should be a whole number"),
    ],
)
def test_every_fault_is_named_with_its_row(text, wrong):
    with pytest.raises(VectorFileError, match=wrong):
        parse_poses(text, "poses.csv")
