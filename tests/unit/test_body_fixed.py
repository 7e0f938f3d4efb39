import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.errors import FrameError
from solmap.photogrammetry.frames import BODY_FIXED, LSL, FrameTree, Pose, site_frame
from solmap.photogrammetry.mars import (
    MARS_RADIUS_M,
    MarsPoint,
    body_fixed,
    body_from_lsl,
    geographic,
    map_from_lsl,
    planetocentric,
    planetographic,
)

GUSEV = MarsPoint(math.radians(175.4729), math.radians(-14.5692))


def on_the_sphere(east_m, north_m):
    """The point of the LSL at Gusev that lies on the sphere above (east, north)."""
    down = MARS_RADIUS_M - math.sqrt(MARS_RADIUS_M**2 - east_m**2 - north_m**2)
    return np.array([[north_m, east_m, down]])


def test_sites_of_spirit_come_to_the_longitudes_and_latitudes_of_proj(test_vectors):
    for row in test_vectors["map_coordinates"]["points"]:
        point = on_the_sphere(*row["east_north_m"])
        longitude, latitude, radius = geographic(body_from_lsl(GUSEV).apply(point))
        found = np.degrees([longitude[0], latitude[0]])
        np.testing.assert_allclose(found, row["lon_lat_deg"], atol=1e-10)  # 6 micrometres
        assert radius[0] == pytest.approx(MARS_RADIUS_M, abs=1e-6)
        equirectangular = MARS_RADIUS_M * np.array([longitude[0], latitude[0]])
        np.testing.assert_allclose(equirectangular, row["iau_2015_49910_xy"], atol=1e-3)
        np.testing.assert_allclose(map_from_lsl(point)[0, :2], row["east_north_m"])


def test_level_leaves_the_sphere_by_the_square_of_the_distance():
    for metres, leaves_m in ((1_000, 0.147), (5_000, 3.68), (10_000, 14.72)):
        point = np.array([[0.0, float(metres), 0.0]])
        radius = geographic(body_from_lsl(GUSEV).apply(point))[2][0]
        assert radius - MARS_RADIUS_M == pytest.approx(leaves_m, abs=0.005)


@given(
    longitude=st.floats(-3.1, 3.1),
    latitude=st.floats(-1.5, 1.5),
    radius=st.floats(3.3e6, 3.4e6),
)
def test_the_landing_point_is_the_origin_of_its_lsl(longitude, latitude, radius):
    pose = body_from_lsl(MarsPoint(longitude, latitude, radius))
    assert (pose.target, pose.source) == (BODY_FIXED, LSL)
    back = [values[0] for values in geographic(pose.apply(np.zeros((1, 3))))]
    np.testing.assert_allclose(back[:2], [longitude, latitude], atol=1e-12)
    assert back[2] == pytest.approx(radius, abs=1e-6)
    np.testing.assert_allclose(
        body_fixed(*(np.array([value]) for value in back)), pose.apply(np.zeros((1, 3))), atol=1e-6
    )


def test_north_of_the_landing_point_is_north_and_east_is_east():
    pose = body_from_lsl(GUSEV)
    ways = pose.apply(np.array([[1000.0, 0.0, 0.0], [0.0, 1000.0, 0.0], [0.0, 0.0, -1000.0]]))
    longitude, latitude, radius = geographic(ways)
    assert latitude[0] > GUSEV.latitude
    assert longitude[0] == pytest.approx(GUSEV.longitude, abs=1e-12)
    assert longitude[1] > GUSEV.longitude
    assert radius[2] == pytest.approx(MARS_RADIUS_M + 1000)


def test_a_tree_reaches_from_a_site_to_the_body():
    tree = FrameTree().adding(
        [body_from_lsl(GUSEV), Pose(LSL, site_frame(3), np.eye(3), np.array([1.0, 2.0, 3.0]))]
    )
    assert tree.root_of(site_frame(3)) == BODY_FIXED
    body_from_site = tree.pose(BODY_FIXED, site_frame(3))
    assert np.linalg.norm(body_from_site.translation_m) == pytest.approx(MARS_RADIUS_M - 3, abs=1)


def test_planetographic_latitude_is_that_of_the_facts(test_vectors):
    row = test_vectors["map_coordinates"]["latitudes"]
    centric, graphic = (math.radians(row[f"planeto{kind}_deg"]) for kind in ("centric", "graphic"))
    assert planetographic(centric) == pytest.approx(graphic, abs=1e-10)
    assert planetocentric(planetographic(centric)) == pytest.approx(centric, abs=1e-15)


def test_degrees_in_place_of_radians_are_refused():
    with pytest.raises(FrameError, match="radians, not degrees"):
        MarsPoint(175.4729, -14.5692)
