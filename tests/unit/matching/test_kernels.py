"""Compiled loops of matching, against the same formulas in NumPy and SciPy."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.interpolate import BSpline

from solmap.photogrammetry.matching import kernels
from solmap.photogrammetry.matching.resampling import (
    row_coefficients,
    row_slope,
    spline_coefficients,
)

SIDE = 60
HALF = 5


@pytest.fixture
def textures(rng):
    """A left image, and a right one in which it is shifted and of another contrast."""
    wide = ndimage.gaussian_filter(rng.normal(size=(SIDE + 20, SIDE + 20)), 1.5)
    right = ndimage.shift(wide, (0.2, -4.3), order=5)
    return tuple(w[10:-10, 10:-10].astype(np.float32) for w in (10 * wide, 14 * right + 3))


@pytest.fixture
def pixels(rng):
    return rng.integers(20, SIDE - 20, (12, 2)).astype(np.int32)


def window(image, x, y):
    """Grey values of the window about a pixel of an image in double precision, mean subtracted."""
    part = image[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1].astype(float).ravel()
    return part - part.mean()


def sampled(image, x, y):
    """Grey values at points, mean subtracted."""
    values = ndimage.map_coordinates(image.astype(float), [y, x], order=3, mode="mirror")
    return values - values.mean()


STEPS_AROUND = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1]
DY, DX = (steps.ravel() for steps in STEPS_AROUND)


def test_the_residual_is_the_spline_of_the_right_row_less_the_left_pixel(textures, rng):
    left, right = textures
    parallax = rng.uniform(-SIDE, SIDE, left.shape).astype(np.float32)
    parallax[10:20, 5:30] = np.nan
    found = kernels.parallax_residual(row_coefficients(right), left, parallax)
    for y in (0, 15, SIDE - 1):
        x = np.clip(np.arange(SIDE) - np.nan_to_num(parallax[y].astype(float)), -1, SIDE)
        exact = ndimage.map_coordinates(right[y].astype(float), [x], order=3, mode="mirror")
        exact = np.where(np.isnan(parallax[y]), 0, exact - left[y])
        np.testing.assert_allclose(found[y], exact, atol=2e-4)


def test_parallax_is_fitted_as_by_gauss_newton_steps_in_numpy(textures, pixels):
    left, right = textures
    slope = row_slope(row_coefficients(left))
    start = np.full(len(pixels), -4.0)
    limits = (HALF, 8, 0.005, 1.5)
    found = kernels.fit_parallax(left, slope, row_coefficients(right), pixels, start, limits)
    for (x, y), (*geometry, variance, cofactor, correlation, settled) in zip(
        pixels.tolist(), found.tolist(), strict=True
    ):
        along = slope[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1].astype(float).ravel()
        design = -np.column_stack([along, along * DX, along * DY])
        design -= design.mean(axis=0)
        normal = design.T @ design
        grey, plane = window(left, x, y), np.array([-4.0, 0.0, 0.0])
        for _ in range(8):
            p, a, b = plane
            rows = [
                ndimage.map_coordinates(
                    right[y + dy].astype(float),
                    [x + DX[dy == DY] - p - a * DX[dy == DY] - b * dy],
                    order=3,
                    mode="mirror",
                )
                for dy in range(-HALF, HALF + 1)
            ]
            there = np.concatenate(rows) - np.mean(rows)
            there *= grey @ there / (there @ there)
            step = np.linalg.solve(normal, design.T @ (grey - there))
            plane = plane + step
            far = abs(plane[0] + 4.0) > 1.5
            if far or abs(step[0]) < 0.005:
                break
        assert bool(settled) == (not far and abs(step[0]) < 0.005)
        np.testing.assert_allclose(geometry, plane, atol=1e-5)
        assert variance == pytest.approx(((grey - there) ** 2).sum() / (len(grey) - 5), rel=1e-3)
        assert cofactor == pytest.approx(np.linalg.inv(normal)[0, 0], rel=1e-6)
        assert correlation == pytest.approx(np.corrcoef(grey, there)[0, 1], abs=1e-5)


def test_offsets_are_fitted_as_by_gauss_newton_steps_in_numpy(textures, pixels):
    left, right = textures
    start = np.tile([4.0, 0.0], (len(pixels), 1))
    found = kernels.fit_offsets(left, spline_coefficients(right), pixels, start, (HALF, 6))
    down, along = np.gradient(left.astype(float))
    for (x, y), fitted in zip(pixels.tolist(), found, strict=True):
        design = np.column_stack([window(g, x, y) for g in (along, down)])
        grey, offset = window(left, x, y), np.array([4.0, 0.0])
        for _ in range(6):
            there = sampled(right, x + DX + offset[0], y + DY + offset[1])
            there *= grey @ there / (there @ there)
            step = np.linalg.solve(design.T @ design, design.T @ (grey - there)).clip(-1, 1)
            offset = offset + step
        np.testing.assert_allclose(fitted[:2], offset, atol=1e-4)
        np.testing.assert_allclose(fitted[2:], step, atol=1e-4)


def test_correlated_residuals_count_less(rng):
    white = rng.normal(size=(50, 21, 21))
    smooth = ndimage.gaussian_filter(white, (0, 1.0, 1.0))
    alone, together = (
        [kernels.correlated_neighbours(patch, 21) for patch in patches.reshape(50, -1)]
        for patches in (white, smooth)
    )
    assert np.median(alone) < 1.2
    assert np.median(together) > 5.0


def moved_patch(search, affine, shift, half):
    """A search patch on the moved grid, less the mean of its part without the rim of two cells."""
    row, col = np.mgrid[-half - 2 : half + 3, -half - 2 : half + 3]
    x, y = affine @ np.stack([col.ravel(), row.ravel()]) + shift[:, None] + len(search) // 2
    drawn = ndimage.map_coordinates(search.astype(float), [y, x], order=1).reshape(row.shape)
    return drawn - drawn[2:-2, 2:-2].mean()


def test_affine_maps_are_fitted_as_by_gauss_newton_steps_in_numpy(textures, rng):
    left, right = textures
    places, starts = [(30, 25), (28, 33)], rng.uniform(-0.3, 0.3, (2, 2))
    templates = np.array([left[y - 5 : y + 6, x - 5 : x + 6] for x, y in places])
    searches = np.array([right[y - 11 : y + 12, x - 15 : x + 8] for x, y in places])
    found = kernels.fit_affine(templates, searches, starts, (3, 0.2))
    for template, search, start, fitted in zip(templates, searches, starts, found, strict=True):
        a, affine, shift = (template - template.mean(dtype=float)).ravel(), np.eye(2), start
        for _ in range(3):
            drawn = moved_patch(search, affine, shift, HALF)
            drawn *= a.std() / drawn[2:-2, 2:-2].std()
            down, along = (
                ndimage.correlate1d(drawn, np.array([1, -8, 0, 8, -1]) / 12, axis=axis)[2:-2, 2:-2]
                for axis in (0, 1)
            )
            u, v, w = along.ravel(), down.ravel(), drawn[2:-2, 2:-2].ravel()
            design = np.stack([u, v, u * DX, u * DY, v * DX, v * DY, w, np.ones_like(w)], axis=1)
            normal, scale = design.T @ design, (design**2).mean(axis=0)
            normal += 1e-6 * len(w) * np.diag(scale)
            step = np.linalg.solve(normal, design.T @ (a - w))
            rest = a - w - design @ step
            shift = shift + affine @ step[:2].clip(-1, 1)
            affine = affine @ (np.eye(2) + step[2:6].clip(-0.2, 0.2).reshape(2, 2))
        grid = rest.reshape(template.shape)
        counted = 1.0
        for pairs in (grid[:, 1:] * grid[:, :-1], grid[1:] * grid[:-1]):
            r = np.clip(pairs.mean() / (rest**2).mean(), 0, 0.9)
            counted *= (1 + r) / (1 - r)
        cofactor = np.diag(np.linalg.inv(normal))[:2].mean()
        sigma = np.sqrt(cofactor * counted * (rest @ rest) / (len(a) - 8))
        w = moved_patch(search, affine, shift, HALF)[2:-2, 2:-2].ravel()
        exact = [*shift, sigma, *affine.ravel(), np.corrcoef(a, w)[0, 1]]
        np.testing.assert_allclose(fitted[:8], exact, rtol=1e-6, atol=1e-9)


def test_planes_of_least_deviations_pass_by_blunders(rng):
    offsets = rng.uniform(-30, 30, (20, 12, 2))
    plane = rng.uniform(-0.2, 0.2, (20, 2))
    values = 7 + np.einsum("nki,ni->nk", offsets, plane) + rng.normal(0, 0.01, (20, 12))
    values[:, 3] += 25
    found = kernels.fit_planes(offsets, values, 0.1, 6)
    assert np.median(np.abs(found[:, 0] - 7)) < 0.1
    assert np.median(np.abs(found[:, 4] - 25)) < 0.5
    for near, value, (at, *residual) in zip(offsets, values, found, strict=True):
        design = np.column_stack([np.ones(12), near / np.abs(near).mean()])
        left = value - np.median(value)
        for _ in range(6):
            weight = 1 / np.maximum(np.abs(left), 0.1)
            weight /= weight.sum()
            normal = design.T @ (design * weight[:, None]) + np.diag([0, 0.05, 0.05])
            solution = np.linalg.solve(normal, design.T @ (weight * value))
            left = value - design @ solution
        np.testing.assert_allclose([at, *residual], [solution[0], *left], atol=1e-6)


def test_correlations_are_products_of_windows(rng):
    left, right = (rng.normal(size=(9, 25)).astype(np.float32) for _ in range(2))
    a, b = rng.integers(0, 9, (2, 40))
    found = kernels.correlate(left, right, a, b)
    np.testing.assert_allclose(found, (left[a] * right[b]).sum(axis=1), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("far_lines", [0, 12, 31])
def test_window_sums_are_a_correlation_with_the_weights(rng, far_lines):
    a, b = rng.normal(size=(2, 31, 42)).astype(np.float32)
    windows = [((9, 8, 5, 3), (4, 1)), ((5, 3), (7, 5, 2))]
    halves = [tuple(np.array(w, np.float32) for w in window) for window in windows]
    exact = []
    for across, down in halves:
        whole = [np.concatenate([w[:0:-1], w]) for w in (down, across)]
        exact.append(ndimage.correlate((a * b).astype(float), np.outer(*whole), mode="constant"))
    expected = np.concatenate([exact[0][:far_lines], exact[1][far_lines:]])
    found = kernels.window_sums(a, b, *halves, far_lines)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-3)


def test_the_variance_in_a_window_is_that_of_its_values_and_never_negative(rng):
    values = rng.normal(3, 2, 50)
    sums = (values @ values, values.sum(), 50.0)
    found = kernels.window_variance(*(np.full((1, 1), value, np.float32) for value in sums))
    assert found[0, 0] == pytest.approx(values.var(), rel=1e-4)
    rounded = (0.999, 10.0, 100.0)
    assert kernels.window_variance(*(np.full((1, 1), v, np.float32) for v in rounded))[0, 0] == 0


def test_a_step_is_the_least_squares_solution_of_a_window(rng):
    slope, residual = rng.normal(size=(2, 49))
    residual += 0.3 * slope
    sums = (slope @ residual, residual.sum(), slope.sum(), 49.0, 49 * slope.var())
    images = [np.full((1, 1), value, np.float32) for value in sums]
    exact = np.polyfit(slope, residual, 1)[0]
    assert kernels.least_squares_step(*images)[0, 0] == pytest.approx(exact, rel=1e-4)
    images[0] *= 1000
    assert kernels.least_squares_step(*images)[0, 0] == 1.0


def test_smoothing_averages_the_surface_around_a_pixel_alone(rng):
    parallax = rng.normal(20, 0.5, (24, 30)).astype(np.float32)
    parallax[:, 15:] += 8
    parallax[rng.random(parallax.shape) < 0.2] = np.nan
    found = kernels.smooth_surfaces(parallax, np.float32(2.0), np.float32(2.5), 3)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(parallax))
    lines, samples = np.indices(parallax.shape)
    for y, x in np.argwhere(np.isfinite(parallax)):
        squared = (lines - y) ** 2 + (samples - x) ** 2
        near = (squared <= 9) & np.isfinite(parallax)
        difference = parallax[near].astype(float) - parallax[y, x]
        weight = np.exp(-squared[near] / 8) * np.maximum(0, 1 - np.abs(difference) / 2.5)
        exact = parallax[y, x] + weight @ difference / weight.sum()
        assert found[y, x] == pytest.approx(exact, abs=2e-5)


def test_a_membrane_relaxes_to_the_least_squares_solution_and_not_across_gaps(rng):
    lines, samples = 7, 9
    number = np.arange(lines * samples).reshape(lines, samples)
    parallax = rng.normal(size=(lines, samples)).astype(np.float32)
    parallax[3] = parallax[:, 6] = np.nan
    weight, pull = (rng.uniform(0, 2, parallax.shape).astype(np.float32) for _ in range(2))
    weight[np.isnan(parallax)] = pull[np.isnan(parallax)] = 0
    within, between = (rng.uniform(1, 3, lines).astype(np.float32) for _ in range(2))
    gradient, edge = (np.float32(0.1), np.float32(-0.2)), np.float32(0.7)
    relaxed = kernels.relax_membrane(
        parallax, (weight, pull), (within, between), gradient, edge, 200
    )
    normal = np.diag(weight.ravel().astype(float))
    right = (weight * np.nan_to_num(parallax) + pull).ravel().astype(float)
    for axis, stiffness in ((1, within), (0, between)):
        first, second = np.delete(number, -1, axis), np.delete(number, 0, axis)
        for a, b in zip(first.ravel(), second.ravel(), strict=True):
            off = parallax.ravel()[b] - parallax.ravel()[a] - gradient[1 - axis]
            if np.isfinite(off):
                k = stiffness[a // samples] / (1 + (off / edge) ** 2)
                normal[np.ix_([a, b], [a, b])] += k * np.array([[1, -1], [-1, 1]])
                right[[a, b]] += k * gradient[1 - axis] * np.array([-1, 1])
    known = np.isfinite(parallax).ravel()
    solved = np.linalg.solve(normal[np.ix_(known, known)], right[known])
    moved = np.clip(solved - parallax.ravel()[known], -1, 1)
    assert relaxed.ravel()[known] - parallax.ravel()[known] == pytest.approx(moved, abs=1e-4)
    assert (np.isnan(relaxed) == np.isnan(parallax)).all()


def test_a_bicubic_spline_is_evaluated_by_the_four_of_its_terms_that_count(rng):
    knots = np.r_[0, 0, 0, 0, 2, 5, 9, 9, 9, 9].astype(float)
    coefficients = rng.normal(size=(6, 6))
    places = [np.linspace(0, 9, n) for n in (14, 11)]  # columns, rows
    tables = [BSpline.design_matrix(place, knots, 3) for place in places]
    arguments = [
        part
        for table in tables
        for part in (table.data.reshape(-1, 4), table.indices[::4].astype(np.int64))
    ]
    exact = BSpline(knots, coefficients, 3)(places[1]) @ tables[0].toarray().T
    found = kernels.evaluate_bicubic(coefficients, *arguments)
    np.testing.assert_allclose(found, exact, rtol=1e-5, atol=1e-6)


def test_fixed_point_values_are_rounded_and_gaps_marked():
    values = np.array([[1.03, -2.5, np.nan], [1e6, -1e6, 0.0]], np.float32)
    found = kernels.fixed_point(values, np.float32(16), -32_000)
    np.testing.assert_array_equal(found, [[16, -40, -32_000], [-32_000, -32_000, 0]])


def test_a_parallax_is_mutual_where_the_partner_leads_back(rng):
    forth = rng.uniform(-5, 5, (20, 30)).astype(np.float32)
    back = rng.uniform(-5, 5, forth.shape).astype(np.float32)
    for array in (forth, back):
        array[rng.random(array.shape) < 0.1] = np.nan
    found = kernels.mutual_parallax(forth, back, np.float32(2.0))
    for (y, x), p in np.ndenumerate(forth):
        partner = np.rint(x - p) if np.isfinite(p) else -1
        mutual = 0 <= partner < 30 and abs(back[y, int(partner)] - p) <= 2
        assert np.isfinite(found[y, x]) == mutual
        assert found[y, x] == p or not mutual


def test_contrast_is_the_distance_from_the_local_mean_in_standard_deviations(rng):
    grey = rng.normal(5, 2, (6, 7)).astype(np.float32)
    mask = rng.random(grey.shape) < 0.8
    mean, square, share = rng.uniform(0.5, 1, (3, *grey.shape)).astype(np.float32)
    found = kernels.local_contrast(grey, mean, square, share, mask, np.float32(0.1))
    variance = np.maximum(square / share - (mean / share) ** 2, 0)
    exact = np.where(mask, (grey - mean / share) / np.sqrt(variance + 0.1), 0)
    np.testing.assert_allclose(found, exact, rtol=1e-4)


def test_foerstner_weight_and_roundness_are_those_of_the_normal_matrix(rng):
    slopes = rng.normal(size=(2, 3, 4, 20)).astype(np.float32)
    xx, xy, yy = ((a * b).sum(axis=-1) for a, b in (slopes[[0, 0]], slopes, slopes[[1, 1]]))
    w, q = kernels.foerstner(xx, xy, yy)
    normal = np.moveaxis(np.array([[xx, xy], [xy, yy]]), (0, 1), (2, 3))
    determinant, trace = np.linalg.det(normal), np.trace(normal, axis1=2, axis2=3)
    np.testing.assert_allclose(w, determinant / trace, rtol=1e-4)
    np.testing.assert_allclose(q, 4 * determinant / trace**2, rtol=1e-4)
