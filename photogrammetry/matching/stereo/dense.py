"""Dense parallax of a pair: semi-global matching, checked in both directions and refined.

The locally normalised images are matched semi-globally from left to right and from right to left,
about the parallax plane of the ground (`semi_global`). A parallax is kept where both directions
agree and where it is part of a larger surface; it is then refined at every pixel, and kept where it
is precise and the windows agree. The sky, shadows without detail, and ground visible to only one
camera are NaN.

Values of semi-global matching concentrate at whole pixels (pixel locking). They are smoothed
without crossing depth edges and then corrected by Lucas-Kanade steps: with the slope g of the left
image and the residual r = R(x - p(x, y), y) - L(x, y) under the parallax of each pixel,

    dp = (sum g r - sum g sum r / n) / E,     E = sum g^2 - (sum g)^2 / n,     sigma^2 = s0^2 / E

summed over a window with weights that decrease to its edge (a box applied twice), with the residual
variance s0^2 of the same window. Each pixel is shifted by its own parallax, so the window follows
the slope of the ground, and neighbours beyond a depth edge have no effect.

Ground seen at a grazing angle a is foreshortened by sin a from row to row, not along them: square
windows cover metres of it, including crests that occlude the ground behind them by less than a
pixel of parallax, whose height is then overestimated. For rows of such ground windows are lower and
wider, and the membrane is softer from row to row (`view_of_ground`).

A window averages the noise of its own area alone. A membrane through the parallaxes averages as
much as noise and texture require: their corrections d are relaxed towards the least

    sum w (r - g d)^2 / s^2 + sum k' (dp - dp_0)^2,     k' = k / (1 + (dp - dp_0)^2 / e^2)

over pixels and over pairs of neighbours in rows and columns, whose difference is dp, and dp_0 that
of the plane of the ground. The noise s is that of the window under its parallax, and r is less its
mean nearby; w = 1 / (1 + (r / 2s)^2) leaves out outliers, and e ends the membrane at edges.

The stiffness k follows from the spectra of noise and relief (`_relax`). Relief is fractal: its
density is c f^-(2 + 2H) at the angular frequency f along the ground, and its variogram grows
with the lag to the power 2H. Between lags of `LAGS_PX` it grows by relief alone, because both
contain the same noise, which gives c. The noise of a parallax has the density
N = s^2 / (g^2 sin a) over the ground. A membrane has 1 / (k sin a f^2), which is made that of the
relief at the frequency at which relief and noise are equal: what is slower is relief, what is
faster is noise. Smoothing over rows moves relief away from the camera, and it is moved back
(`OFF_CENTRE`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import gamma
from typing import TypeAlias

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, GreyImage, Mask, ParallaxMap
from solmap.photogrammetry.matching.kernels import (
    least_squares_step,
    parallax_residual,
    relax_membrane,
    smooth_surfaces,
    window_sums,
    window_variance,
)
from solmap.photogrammetry.matching.records import DenseMatches, EpipolarImages
from solmap.photogrammetry.matching.resampling import (
    row_coefficients,
    row_slope,
    shift_rows,
)
from solmap.photogrammetry.matching.stereo.semi_global import (
    LEVEL,
    GroundView,
    NormalisedImage,
    SemiGlobalParams,
    match_both_ways,
    normalise_locally,
    remove_speckle,
    rough_parallax,
    to_eight_bit,
    view_of_ground,
)
from solmap.photogrammetry.matching.stereo.sparse import largest_parallax_px
from solmap.photogrammetry.ranges import (
    Few,
    NearestMetres,
    OddPixels,
    Pixels,
    PixelsOrZero,
    Share,
    WholeParallax,
)

ERROR_SHARE = 2.35
"""Variance of a parallax over that of its differences at the distance at which relief and noise are
equal: known truth of planes, simulated, compressed and rendered ground and Middlebury's scenes,
where errors then are 0.8, 1.0, 1.05, 0.95 and 1.0 stated standard deviations."""

SURFACE_EDGE_PX = np.float32(0.2)
"""Largest difference that counts as relief: the membrane hardly joins larger ones."""

ROUGHNESS = 0.8
"""Hurst exponent H of relief: 0.8 on simulated and rendered ground (known truth)."""

LAGS_PX = 10, 20
"""Distances within rows between which the variogram is that of relief: wider than the windows."""

DENSITY_OF_VARIANCE = (
    2 * np.pi * ROUGHNESS * 4**ROUGHNESS * gamma(1 + ROUGHNESS) / gamma(1 - ROUGHNESS)
)
"""Density of relief at the frequency of 1 over its variogram at the lag of 1, by the integral of
f^-(1 + 2H) (1 - J_0(f)) from 0 to infinity."""

LEAST_RELIEF_PX, USUAL_RELIEF_PX = 0.001, 0.01
"""Standard deviation of relief from a pixel to the next one: at least, and if it is unknown."""

LARGEST_RELIEF_PX = 0.5
"""Largest difference over these distances that counts as relief."""

ACROSS_ROWS = 1.5
"""Power of sin a by which the membrane is softer between rows than within them. On an endless
fractal it would be 2; differences between far rows, metres apart, are smaller than that of one."""

OFF_CENTRE = np.float32(4 - ACROSS_ROWS + 1 - ROUGHNESS / (1 + ROUGHNESS))
"""By how many times L^2 / y relief is moved away from the camera: L^2 is stiffness over information
between rows, and y the number of rows to the horizon. Smoothing spreads it over rows by 2 L^2, of
which the further ones show more ground, and a height causes less parallax there: 4. It spreads more
towards stiffer rows, and stiffness grows as a power of y, which is the rest."""

LARGEST_LINES = np.float32(0.3)
"""Largest movement; flat ground, which is smoothed most, has no relief to be moved."""

LEAST_SINE = np.float32(0.02)
"""Sine of the angle below which ground is treated as seen at it."""

RELIEF_EDGE_PX = np.float32(0.07)
"""Difference at which the membrane's stiffness is halved."""

