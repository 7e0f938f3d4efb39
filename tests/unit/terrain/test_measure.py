import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.resampling import GroundSamples
from solmap.photogrammetry.terrain.measure.areas import (
    MOST_PLACES,
    BasePlane,
    places_inside,
    polygon_of,
    surface_ratio,
    volume,
)
from solmap.photogrammetry.terrain.measure.lines import measure_line, rise_between, stations

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def ground(elevation, own=0.02, pose=0.0):
    elevation = np.asarray(elevation, dtype=np.float64)
    known = np.isfinite(elevation)
    return GroundSamples(
        elevation,
        np.where(known, np.hypot(own, pose), np.nan),
        np.where(known, pose, np.nan),
        np.where(known, 0, -1).astype(np.int32),
    )


def test_a_line_down_a_slope_is_longer_on_the_ground_than_on_the_map():
    corners = np.array([[0.0, 0.0], [0.0, 10.0], [-10.0, 10.0]])
    along = stations(corners, 0.5)
    found = measure_line(corners, along, ground(0.75 * along.places[:, 1]))
    assert found.map_length_m == pytest.approx(20.0)
    assert found.surface_length_m == pytest.approx(12.5 + 10.0)
    assert found.measured_share == 1.0
    assert np.degrees(found.leg_azimuth) == pytest.approx([0.0, 270.0])


def test_unmeasured_ground_counts_with_its_length_on_the_map():
    corners = np.array([[0.0, 0.0], [0.0, 10.0]])
    along = stations(corners, 0.5)
    heights = np.where(along.places[:, 1] > 5, np.nan, 0.75 * along.places[:, 1])
    found = measure_line(corners, along, ground(heights))
    assert found.surface_length_m == pytest.approx(5 * 1.25 + 5.0)
    assert found.measured_share == pytest.approx(0.5)


def test_the_rise_between_two_places_forgets_what_they_share():
    places = np.array([[0.0, 0.0], [3.0, 4.0]])
    found = rise_between(places, ground([1.0, 6.0], own=0.03, pose=0.5))
    assert (found.map_length_m, found.rise_m) == (5.0, 5.0)
    assert np.degrees(found.slope) == pytest.approx(45.0)
    assert found.sigma_rise_m == pytest.approx(0.03 * np.sqrt(2))
    assert found.sigma_slope == pytest.approx(0.03 * np.sqrt(2) / 5 / 2)
    other = ground([1.0, 6.0], own=0.03, pose=0.5)
    other.source[1] = 1
    assert rise_between(places, other).sigma_rise_m == pytest.approx(np.hypot(0.03, 0.5) * 2**0.5)


def test_a_polygon_may_not_cross_itself():
    assert polygon_of(SQUARE).area == pytest.approx(100.0)
    with pytest.raises(TerrainError, match="crossing"):
        polygon_of(SQUARE[[0, 2, 1, 3]])
    with pytest.raises(TerrainError, match="crossing"):
        polygon_of(np.zeros((3, 2)))


def test_the_cells_inside_a_polygon_fill_it_and_stay_few():
    places, cell = places_inside(polygon_of(SQUARE), 0.1)
    assert len(places) * cell**2 == pytest.approx(100.0)
    places, cell = places_inside(polygon_of(1e4 * SQUARE), 0.04)
    assert len(places) <= 1.1 * MOST_PLACES
    assert len(places) * cell**2 == pytest.approx(1e10, rel=0.02)


def test_the_volume_of_a_pyramid_over_its_rim():
    places, _ = places_inside(polygon_of(SQUARE), 0.02)
    tilt = 3.0 + 0.1 * places[:, 0]
    pyramid = tilt + np.maximum(0.0, 4.0 - np.abs(places - 5.0).max(axis=1))
    rim = np.concatenate(
        [np.linspace(a, b, 40) for a, b in zip(SQUARE, np.roll(SQUARE, -1, 0), strict=True)]
    )
    base = BasePlane.fitted(rim, ground(3.0 + 0.1 * rim[:, 0]), 0.25)
    found = volume(places, ground(pyramid), base, 100.0)
    assert found.net_m3 == pytest.approx(64 * 4 / 3, rel=1e-3)
    assert found.below_m3 == pytest.approx(0.0, abs=1e-6)
    assert found.highest_m == pytest.approx(4.0, abs=0.03)


def test_a_pit_is_below_a_level_base():
    places, _ = places_inside(polygon_of(SQUARE), 0.1)
    found = volume(places, ground(np.full(len(places), -0.5)), BasePlane.level(0.0), 100.0)
    assert (found.above_m3, found.below_m3, found.net_m3) == pytest.approx((0.0, 50.0, -50.0))


def test_the_stated_sigma_is_what_errors_of_elevation_do(rng):
    """Errors drawn as they are said to be: one for all, one a patch, and those of the rim."""
    places, cell = places_inside(polygon_of(SQUARE), 0.05)
    patch = np.floor(places / 0.15).astype(int)
    number = np.unique(patch, axis=0, return_inverse=True)[1].ravel()
    nets = []
    for _ in range(300):
        own = rng.normal(0, 0.05, number.max() + 1)[number]
        heights = 1.0 + own + rng.normal(0, 0.004)
        nets.append(volume(places, ground(heights), BasePlane.level(0.0), 100.0).net_m3)
    told = volume(places, ground(np.ones(len(places)), 0.05, 0.004), BasePlane.level(0.0), 100.0)
    assert np.std(nets) == pytest.approx(told.sigma_m3, rel=0.15)
    assert cell == pytest.approx(0.05)


def test_the_sigma_of_a_fitted_base_is_that_of_its_rim(rng):
    places, _ = places_inside(polygon_of(SQUARE), 0.5)
    rim = np.concatenate(
        [np.linspace(a, b, 20) for a, b in zip(SQUARE, np.roll(SQUARE, -1, 0), strict=True)]
    )
    flat = ground(np.zeros(len(places)), own=0.0)
    nets, told = [], []
    for _ in range(300):
        base = BasePlane.fitted(rim, ground(rng.normal(0, 0.05, len(rim))), 0.5)
        found = volume(places, flat, base, 100.0)
        nets.append(found.net_m3)
        told.append(found.sigma_m3)
    assert np.std(nets) == pytest.approx(np.mean(told), rel=0.15)


def test_too_little_ground_is_refused():
    places, _ = places_inside(polygon_of(SQUARE), 0.5)
    heights = np.where(places[:, 0] > 3, np.nan, 1.0)
    with pytest.raises(TerrainError, match="30% of the polygon was measured"):
        volume(places, ground(heights), BasePlane.level(0.0), 100.0)
    with pytest.raises(TerrainError, match="rim"):
        BasePlane.fitted(SQUARE, ground(np.zeros(4)), 0.5)


def test_the_ground_of_a_slope_is_larger_than_its_map():
    places, _ = places_inside(polygon_of(SQUARE), 0.5)
    found = surface_ratio(places, lambda p: 0.6 * p[:, 0] - 0.8 * p[:, 1], 0.25)
    assert found == pytest.approx(np.full(len(places), np.sqrt(2.0)))
