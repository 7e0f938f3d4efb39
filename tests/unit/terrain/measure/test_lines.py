"""Profiles, lengths, areas and volumes of ground whose shape is known."""

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.resampling import (
    NOWHERE,
    GroundSamples,
    finest_samples,
    sample_bilinear,
)
from solmap.photogrammetry.terrain.measure.areas import (
    MOST_PLACES,
    BasePlane,
    places_inside,
    polygon_of,
    surface_ratio,
    volume,
)
from solmap.photogrammetry.terrain.measure.lines import (
    measure_line,
    profile,
    rise_between,
    stations,
)

GRID = MapGrid(-10.0, 10.0, 0.1, 200, 200)


def plane(east, north):
    return 3.0 + 0.2 * east - 0.1 * north


def raster():
    east, north = GRID.centres()
    return plane(east[None, :], north[:, None]).astype(np.float32)


def samples(elevation, sigma=0.02, pose=0.0, source=0):
    known = np.isfinite(elevation)
    return GroundSamples(
        elevation,
        np.where(known, sigma, np.nan),
        np.where(known, pose, np.nan),
        np.where(known, source, NOWHERE).astype(np.int32),
    )


def test_a_plane_is_read_exactly_between_its_cells(rng):
    places = rng.uniform(-9.9, 9.9, (500, 2))
    found = sample_bilinear(raster(), GRID, places)
    assert np.abs(found - plane(*places.T)).max() < 1e-5


def test_gaps_and_places_outside_the_grid_are_not_measured():
    values = raster()
    values[90:110, 90:110] = np.nan
    places = np.array([[0.0, 0.0], [11.0, 0.0], [0.0, -10.2], [5.0, 5.0]])
    assert np.isfinite(sample_bilinear(values, GRID, places)).tolist() == [
        False,
        False,
        False,
        True,
    ]


def test_the_finest_model_is_used_and_among_equals_the_most_certain():
    unknown = np.nan
    coarse = samples(np.array([1.0, 1.0, 1.0, unknown]), 0.01, source=0)
    fine = samples(np.array([2.0, 2.0, unknown, unknown]), 0.05, source=1)
    surer = samples(np.array([3.0, unknown, unknown, unknown]), 0.03, source=2)
    found = finest_samples([(0.08, coarse), (0.04, fine), (0.04, surer)])
    assert found.source.tolist() == [2, 1, 0, NOWHERE]
    assert found.elevation[:3].tolist() == [3.0, 2.0, 1.0]
    assert np.isnan(found.elevation[3])


def test_every_corner_of_a_line_is_a_station():
    corners = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 4.0], [3.0, 5.05]])
    along = stations(corners, 0.5)
    assert along.distance_m[-1] == pytest.approx(6.05)
    assert np.diff(along.distance_m).max() <= 0.5 + 1e-12
    for corner in corners:
        assert np.hypot(*(along.places - corner).T).min() < 1e-12
    gaps = np.hypot(*np.diff(along.places, axis=0).T)
    assert gaps == pytest.approx(np.diff(along.distance_m))


def test_the_slope_of_a_plane_along_a_line_is_that_of_the_plane():
    along = stations(np.array([[-5.0, -5.0], [5.0, 5.0], [5.0, -5.0]]), 0.1)
    found = profile(along, samples(plane(*along.places.T)), 0.5)
    inner = along.distance_m < 14.0
    assert np.tan(found.slope[inner]) == pytest.approx(0.1 / np.sqrt(2), abs=1e-9)
    outer = along.distance_m > 14.5
    assert np.tan(found.slope[outer]) == pytest.approx(0.1, abs=1e-9)