OUTLIER_SIGMAS = 2.0
"""Residual, in standard deviations of the noise, at which the weight of a pixel is halved."""

WARPS = 2
"""How often residuals are computed again for the membrane."""

SWEEPS = 12
"""Relaxations for each of them. With 40, errors by noise are a tenth less on compressed images, and
those by relief up to 6 % larger on path-traced ones."""

SURROUNDINGS_PX = 21
"""Window, odd, over which the images may differ in brightness, and relief is averaged."""

TINY = np.float32(1e-6)
"""Energy or contrast treated as zero."""

FURTHEST_PX = 1.0
"""Largest movement of a pixel from its first parallax; beyond it, it has moved to another
surface."""


SQUEEZE = 0.5
"""Factor by which windows are lower and wider there: the root of `GRAZING`, so that they keep their
area and are as foreshortened as the ground."""


REACH_SIGMAS = 1.5
"""Radius of the discs of smoothing, in standard deviations of their weights."""

Row: TypeAlias = Float32[np.ndarray, " lines"]
"""A number for every row of an image."""


@dataclass(frozen=True, slots=True)
class RefinementParams:
    """How the parallax of every pixel is refined and accepted."""

    box_px: OddPixels = 5
    """Side of the box, odd, that is applied twice: the window is 9 pixels wide, and half of its
    weight lies within 5, about the block of semi-global matching. On far ground it is 9 by 3."""
    steps: Few = 3
    """Lucas-Kanade steps."""
    smoothing_px: PixelsOrZero = 2.0
    """Standard deviation in space of the smoothing that removes pixel locking, which recurs with
    every pixel of parallax: on level ground, about every seven rows of a Navcam image."""
    edge_px: Pixels = 2.5
    """Difference in parallax at which that smoothing ends: larger ones are another surface. The
    weight decreases linearly to it."""
    largest_sigma_px: Pixels = 1.0
    """Largest standard deviation that is kept."""
    least_correlation: Share = 0.3
    """Least correlation of the windows after the last step; below it they show different ground.
    Faint texture on a smooth wall correlates by less than a half and is matched rightly
    (Middlebury)."""


NORMALISATION_PX = 255
"""Window of the local normalisation, odd: wide enough that an edge or a crest does not change the
contrast of the faint ground beside it, and narrow enough for vignetting and shadows."""

FAR_NORMALISATION_PX = 63
"""The same for ground matched about a prediction: far ground is a band of few rows, whose contrast
a wider window would take from the foreground (8 times as much of it is matched, known truth)."""


