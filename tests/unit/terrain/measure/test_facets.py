"""Planar facets of rocks: found at their place, with their attitude and true uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.matching.parallax_planes import whole_window_planes
from solmap.photogrammetry.terrain.measure.facets import (
    FacetParams,
    PlanarRegionParams,
    find_facets,
    variance_factor,
)

PARAMS = FacetParams(max_relative_sigma=0.03)  # the small camera of these tests sees 7 m


def wedge(dip_deg: float, turn: float = 0.0):
    """A block whose near face dips towards the camera but for a turn, given as a tangent."""
    rise = np.tan(np.radians(dip_deg)) * np.hypot(1, turn)

    def surface(east, north):
        behind = (north - 4.0 - turn * east) / np.hypot(1, turn)
        return np.where(np.abs(east) < 1.0, np.clip(behind * rise, 0, 0.8), 0.0)

    return surface


def with_noise(view, rng, sigma_px: float):
    """Matching noise whose correlation falls to 1/e over the set distance."""
    y, x = (np.minimum(np.arange(n), n - np.arange(n)) for n in view.parallax.shape)
    correlations = np.exp(-np.hypot(y[:, None], x[None, :]) / PARAMS.correlation_px)
    spectrum = np.sqrt(np.maximum(np.fft.fft2(correlations).real, 0))
    white = np.fft.fft2(rng.normal(size=view.parallax.shape))
    correlated = np.fft.ifft2(spectrum * white).real
    parallax = (view.parallax + sigma_px * correlated).astype(np.float32)
    sigmas = np.full(parallax.shape, sigma_px, np.float32)
    return replace(view, parallax=parallax, sigma_px=sigmas)


@pytest.fixture(scope="module")
def view(scenes):
    return scenes.view_of(wedge(50.0, 0.3), dip_deg=10.0, focal_px=600.0)


def expected_deg() -> tuple[float, float]:
    """Strike and dip of the wedge's face: it falls against (north - turn east)."""
    falls = np.degrees(np.arctan2(0.3, -1.0)) % 360
    rise = np.tan(np.radians(50.0)) * np.hypot(1, 0.3)
    return float((falls - 90) % 360), float(np.degrees(np.arctan(rise)))


def test_the_face_of_a_block_is_found_and_the_level_ground_is_not(view):
    (facet,) = find_facets(view, PARAMS)
    strike, dip = expected_deg()
    assert np.degrees(facet.attitude.strike) == pytest.approx(strike, abs=0.05)
    assert np.degrees(facet.attitude.dip) == pytest.approx(dip, abs=0.05)
    assert facet.length_m == pytest.approx(2 * np.hypot(1, 0.3), rel=0.15)
    assert facet.width_m == pytest.approx(0.8 / np.sin(np.radians(dip)), rel=0.25)
    east, north, up = facet.plane.centre
    assert wedge(50.0, 0.3)(east, north) == pytest.approx(up, abs=1e-3)
    assert facet.pair_id == view.pair_id


@pytest.mark.usefixtures("unchecked")
def test_noise_rotates_the_face_by_the_stated_sigma(view, rng):
    """Over 60 trials the squares have the mean 1 but for 5 sqrt(2 / 60) = 0.9."""
    strike, dip = expected_deg()
    squares = []
    for _ in range(60):
        facets = find_facets(with_noise(view, rng, 0.15), PARAMS)
        facet = max(facets, key=lambda f: f.plane.points)
        off = np.array(
            [np.degrees(facet.attitude.strike) - strike, np.degrees(facet.attitude.dip) - dip]
        )
        stated = np.degrees([facet.attitude.sigma_strike, facet.attitude.sigma_dip])
        squares.append((off / stated) ** 2)
    mean = np.mean(squares, axis=0)
    assert (mean > 0.3).all()
    assert (mean < 1.9).all()


def test_uncertain_pointing_makes_every_facet_uncertain(view):
    tilt = np.zeros((6, 6))
    tilt[:3, :3] = np.eye(3) * np.radians(1.0) ** 2
    (sure,), (unsure,) = (
        find_facets(one, PARAMS) for one in (view, replace(view, covariance=tilt))
    )
    variances = [np.degrees(facet.attitude.sigma_dip) ** 2 for facet in (sure, unsure)]
    assert np.diff(variances) == pytest.approx(1.0, rel=0.01)


def test_round_rocks_have_no_facets(scenes):
    def dome(east, north):
        return np.sqrt(np.maximum(0.0, 0.25 - east**2 - (north - 4.0) ** 2))

    assert find_facets(scenes.view_of(dome, dip_deg=10.0, focal_px=600.0), PARAMS) == []


def test_correlated_errors_change_a_slope_by_the_sum_over_all_pairs():
    region = np.zeros((30, 40), bool)
    region[5:18, 10:33] = True
    row, col = np.nonzero(region)
    correlations = np.exp(-np.hypot(row[:, None] - row, col[:, None] - col) / 2.5)
    factors = [x @ correlations @ x / (x @ x) for x in (one - one.mean() for one in (row, col))]
    assert variance_factor(region, 2.5) == pytest.approx(max(factors), rel=0.03)
    assert variance_factor(region, 0.05) == pytest.approx(1.0, abs=1e-6)


def test_local_planes_are_exact_where_the_window_is_full():
    y, x = np.mgrid[:40, :50]
    parallax = (20 + 0.1 * x - 0.2 * y).astype(np.float32)
    parallax[:, 30] = np.nan
    planes, rms = whole_window_planes(parallax, 9)
    seen = np.isfinite(rms)
    full = np.zeros_like(seen)
    full[4:36, 4:26] = full[4:36, 35:46] = True
    np.testing.assert_array_equal(seen, full)
    np.testing.assert_allclose(planes[0][seen], parallax[seen], atol=1e-4)
    np.testing.assert_allclose(planes[1][seen], 0.1, atol=1e-5)
    np.testing.assert_allclose(planes[2][seen], -0.2, atol=1e-5)
    assert rms[seen].max() < 0.01


def test_windows_of_even_size_are_refused():
    with pytest.raises(TerrainError, match=r"window_px must be odd and at least 3 .* not 16 and 4"):
        PlanarRegionParams(window_px=16)
