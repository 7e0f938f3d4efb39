"""Links between simulated stops, held against the truth: rates, false links, errors, covariances.

Three worlds, one on each terrain, four stops each: 18 pairs that share ground, 9 to 43 m apart, and
12 of stops of different worlds that telemetry claims to be 8 to 30 m apart. The whole table, with
twice as many and the rendered stops: `python -m tests.support`.
"""

import numpy as np
import pytest

from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams, tie_cross_site
from solmap.photogrammetry.matching.cross_site.links import LinkTestParams
from solmap.photogrammetry.matching.cross_site.surface_matching import SurfaceTieParams
from tests.support.site_pairs import (
    WORLDS,
    SitePair,
    Views,
    evaluated,
    matched_stops,
    negative_pairs,
    positive_pairs,
    stops_of,
)

pytestmark = pytest.mark.slow
NEAR_WORLDS = WORLDS[:3]


def outcomes(pairs, params):
    views, every = Views(params), []
    for pair in pairs:
        stops = stops_of(pair)
        first, second = (views.of(stop) for stop in matched_stops(pair, *stops))
        every.append(evaluated(pair, *stops, tie_cross_site(first, second, params), 0.0))
    return every


@pytest.fixture(scope="module")
def shared():
    return outcomes(positive_pairs(NEAR_WORLDS), CrossSiteParams())


def test_stops_up_to_25_m_apart_are_linked(shared):
    near = [outcome for outcome in shared if outcome.distance_m <= 25]
    assert len(near) >= 10
    missed = [str(outcome) for outcome in near if not outcome.linked]
    assert len(missed) <= 0.05 * len(near), missed


def test_nine_of_ten_stops_25_to_40_m_apart_are_linked(shared):
    far = [outcome for outcome in shared if 25 < outcome.distance_m <= 40]
    assert far
    missed = [str(outcome) for outcome in far if not outcome.linked]
    assert len(missed) <= 0.1 * len(far), missed


def test_no_link_is_false(shared):
    assert [str(outcome) for outcome in shared if outcome.is_false] == []


def test_links_place_the_rover_to_some_tenths_of_a_per_cent(shared):
    share = [o.error_m / o.distance_m for o in shared if o.linked and o.distance_m <= 25]
    assert np.median(share) < 0.003


def test_errors_of_links_agree_with_their_covariances(shared):
    nees = [outcome.nees for outcome in shared if outcome.linked]
    # the mean of n chi-squares of 6 freedoms over 6 scatters by sqrt(1 / 3n): 0.15 at 15 links
    assert 0.3 < np.mean(nees) < 2.0


@pytest.mark.parametrize(
    ("world", "earlier", "later", "off_m"),
    [
        (WORLDS[1], 0, 3, (-21.0, 20.0)),  # as Di et al. (2008), section 4: 29 m over 38 m
        (WORLDS[0], 0, 1, (9.2, 0.0)),  # the rover went nowhere near as far as its wheels turned
        (WORLDS[2], 1, 2, (-14.0, 9.0)),
    ],
)
def test_a_stop_is_linked_after_total_wheel_slip(world, earlier, later, off_m):
    pair = SitePair((world, earlier), (world, later))
    one, other = stops_of(pair)
    reported, here = other.matched.lsl_from_rover, one.matched.lsl_from_rover
    true = here.translation_m + here.rotation @ (one.true.inverse @ other.true).translation_m
    place = true + np.array([*off_m, 0.0])
    spun = other.reported_at(Pose(reported.target, reported.source, reported.rotation, place))
    link = tie_cross_site(one.matched, spun, CrossSiteParams())
    outcome = evaluated(pair, one, other, link, 0.0)
    assert outcome.linked, outcome
    assert not outcome.is_false, outcome


@pytest.mark.parametrize(
    ("least_z", "surface_matching"), [(LinkTestParams().least_z, True), (0.0, True), (0.0, False)]
)
def test_stops_without_common_ground_are_not_linked(least_z, surface_matching):
    # with a least z of 0 every pair is tried in the images: the last test decides
    params = CrossSiteParams(
        link_test=LinkTestParams(least_z=least_z),
        surface_matching=SurfaceTieParams(enabled=surface_matching),
    )
    foreign = outcomes(negative_pairs(NEAR_WORLDS), params)
    assert len(foreign) >= 12
    assert [str(outcome) for outcome in foreign if outcome.linked] == []
