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
from solmap.photogrammetry.terrain.measure.lines import profile, stations

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


def test_a_gap_and_what_lies_beyond_the_grid_are_not_measured():
    values = raster()
    values[90:110, 90:110] = np.nan
    places = np.array([[0.0, 0.0], [11.0, 0.0], [0.0, -10.2], [5.0, 5.0]])
    assert np.isfinite(sample_bilinear(values, GRID, places)).tolist() == [
        False,
        False,
        False,
        True,
    ]


def test_the_finest_model_speaks_and_of_equal_ones_the_surest():
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


def test_the_stated_sigma_of_a_slope_covers_what_correlated_noise_does(rng):
    """Noise that half a baseline of neighbours share: the assumption that the sigma is made of."""
    along = stations(np.array([[0.0, 0.0], [400.0, 0.0]]), 0.05)
    blocks = rng.normal(0, 0.02, len(along.distance_m) // 5 + 1)
    noise = np.repeat(blocks, 5)[: len(along.distance_m)]
    found = profile(along, samples(noise, 0.02), 0.5)
    inside = (along.distance_m > 1) & (along.distance_m < 399)
    assert 0.5 < found.slope[inside].std() / found.slope_sigma[inside].mean() < 1.1


def test_errors_that_all_stations_share_tilt_no_slope():
    along = stations(np.array([[0.0, 0.0], [4.0, 0.0]]), 0.1)
    found = profile(along, samples(plane(*along.places.T), sigma=0.05, pose=0.05), 0.5)
    assert np.nanmax(found.slope_sigma) == 0.0


def test_a_gap_has_no_slope_and_spoils_no_neighbour():
    along = stations(np.array([[0.0, 0.0], [10.0, 0.0]]), 0.1)
    heights = plane(*along.places.T)
    gap = (along.distance_m > 4) & (along.distance_m < 6)
    heights[gap] = np.nan
    found = profile(along, samples(heights), 0.5)
    assert np.isnan(found.slope[gap]).all()
    assert np.tan(found.slope[np.isfinite(found.slope)]) == pytest.approx(0.2, abs=1e-9)
    assert np.isfinite(found.slope).sum() > 70


@pytest.mark.parametrize(
    ("corners", "step", "told"),
    [
        ([[1.0, 1.0], [1.0, 1.0]], 0.1, "two places"),
        ([[0.0, 0.0], [1e6, 0.0]], 0.01, "step of 50 m"),
        ([[0.0, 0.0], [1.0, 0.0]], 0.0, "two places"),
    ],
)
def test_lines_that_are_none_or_too_long_are_refused(corners, step, told):
    with pytest.raises(TerrainError, match=told):
        stations(np.array(corners), step)