@dataclass(frozen=True, slots=True)
class DenseParams:
    """How every pixel is matched."""

    nearest_range_m: NearestMetres = 1.2
    """Nearest ground, as in sparse matching: limits the search."""
    least_parallax_px: WholeParallax = -2
    """Parallax of infinity minus the effect of a rig error of 0.1 degrees."""
    semi_global: SemiGlobalParams = field(default_factory=SemiGlobalParams)
    refinement: RefinementParams = field(default_factory=RefinementParams)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Agreement of the windows about all pixels under a parallax."""

    sigma_px: ParallaxMap
    correlation: GreyImage


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """The left image in the windows about all pixels."""

    known: Mask
    """Where there is a parallax."""
    slope: GreyImage
    """Slope along the row; 0 where there is no parallax."""
    count: GreyImage
    """Weight of the pixels with a parallax."""
    slopes: GreyImage
    """Sum of the slopes."""
    energy: GreyImage
    """E: squared slope minus that of its mean."""


def match_densely(images: EpipolarImages, params: DenseParams | None = None) -> DenseMatches:
    """Parallax and its standard deviation, pixels, on the grid of the left image; NaN: none."""
    params = params or DenseParams()
    left, right = _normalise(images, NORMALISATION_PX)
    largest = int(np.ceil(largest_parallax_px(images.geometry, params.nearest_range_m)))
    search = (params.least_parallax_px, largest)
    rough = rough_parallax(left, right, search, params.semi_global)
    ground = view_of_ground(rough, images.geometry)
    parallax, sigma = PixelwiseMatcher(left, right, params.refinement, ground).refine(rough)
    parallax = remove_speckle(parallax, params.semi_global)
    return DenseMatches(parallax, np.where(np.isfinite(parallax), sigma, np.float32(np.nan)))


def match_about(
    images: EpipolarImages, predicted: ParallaxMap, search_px: int, params: DenseParams
) -> DenseMatches:
    """Parallax and its standard deviation, searched to either side of a smooth prediction.

    The right image is shifted by the prediction less the search, R'(u) = R(u - t(u)), so that the
    remainder d = p(x) - t(x - d) is positive.
    """
    shift = predicted - np.float32(search_px)
    image, known = shift_rows(images.right, images.right_mask, shift)
    shifted = replace(images, right=image, right_mask=known)
    left, right = _normalise(shifted, FAR_NORMALISATION_PX)
    eight_bit = (to_eight_bit(left.grey), to_eight_bit(right.grey))
    masks = (left.mask, right.mask)
    rough = match_both_ways(*eight_bit, masks, (0, 2 * search_px), params.semi_global)
    ground = replace(view_of_ground(predicted, images.geometry), gradient=LEVEL)
    d, sigma = PixelwiseMatcher(left, right, params.refinement, ground).refine(rough)
    d = remove_speckle(d, params.semi_global)
    grid = np.indices(d.shape, dtype=np.float32)
    there = cv2.remap(shift, grid[1] - np.nan_to_num(d), grid[0], cv2.INTER_LINEAR)
    parallax = d + there
    parallax[~(parallax > 0)] = np.nan
    return DenseMatches(parallax, np.where(np.isfinite(parallax), sigma, np.float32(np.nan)))


def _normalise(images: EpipolarImages, window_px: int) -> tuple[NormalisedImage, NormalisedImage]:
    """Both images, each in units of its local contrast."""
    left, right = (
        normalise_locally(image, mask, window_px)
        for image, mask in ((images.left, images.left_mask), (images.right, images.right_mask))
    )
    return left, right


class PixelwiseMatcher:
    """Compares two locally normalised images under a parallax map."""

    def __init__(
        self,
        left: NormalisedImage,
        right: NormalisedImage,
        params: RefinementParams,
        ground: GroundView,
    ) -> None:
        self.left = left.grey
        self.slope = row_slope(row_coefficients(left.grey))
        self.right_coefficients = row_coefficients(right.grey)
        self.params = params
        self.ground = ground
        self.ones = np.ones_like(left.grey)

    def refine(self, rough: ParallaxMap) -> tuple[ParallaxMap, ParallaxMap]:
        """Refined parallax where reliable, and its standard deviation."""
        windows = self._windows(np.isfinite(rough))
        parallax = self.smooth(rough)
        for _ in range(self.params.steps - 1):
            parallax = self.smooth(parallax + self._step(windows, parallax))
        parallax += self._step(windows, parallax)
        parallax, frequency = self._relax(windows, parallax)
        fit = self._fit(windows, parallax, frequency)
        good = (fit.sigma_px <= self.params.largest_sigma_px) & (parallax > 0)
        good &= fit.correlation >= self.params.least_correlation
        good &= np.abs(parallax - rough) <= FURTHEST_PX
        nothing = np.float32(np.nan)
        return np.where(good, parallax, nothing), np.where(good, fit.sigma_px, nothing)

    def smooth(self, parallax: ParallaxMap) -> ParallaxMap:
        """Parallax smoothed within surfaces: a bilateral filter that ignores gaps."""
        sigma_px, edge_px = self.params.smoothing_px, self.params.edge_px
        radius = round(REACH_SIGMAS * sigma_px)
        return smooth_surfaces(parallax, np.float32(sigma_px), np.float32(edge_px), radius)

    def _fit(self, windows: Windows, parallax: ParallaxMap, frequency: Row) -> Fit:
        """Agreement of the images under a parallax whose smoothing ends at a frequency."""
        variance = self._variance(windows, self._residual(parallax))
        share = np.float32(ERROR_SHARE) * frequency ** np.float32(-2 * ROUGHNESS)
        return Fit(
            sigma_px=np.sqrt(np.maximum(share[:, None] * self._relief(parallax), TINY)),
            correlation=1 - variance / np.maximum(2 * self._contrast(windows), TINY),
        )

    def _relief(self, parallax: ParallaxMap) -> ParallaxMap:
        """Mean square difference of neighbours in a row, less that of the plane of the ground."""
        off = np.diff(parallax, axis=1, prepend=np.float32(np.nan)) - self.ground.gradient[0]
        square = np.clip(off, -SURFACE_EDGE_PX, SURFACE_EDGE_PX) ** 2
        return _mean(square, np.isfinite(square))

    def _windows(self, known: Mask) -> Windows:
        """Sums that do not depend on the parallax, only on where there is one."""
        one, slope = known.astype(np.float32), np.where(known, self.slope, np.float32(0))
        count = np.maximum(self._window_sum(one, one), np.float32(1e-3))
        total = self._window_sum(slope, one)
        variance = window_variance(self._window_sum(slope, slope), total, count)
        return Windows(known, slope, count, total, np.maximum(count * variance, TINY))

    def _step(self, windows: Windows, parallax: ParallaxMap) -> ParallaxMap:
        """The least-squares correction of a parallax."""
        residual = self._residual(parallax)
        total = self._window_sum(residual, self.ones)
        products = self._window_sum(windows.slope, residual)
        return least_squares_step(products, total, windows.slopes, windows.count, windows.energy)

    def _relax(self, windows: Windows, parallax: ParallaxMap) -> tuple[ParallaxMap, Row]:
        """The parallax of a membrane, from that of windows, and the frequency f at which it ends.

        Frequencies are those of every row, in radians a pixel.
        """
        variance = np.maximum(self._variance(windows, self._residual(parallax)), TINY)
        certain = np.where(windows.known, 1 / variance, np.float32(0))
        right_slopes = row_coefficients(row_slope(self.right_coefficients))
        density = relief_density(parallax, self.ground)
        information = _mean_of_rows(certain * windows.slope**2, windows.known)
        sine = np.maximum(self.ground.sine, LEAST_SINE)
        frequency = (density * information * sine) ** np.float32(1 / (2 + 2 * ROUGHNESS))
        along = frequency ** np.float32(2 * ROUGHNESS) / (density * sine)
        stiffness = (along, along * sine ** np.float32(ACROSS_ROWS))
        for _ in range(WARPS):
            residual = self._residual(parallax)
            residual -= _nearby(residual * certain) / np.maximum(_nearby(certain), TINY)
            slope = parallax_residual(right_slopes, -self.slope, parallax) / 2
            weight = certain / (1 + certain * (residual / np.float32(OUTLIER_SIGMAS)) ** 2)
            fit = (weight * slope**2, weight * slope * residual)
            parallax = relax_membrane(
                parallax, fit, stiffness, self.ground.gradient, RELIEF_EDGE_PX, SWEEPS
            )
        per_line = np.diff(sine, append=sine[-1:]) / sine
        lines = np.minimum(OFF_CENTRE * stiffness[1] / information * per_line, LARGEST_LINES)
        return moved_down(parallax, lines, self.ground.gradient[1]), frequency

    def _residual(self, parallax: ParallaxMap) -> GreyImage:
        """The right image less the left one under a parallax; 0 where there is none."""
        return parallax_residual(self.right_coefficients, self.left, parallax)

    def _variance(self, windows: Windows, residual: GreyImage) -> GreyImage:
        """Variance of residuals in the window."""
        total = self._window_sum(residual, self.ones)
        return window_variance(self._window_sum(residual, residual), total, windows.count)

    def _contrast(self, windows: Windows) -> GreyImage:
        """Variance of the left image in the window, where there is parallax."""
        grey = np.where(windows.known, self.left, np.float32(0))
        squares = self._window_sum(grey, grey)
        return window_variance(squares, self._window_sum(grey, self.ones), windows.count)

    def _window_sum(self, a: GreyImage, b: GreyImage) -> GreyImage:
        """Sums of a b over the windows about all pixels."""
        side = self.params.box_px
        low, wide = int(side * SQUEEZE) | 1, int(side / SQUEEZE) - 1 | 1
        far, near = (_twice(wide), _twice(low)), (_twice(side), _twice(side))
        return window_sums(a, b, far, near, self.ground.far_lines)


def relief_density(parallax: ParallaxMap, ground: GroundView) -> np.float32:
    """Factor c of the density of relief, c f^-(2 + 2H), pixels; f in radians a pixel."""
    variances = []
    for lag in LAGS_PX:
        off = parallax[:, lag:] - parallax[:, :-lag] - np.float32(lag) * ground.gradient[0]
        known = np.isfinite(off)
        if not known.any():
            return np.float32(DENSITY_OF_VARIANCE * USUAL_RELIEF_PX**2)
        square = np.minimum(off * off, np.float32(LARGEST_RELIEF_PX**2), where=known, out=off)
        variances.append(float(square.mean(where=known, dtype=np.float64)))
    near, far = (lag ** (2 * ROUGHNESS) for lag in LAGS_PX)
    variance = (variances[1] - variances[0]) / (far - near)
    return np.float32(DENSITY_OF_VARIANCE * max(variance, LEAST_RELIEF_PX**2))


def moved_down(parallax: ParallaxMap, lines: Row, per_line: np.float32) -> ParallaxMap:
    """Relief of a parallax moved down by a part of a line; `per_line`: gradient of the ground."""
    slope = np.zeros_like(parallax)
    slope[1:-1] = (parallax[2:] - parallax[:-2]) / 2 - per_line
    slope = np.clip(np.nan_to_num(slope), -SURFACE_EDGE_PX, SURFACE_EDGE_PX)
    return parallax - lines[:, None] * slope


def _mean_of_rows(values: GreyImage, known: Mask) -> Row:
    """Mean of the known pixels of every row and those around it."""
    one = known.astype(np.float32)
    sums, number = (
        cv2.blur(cv2.reduce(a, 1, cv2.REDUCE_SUM), (1, SURROUNDINGS_PX)) for a in (values, one)
    )
    return np.maximum(sums / np.maximum(number, 1), TINY).ravel()


def _nearby(values: GreyImage) -> GreyImage:
    """Mean over the surroundings."""
    return cv2.blur(values, (SURROUNDINGS_PX, SURROUNDINGS_PX))


def _mean(values: GreyImage, known: Mask) -> GreyImage:
    """Mean over the surroundings, of the pixels that are known."""
    share = np.maximum(_nearby(known.astype(np.float32)), np.float32(1e-3))
    return _nearby(np.where(known, values, np.float32(0))) / share


def _twice(width: int) -> Float32[np.ndarray, " n"]:
    """Weights of a box applied twice, from the middle outwards, that of the middle being 1."""
    return np.arange(width, 0, -1, dtype=np.float32) / np.float32(width)
