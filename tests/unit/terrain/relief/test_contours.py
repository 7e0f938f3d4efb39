"""Contours of surfaces whose contours are known."""

import numpy as np
import pytest
from shapely import STRtree
from shapely.geometry import LineString

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.relief.contours import (
    ContourParams,
    RegionContourParams,
    interval_by_relief,
    trace_contours,
)

PARAMS = ContourParams(interval_m=0.1)


def cone(east, north):
    return 1.03 - np.hypot(east, north) / 2


def test_contours_of_a_cone_are_circles(scenes):
    dtm = scenes.dtm_of(cone, side=256)
    contours = [c for c in trace_contours(dtm.elevation, dtm.grid, PARAMS) if c.elevation_m < 0.8]
    closed = [c for c in contours if (c.points[0] == c.points[-1]).all()]
    assert [c.elevation_m for c in closed if c.elevation_m > -1.4] == pytest.approx(
        np.arange(-1.3, 0.75, 0.1)
    )
    for contour in closed:
        radius = np.hypot(*contour.points.T)
        # a Gaussian of 0.2 m lowers a cone by slope x sigma^2 / (2 r) only; at the edge of the
        # model the Gaussian is cut off
        np.testing.assert_allclose(radius, 2 * (1.03 - contour.elevation_m), atol=0.06)


def test_every_fifth_contour_is_an_index_contour(scenes):
    dtm = scenes.dtm_of(cone, side=256)
    for contour in trace_contours(dtm.elevation, dtm.grid, PARAMS):
        assert contour.is_index == (round(contour.elevation_m / 0.1) % 5 == 0)


def meeting(contours):
    """Pairs of different contours that cross or touch, and those that meet themselves."""
    lines = [LineString(contour.points) for contour in contours]
    a, b = STRtree(lines).query(lines, predicate="intersects")
    return int((a != b).sum()) + sum(not line.is_simple for line in lines)


def rubble(east, north):
    return np.sin(3 * east) * np.cos(2 * north)


@pytest.mark.parametrize("simplify_m", [0.0, 0.02, 0.1, 0.4])
def test_contours_never_cross_or_touch(scenes, rng, simplify_m):
    dtm = scenes.dtm_of(rubble, side=200)
    dtm.elevation[:] += rng.normal(0, 0.05, dtm.grid.shape)
    params = ContourParams(interval_m=0.05, smoothing_m=0.1, simplify_m=simplify_m)
    contours = trace_contours(dtm.elevation, dtm.grid, params)
    assert len(contours) > 100
    assert meeting(contours) == 0


def test_contours_do_not_touch_where_nodes_lie_on_their_elevation(scenes, rng):
    dtm = scenes.dtm_of(rubble, side=64)
    dtm.elevation[:] = rng.integers(-3, 4, dtm.grid.shape) * np.float32(0.1)
    params = ContourParams(interval_m=0.1, smoothing_m=0.0, min_length_m=0.0, simplify_m=0.03)
    contours = trace_contours(dtm.elevation, dtm.grid, params)
    assert len(contours) > 500
    assert meeting(contours) == 0


def test_simplified_contours_stay_near_the_exact_ones(scenes):
    dtm = scenes.dtm_of(cone, side=256)
    traced, simple = (
        trace_contours(dtm.elevation, dtm.grid, ContourParams(interval_m=0.1, simplify_m=tolerance))
        for tolerance in (0.0, 0.02)
    )
    assert [c.elevation_m for c in traced] == [c.elevation_m for c in simple]
    before, after = (sum(len(c.points) for c in some) for some in (traced, simple))
    assert after < before / 3
    for one, other in zip(traced, simple, strict=True):
        assert LineString(one.points).hausdorff_distance(LineString(other.points)) < 0.0201


def test_regions_have_contours_every_metre():
    assert RegionContourParams().interval_m == 1.0


def test_contours_stop_at_unseen_ground(scenes):
    dtm = scenes.dtm_of(lambda e, n: 0.3 * n + 0.0 * e, side=256)
    east = np.meshgrid(*dtm.grid.centres())[0]
    dtm.elevation[np.abs(east) < 1.0] = np.nan
    contours = trace_contours(dtm.elevation, dtm.grid, PARAMS)
    assert len(contours) > 20
    assert min(np.abs(contour.points[:, 0]).min() for contour in contours) > 0.9


def test_a_missing_cell_does_not_break_a_contour(scenes):
    dtm = scenes.dtm_of(lambda e, n: 0.3 * n + 0.0 * e, side=256)
    whole = trace_contours(dtm.elevation, dtm.grid, PARAMS)
    dtm.elevation[::9, ::9] = np.nan
    assert len(trace_contours(dtm.elevation, dtm.grid, PARAMS)) == len(whole)


def test_short_contours_are_left_out(scenes):
    dtm = scenes.dtm_of(cone, side=256)
    for contour in trace_contours(dtm.elevation, dtm.grid, PARAMS):
        assert np.hypot(*np.diff(contour.points, axis=0).T).sum() >= PARAMS.min_length_m


@pytest.mark.parametrize(
    ("relief_m", "interval_m"), [(15.0, 1.0), (16.0, 2.0), (3.1, 0.25), (0.7, 0.05), (60.0, 5.0)]
)
def test_the_interval_is_round_and_follows_the_relief(relief_m, interval_m):
    heights = np.linspace(0, relief_m / 0.98, 1001)
    assert interval_by_relief(heights, 15) == pytest.approx(interval_m)


def test_an_empty_model_has_no_contours(scenes):
    dtm = scenes.dtm_of(scenes.level)
    dtm.elevation[:] = np.nan
    assert trace_contours(dtm.elevation, dtm.grid, ContourParams()) == ()


def test_an_interval_of_zero_is_an_error():
    with pytest.raises(TerrainError, match="must be above zero"):
        ContourParams(interval_m=0.0)