def test_the_stated_sigma_of_a_slope_covers_correlated_noise(rng):
    """Noise that half a baseline of neighbours share: the assumption that the sigma is made of."""
    along = stations(np.array([[0.0, 0.0], [400.0, 0.0]]), 0.05)
    blocks = rng.normal(0, 0.02, len(along.distance_m) // 5 + 1)
    noise = np.repeat(blocks, 5)[: len(along.distance_m)]
    found = profile(along, samples(noise, 0.02), 0.5)
    inside = (along.distance_m > 1) & (along.distance_m < 399)
    assert 0.5 < found.slope[inside].std() / found.slope_sigma[inside].mean() < 1.1


def test_common_errors_of_stations_tilt_no_slope():
    along = stations(np.array([[0.0, 0.0], [4.0, 0.0]]), 0.1)
    found = profile(along, samples(plane(*along.places.T), sigma=0.05, pose=0.05), 0.5)
    assert np.nanmax(found.slope_sigma) == 0.0


def test_a_gap_has_no_slope_and_affects_no_neighbour():
    along = stations(np.array([[0.0, 0.0], [10.0, 0.0]]), 0.1)
    heights = plane(*along.places.T)
    gap = (along.distance_m > 4) & (along.distance_m < 6)
    heights[gap] = np.nan
    found = profile(along, samples(heights), 0.5)
    assert np.isnan(found.slope[gap]).all()
    assert np.tan(found.slope[np.isfinite(found.slope)]) == pytest.approx(0.2, abs=1e-9)
    assert np.isfinite(found.slope).sum() > 70


@pytest.mark.parametrize(
    ("corners", "step", "reported"),
    [
        ([[1.0, 1.0], [1.0, 1.0]], 0.1, "two different points"),
        ([[0.0, 0.0], [1e6, 0.0]], 0.01, "step of 50 m"),
        ([[0.0, 0.0], [1.0, 0.0]], 0.0, "two different points"),
    ],
)
def test_invalid_and_too_long_lines_are_refused(corners, step, reported):
    with pytest.raises(TerrainError, match=reported):
        stations(np.array(corners), step)


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


def test_the_rise_between_two_places_excludes_their_common_error():
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


def test_the_cells_inside_a_polygon_fill_it_and_are_bounded_in_number():
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
    base = BasePlane.fit(rim, ground(3.0 + 0.1 * rim[:, 0]), 0.25)
    found = volume(places, ground(pyramid), base, 100.0)
    assert found.net_m3 == pytest.approx(64 * 4 / 3, rel=1e-3)
    assert found.below_m3 == pytest.approx(0.0, abs=1e-6)
    assert found.highest_m == pytest.approx(4.0, abs=0.03)


def test_a_pit_is_below_a_level_base():
    places, _ = places_inside(polygon_of(SQUARE), 0.1)
    found = volume(places, ground(np.full(len(places), -0.5)), BasePlane.level(0.0), 100.0)
    assert (found.above_m3, found.below_m3, found.net_m3) == pytest.approx((0.0, 50.0, -50.0))
    assert found.sigma_above_m3 == 0.0  # of no ground
    assert found.sigma_below_m3 == pytest.approx(found.sigma_m3)


@pytest.mark.usefixtures("unchecked")
def test_the_stated_sigma_agrees_with_simulated_errors_of_elevation(rng):
    """Errors drawn as stated: one for all, one per patch, and those of the rim."""
    places, cell = places_inside(polygon_of(SQUARE), 0.05)
    patch = np.floor(places / 0.15).astype(int)
    number = np.unique(patch, axis=0, return_inverse=True)[1].ravel()
    nets = []
    for _ in range(300):
        own = rng.normal(0, 0.05, number.max() + 1)[number]
        heights = 1.0 + own + rng.normal(0, 0.004)
        nets.append(volume(places, ground(heights), BasePlane.level(0.0), 100.0).net_m3)
    reported = volume(
        places, ground(np.ones(len(places)), 0.05, 0.004), BasePlane.level(0.0), 100.0
    )
    assert np.std(nets) == pytest.approx(reported.sigma_m3, rel=0.15)
    assert cell == pytest.approx(0.05)


@pytest.mark.usefixtures("unchecked")
def test_the_sigma_of_a_fitted_base_is_that_of_its_rim(rng):
    places, _ = places_inside(polygon_of(SQUARE), 0.5)
    rim = np.concatenate(
        [np.linspace(a, b, 20) for a, b in zip(SQUARE, np.roll(SQUARE, -1, 0), strict=True)]
    )
    flat = ground(np.zeros(len(places)), own=0.0)
    nets, reported = [], []
    for _ in range(300):
        base = BasePlane.fit(rim, ground(rng.normal(0, 0.05, len(rim))), 0.5)
        found = volume(places, flat, base, 100.0)
        nets.append(found.net_m3)
        reported.append(found.sigma_m3)
    assert np.std(nets) == pytest.approx(np.mean(reported), rel=0.15)


def test_too_little_ground_is_refused():
    places, _ = places_inside(polygon_of(SQUARE), 0.5)
    heights = np.where(places[:, 0] > 3, np.nan, 1.0)
    with pytest.raises(TerrainError, match="30% of the polygon was measured"):
        volume(places, ground(heights), BasePlane.level(0.0), 100.0)
    with pytest.raises(TerrainError, match="rim"):
        BasePlane.fit(SQUARE, ground(np.zeros(4)), 0.5)


def test_the_ground_of_a_slope_is_larger_than_its_map():
    places, _ = places_inside(polygon_of(SQUARE), 0.5)
    found = surface_ratio(places, lambda p: 0.6 * p[:, 0] - 0.8 * p[:, 1], 0.25)
    assert found == pytest.approx(np.full(len(places), np.sqrt(2.0)))
