from dataclasses import replace

import numpy as np
import pytest
from scipy import fft, ndimage

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    SEPARATION_M,
    BirdsEyeParams,
    BirdsEyeView,
    SearchGate,
    channels,
    draw_birds_eye,
)
from solmap.photogrammetry.matching.cross_site.hypotheses.correlation import (
    Spectra,
    correlate_views,
    correlation_coefficient,
    lagged_products,
)
from solmap.products.reports.matching_figures import draw_overlay

PARAMS = BirdsEyeParams(radius_m=12.0, cell_m=0.16)
CELLS = 150


def seen_from(rng_seed, north=0.0, east=0.0, azimuth=0.0, lift=0.0):
    """A round view of one endless ground from a place, its north turned by `azimuth`."""
    rng = np.random.default_rng(rng_seed)
    size = 400
    grey = ndimage.gaussian_filter(rng.normal(size=(size, size)), 1.5)
    relief = ndimage.gaussian_filter(rng.normal(size=(size, size)), 2.0)
    row, col = np.mgrid[:CELLS, :CELLS]
    n = ((CELLS - 1) / 2 - row) * PARAMS.cell_m
    e = (col - (CELLS - 1) / 2) * PARAMS.cell_m
    there_n = north + n * np.cos(azimuth) - e * np.sin(azimuth)
    there_e = east + n * np.sin(azimuth) + e * np.cos(azimuth)
    at = [size / 2 - there_n / PARAMS.cell_m, size / 2 + there_e / PARAMS.cell_m]
    views = [ndimage.map_coordinates(k, at, order=1).astype(np.float32) for k in (grey, relief)]
    unseen = np.hypot(n, e) > 11.0
    for view in views:
        view[unseen] = np.nan
    return BirdsEyeView(PARAMS.cell_m, views[0], views[1] + np.float32(lift))


def test_the_search_finds_shift_azimuth_and_drop():
    earlier = seen_from(1)
    later = seen_from(1, north=4.0, east=-3.1, azimuth=0.03, lift=0.5)
    best = correlate_views(earlier, later, SearchGate(3.5, -2.5, 2.0, 0.06), PARAMS)[0]
    assert best.north_m == pytest.approx(4.0, abs=0.08)  # half a cell
    assert best.east_m == pytest.approx(-3.1, abs=0.08)
    assert best.azimuth == pytest.approx(0.03, abs=0.005)
    assert best.down_m == pytest.approx(0.5, abs=0.1)
    assert best.z > 8


def test_the_search_does_not_need_the_grey_values_to_agree():
    earlier, later = seen_from(1), seen_from(1, north=4.0, east=-3.0)
    other_sun = replace(later, grey=seen_from(5, north=4.0, east=-3.0).grey)
    best = correlate_views(earlier, other_sun, SearchGate(3.5, -2.5, 2.0, 0.02), PARAMS)[0]
    assert np.hypot(best.north_m - 4.0, best.east_m + 3.0) < 0.2


def test_no_peak_stands_out_where_the_ground_is_another():
    earlier, later = seen_from(1), seen_from(2, north=4.0, east=-3.0)
    best = correlate_views(earlier, later, SearchGate(3.5, -2.5, 2.0, 0.03), PARAMS)[0]
    assert best.z < 5


def test_peaks_lie_inside_the_gate_and_apart():
    fits = correlate_views(seen_from(1), seen_from(2), SearchGate(3.0, 1.0, 2.0, 0.02), PARAMS)
    assert len(fits) == PARAMS.peaks
    for k, fit in enumerate(fits):
        assert np.hypot(fit.north_m - 3.0, fit.east_m - 1.0) < 2.0 + PARAMS.cell_m
        for other in fits[:k]:
            apart = np.hypot(fit.north_m - other.north_m, fit.east_m - other.east_m)
            assert apart > SEPARATION_M - PARAMS.cell_m


def test_views_that_hardly_overlap_have_no_peak():
    assert (
        correlate_views(seen_from(1), seen_from(1), SearchGate(21.5, 0.0, 0.3, 0.01), PARAMS) == []
    )


def test_masked_correlation_is_the_coefficient_over_the_common_cells():
    one, _ = channels(seen_from(3), PARAMS)
    other, _ = channels(seen_from(4), PARAMS)
    rows, cols = (fft.next_fast_len(n + 6, real=True) for n in one.value.shape)
    both_spectra = [Spectra.of(channel, (rows, cols)) for channel in (one, other)]
    common = lagged_products(*(s.weight for s in both_spectra), 6, cols)
    coefficient = correlation_coefficient(*both_spectra, np.maximum(common, 1.0), 6, cols)
    i, j = 4, -3  # other moved four rows down and three columns left
    moved, weight = (np.roll(v, (i, j), (0, 1)) for v in (other.value, other.weight))
    both = (one.weight > 0) & (weight > 0)
    assert common[6 + i, 6 + j] == pytest.approx(both.sum())
    expected = np.corrcoef(one.value[both], moved[both])[0, 1]
    assert coefficient[6 + i, 6 + j] == pytest.approx(expected, abs=1e-4)  # float32 channels


def test_a_birds_eye_view_shows_the_ground_where_it_is(first_stop):
    view = draw_birds_eye(first_stop, PARAMS, [PARAMS.cell_m])[0]
    row, col = np.nonzero(np.isfinite(view.elevation))
    half = (view.elevation.shape[0] - 1) / 2
    north, east = (half - row) * PARAMS.cell_m, (col - half) * PARAMS.cell_m
    near = np.hypot(north, east) < 5
    from_ground = 0.12 * np.sin(north / 1.7 + 0.4) * np.cos(east / 1.3)
    from_ground += 0.06 * np.sin(east / 0.6 + north)
    error = view.elevation[row, col][near] - from_ground[near]
    assert near.sum() > 100
    assert np.median(np.abs(error)) < 0.02  # cells of 0.16 m on slopes of 10 %


def test_the_overlay_is_grey_where_both_views_agree():
    view = seen_from(1)
    fit = correlate_views(view, view, SearchGate(0.0, 0.0, 1.0, 0.01), PARAMS)[0]
    picture = draw_overlay(view, view, fit).astype(int)
    shown = picture.any(axis=2)
    assert np.abs(picture[shown][:, 0] - picture[shown][:, 1]).mean() < 10


def test_a_view_with_cells_wider_than_its_waves_is_refused():
    with pytest.raises(MatchingError, match="cell < wave < radius"):
        BirdsEyeParams(cell_m=2.0)
