"""Which stops are mapped together."""

from hypothesis import given
from hypothesis import strategies as st

from solmap.photogrammetry.terrain.dtm.region_dtm import regions_of


def around(east: float, north: float, half: float = 30.0) -> tuple[float, float, float, float]:
    return (east - half, north - half, east + half, north + half)


def test_stops_whose_ground_meets_make_one_region_and_the_next_begins_far_away():
    stops = [around(0.0, 0.0), around(20.0, 0.0), around(70.0, 10.0), around(500.0, 0.0)]
    assert regions_of(stops, 700.0) == [[0, 1, 2], [3]]


def test_a_region_ends_where_it_would_grow_too_large():
    stops = [around(40.0 * k, 0.0) for k in range(6)]
    assert regions_of(stops, 150.0) == [[0, 1, 2], [3, 4, 5]]


places = st.lists(st.tuples(st.floats(-300, 300), st.floats(-300, 300)), max_size=12)


@given(places=places, more=places)
def test_a_longer_traverse_changes_the_last_region_at_most(places, more):
    before = regions_of([around(*place) for place in places], 200.0)
    after = regions_of([around(*place) for place in places + more], 200.0)
    assert after[: max(0, len(before) - 1)] == before[:-1]
    if before:
        assert after[len(before) - 1][: len(before[-1])] == before[-1]


@given(places=places)
def test_every_stop_is_in_one_region(places):
    regions = regions_of([around(*place) for place in places], 200.0)
    assert sorted(k for region in regions for k in region) == list(range(len(places)))
