"""Which cells without an elevation could not be seen, and which might have been."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.terrain.dtm.records import GroundClass
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams, build_dtm

UNSEEN, MEASURED, INTERPOLATED, OCCLUDED = GroundClass
PARAMS = DtmParams(max_relative_sigma=0.05)


def ahead(dtm, low, high, aside=0.3):
    """Classes between two distances north of the camera."""
    east, north = np.meshgrid(*dtm.grid.centres())
    return dtm.ground[(np.abs(east) < aside) & (north > low) & (north < high)]


@pytest.fixture(scope="module")
def boulder(scenes):
    return scenes.view_of(scenes.with_boulder)


def test_ground_hidden_by_a_boulder_ends_at_the_line_over_its_top(boulder):
    # the mast is 1.5 m high, the boulder 0.5 m, its far edge at 6 m: its shadow ends at 9 m
    dtm = build_dtm([boulder], PARAMS)
    assert (ahead(dtm, 6.1, 8.8) == OCCLUDED).all()
    beyond = ahead(dtm, 9.2, 9.6)
    assert np.isin(beyond, (MEASURED, INTERPOLATED)).mean() > 0.9


def test_occluded_ground_has_no_elevation(boulder):
    dtm = build_dtm([boulder], PARAMS)
    assert np.isnan(dtm.elevation[dtm.ground == OCCLUDED]).all()
    assert np.isnan(dtm.sigma_m[dtm.ground == OCCLUDED]).all()


def test_a_hole_in_the_matching_of_open_ground_is_not_occluded(scenes):
    view = scenes.view_of(scenes.level)
    hole = view.parallax.copy()
    hole[110:150, 100:156] = np.nan  # such as a shadow
    dtm = build_dtm([replace(view, parallax=hole)], PARAMS)
    whole = build_dtm([view], PARAMS, dtm.grid)
    lost = (whole.ground != UNSEEN) & ~np.isfinite(dtm.elevation)
    assert lost.sum() > 500
    assert (dtm.ground[lost] == UNSEEN).mean() > 0.95


def test_ground_hidden_in_one_pair_and_outside_another_is_unseen(scenes, boulder):
    beside = scenes.view_of(scenes.level, pair=1, camera=(4.0, 7.0, 1.5), azimuth_deg=-90)
    blind = replace(beside, parallax=np.full_like(beside.parallax, np.nan))
    alone, both = build_dtm([boulder], PARAMS), build_dtm([boulder, blind], PARAMS)
    assert (ahead(alone, 6.5, 7.5) == OCCLUDED).all()
    assert (ahead(both, 6.5, 7.5) == UNSEEN).mean() > 0.9


def test_a_hollow_behind_a_crest_is_occluded_although_its_far_side_is_higher(scenes):
    def hollow(east, north):
        walls = np.where(north < 5.0, 0.2 * north, np.maximum(0.4 * (north - 7.5), -0.5))
        return walls + 0.0 * east

    dtm = build_dtm([scenes.view_of(hollow, dip_deg=5)], PARAMS)
    # from 1.5 m above, past the crest (1.0 m at 5 m), sight meets the far wall at 9 m
    assert (ahead(dtm, 5.2, 8.6) == OCCLUDED).mean() > 0.95


def test_ground_outside_the_field_and_beyond_the_reach_is_unseen(scenes):
    dtm = build_dtm([scenes.view_of(scenes.level)], PARAMS)
    east, north = np.meshgrid(*dtm.grid.centres())
    assert (dtm.ground[north < 0] == UNSEEN).all()
    assert (dtm.ground[np.hypot(east, north) > 14.0] == UNSEEN).all()  # f B 0.05 / 0.25 px = 12 m
