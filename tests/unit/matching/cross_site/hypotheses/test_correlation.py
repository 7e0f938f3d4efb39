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
    correlate_views,
    lagged_products,
    standing_out,
)
from solmap.products.reports.matching_figures import draw_overlay

PARAMS = BirdsEyeParams(radius_m=12.0, cell_m=0.16)
CELLS = 150


def seen_from(rng_seed, north=0.0, east=0.0, azimuth=0.0, lift=0.0):
    """A round view of one endless ground from a place, its north turned by `azimuth`."""
    rng = np.random.default_rng(rng_seed)
    size = 400
    grey = ndimage.gaussian_filter(rng.normal(size=(size, size)), 1.0)
    relief = ndimage.gaussian_filter(rng.normal(size=(size, size)), 1.0)
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


def places(earlier, later, *gate, most=PARAMS.peaks):
    return correlate_views(earlier, later, SearchGate(*gate), most, PARAMS.min_overlap_m2)


def test_the_search_finds_shift_azimuth_and_drop():
    earlier = seen_from(1)
    later = seen_from(1, north=4.0, east=-3.1, azimuth=0.03, lift=0.5)
    best = places(earlier, later, 3.5, -2.5, 2.0, 0.06)[0]
    assert best.north_m == pytest.approx(4.0, abs=0.08)  # half a cell
    assert best.east_m == pytest.approx(-3.1, abs=0.08)
    assert best.azimuth == pytest.approx(0.03, abs=0.005)
    assert best.down_m == pytest.approx(0.5, abs=0.1)
    assert best.z > 20


def test_the_middle_of_the_gate_may_be_rotated():
    later = seen_from(1, north=4.0, east=-3.0, azimuth=0.30)
    best = places(seen_from(1), later, 3.5, -2.5, 2.0, 0.03, 0.31)[0]
    assert best.azimuth == pytest.approx(0.30, abs=0.005)


@pytest.mark.parametrize("light", ["another", "opposite", "none"])
def test_heights_find_the_place_in_any_light(light):
    earlier, later = seen_from(1), seen_from(1, north=4.0, east=-3.0)
    under = {
        "another": seen_from(5, north=4.0, east=-3.0).grey,
        "opposite": -later.grey,
        "none": np.zeros_like(later.grey),
    }
    other_sun = replace(later, grey=under[light])
    best, *wrong = places(earlier, other_sun, 3.5, -2.5, 2.0, 0.02)
    assert np.hypot(best.north_m - 4.0, best.east_m + 3.0) < 0.2
    assert best.z > 20
    assert best.z > 3 * wrong[0].z


def test_agreeing_grey_values_make_the_peak_more_distinct():
    earlier, later = seen_from(1), seen_from(1, north=4.0, east=-3.0)
    other_sun = replace(later, grey=seen_from(5, north=4.0, east=-3.0).grey)
    same, other = (places(earlier, k, 3.5, -2.5, 2.0, 0.02)[0].z for k in (later, other_sun))
    assert same > 1.2 * other


def test_errors_common_to_both_panoramas_are_not_a_peak_where_the_rovers_would_coincide():
    earlier = seen_from(1)
    same, apart = (
        correlate_views(
            earlier, earlier, SearchGate(3.0, 0.0, 4.0, 0.02, apart_m=least_m), 1, 40.0
        )[0]
        for least_m in (0.0, SEPARATION_M)
    )
    assert np.hypot(same.north_m, same.east_m) < PARAMS.cell_m
    assert same.z > 20
    assert apart.z < 8


def test_different_ground_has_no_distinct_peak():
    earlier, later = seen_from(1), seen_from(2, north=4.0, east=-3.0)
    assert places(earlier, later, 3.5, -2.5, 2.0, 0.03)[0].z < 5


def test_repetitive_ground_has_no_distinct_peak():
    rng = np.random.default_rng(3)
    row, col = np.mgrid[:101, :101]
    ripples = 5 * np.cos(2 * np.pi * row / 6) * (col < 50)
    q = (ripples + rng.normal(size=row.shape)).astype(np.float32)
    z = standing_out(q, np.ones_like(q, bool), 25)
    assert np.abs(z[:, :40]).max() < 3
    assert z[:, :40].std() == pytest.approx(z[:, 60:].std(), rel=0.2)


def test_peaks_are_inside_the_gate_or_on_its_rim_and_apart():
    fits = places(seen_from(1), seen_from(2), 3.0, 1.0, 2.0, 0.02)
    assert len(fits) == PARAMS.peaks
    for k, fit in enumerate(fits):
        away_m = np.hypot(fit.north_m - 3.0, fit.east_m - 1.0)
        assert away_m < 2.0 + SEPARATION_M + PARAMS.cell_m
        for other in fits[:k]:
            apart = np.hypot(fit.north_m - other.north_m, fit.east_m - other.east_m)
            assert apart > SEPARATION_M - PARAMS.cell_m


def test_views_that_hardly_overlap_have_no_peak():
    assert places(seen_from(1), seen_from(1), 21.5, 0.0, 0.3, 0.01) == []


def test_products_are_summed_over_the_common_cells():
    one, other = channels(seen_from(3))[1], channels(seen_from(4))[1]
    rows, cols = (fft.next_fast_len(n + 6, real=True) for n in one.value.shape)
    weights, values = (
        [fft.rfft2(raster, (rows, cols)) for raster in both]
        for both in ((one.weight, other.weight), (one.value, other.value))
    )
    i, j = 4, -3  # other moved four rows down and three columns left
    moved, weight = (np.roll(v, (i, j), (0, 1)) for v in (other.value, other.weight))
    common, total = (lagged_products(*both, 6, cols)[6 + i, 6 + j] for both in (weights, values))
    assert common == pytest.approx((one.weight * weight).sum())
    assert total == pytest.approx((one.value * moved).sum(), abs=0.5)  # float32


def test_a_halved_view_shows_the_same_ground():
    view = seen_from(1)
    halved = view.halved
    assert halved.cell_m == 2 * view.cell_m
    row, col = 20, 50
    half, middle = halved.grey.shape[0] / 2 - 0.5, (CELLS - 1) / 2
    at_row, at_col = (int(middle + 2 * (k - half) - 0.5) for k in (row, col))
    mean = view.elevation[at_row : at_row + 2, at_col : at_col + 2].mean()
    assert halved.elevation[row, col] == pytest.approx(mean, abs=1e-6)


def test_a_birds_eye_view_has_the_ground_at_its_coordinates(first_stop):
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
    fit = places(view, view, 0.0, 0.0, 1.0, 0.01)[0]
    image = draw_overlay(view, view, fit).astype(int)
    shown = image.any(axis=2)
    assert np.abs(image[shown][:, 0] - image[shown][:, 1]).mean() < 10


def test_a_view_of_few_cells_is_refused():
    with pytest.raises(MatchingError, match="cells far smaller than its radius"):
        BirdsEyeParams(cell_m=3.0)
