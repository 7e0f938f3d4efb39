"""Winter havens on ground where it is known how much light it receives."""

import math

import numpy as np
import pytest
from shapely.geometry import Polygon

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.insolation.maps import (
    HavenParams,
    InsolationParams,
    insolation,
    winter_havens,
)

GUSEV = math.radians(-14.735)
PARAMS = HavenParams()


def ridge(east, north):
    """Level ground with a bank in the middle that falls to the north by 15 degrees, 4 by 6 m."""
    rise = np.clip(2.0 - north, 0.0, 4.0) * math.tan(math.radians(15.0))
    return np.where((np.abs(east) < 3.0), rise, 0.0)


def lit(scenes, surface, latitude=GUSEV, side=512):
    dtm = scenes.dtm_of(surface, side=side)
    return insolation(dtm, latitude, InsolationParams())


def test_ground_tilted_to_the_winter_sun_is_a_haven(scenes):
    (haven, *others) = winter_havens(lit(scenes, ridge), GUSEV, PARAMS)
    shape = Polygon(haven.outline)
    assert haven.area_m2 == pytest.approx(shape.area, rel=0.05)
    assert 15.0 < haven.area_m2 < 26.0
    assert abs(shape.centroid.x) < 0.3
    assert abs(shape.centroid.y) < 0.5
    assert haven.gain == pytest.approx(1.106, abs=0.005)  # of an endless slope of 15 degrees
    assert haven.insolation / haven.gain == pytest.approx(lit(scenes, ridge).level[0], rel=1e-4)
    assert 12.0 < haven.tilt_to_sun_deg <= 15.5
    assert not others


def test_in_the_north_havens_tilt_to_the_south(scenes):
    north = -GUSEV
    assert not winter_havens(lit(scenes, ridge, north), north, PARAMS)
    (haven,) = winter_havens(lit(scenes, lambda e, n: ridge(e, -n), north), north, PARAMS)
    assert haven.tilt_to_sun_deg > 12.0


def test_level_ground_is_not_a_haven(scenes):
    assert winter_havens(lit(scenes, scenes.level), GUSEV, PARAMS) == ()


def test_in_polar_night_there_is_no_haven(scenes):
    north = math.radians(80.0)
    light = lit(scenes, ridge, north)
    assert light.level == (0.0,)
    assert np.nanmax(light.received[0]) == 0.0
    assert winter_havens(light, north, PARAMS) == ()


def test_a_haven_too_small_or_narrow_for_a_rover_is_left_out(scenes):
    light = lit(scenes, ridge)
    assert winter_havens(light, GUSEV, HavenParams(least_area_m2=60.0)) == ()
    assert winter_havens(light, GUSEV, HavenParams(width_m=5.0)) == ()


def test_ground_too_steep_to_drive_onto_is_not_a_haven(scenes):
    light = lit(scenes, ridge)
    assert winter_havens(light, GUSEV, HavenParams(steepest_deg=10.0)) == ()


def test_a_hole_in_a_haven_is_kept(scenes):
    def bank(east, north):
        falls = -math.tan(math.radians(15.0)) * north
        pit = np.hypot(east, north) < 1.0
        return falls + np.where(pit, 0.6 * (1 - np.hypot(east, north)), 0.0)

    largest, *_ = winter_havens(lit(scenes, bank), GUSEV, PARAMS)
    assert len(largest.holes) == 1
    hole = Polygon(largest.holes[0])
    assert abs(hole.centroid.x) < 0.5
    assert largest.area_m2 == pytest.approx(Polygon(largest.outline).area - hole.area, rel=0.02)


def test_a_haven_of_zero_width_is_an_error():
    with pytest.raises(TerrainError, match="needs a width and an area above zero"):
        HavenParams(width_m=0.0)
