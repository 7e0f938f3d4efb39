"""Contours of surfaces whose contours are known."""

import numpy as np
import pytest
from shapely import STRtree
from shapely.geometry import LineString

from photogrammetry.errors import TerrainError
from photogrammetry.terrain.contours import ContourParams, interval_by_relief, trace_contours

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


def test_contours_never_cross(scenes, rng):
    dtm = scenes.dtm_of(lambda e, n: np.sin(3 * e) * np.cos(2 * n), side=200)
    dtm.elevation[:] += rng.normal(0, 0.05, dtm.grid.shape)
    contours = trace_contours(dtm.elevation, dtm.grid, PARAMS)
    lines = [LineString(contour.points) for contour in contours]
    levels = np.array([contour.elevation_m for contour in contours])
    a, b = STRtree(lines).query(lines, predicate="intersects")
    assert len(lines) > 20
    assert (levels[a] == levels[b]).all()


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


def test_scraps_are_left_out(scenes):
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


def test_an_interval_of_nothing_is_an_error():
    with pytest.raises(TerrainError, match="give one above zero"):
        ContourParams(interval_m=0.0)
