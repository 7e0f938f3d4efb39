"""Dense parallax of a pair: semi-global matching, checked both ways, then refined by least squares.

The locally normalised images are matched semi-globally from left to right and from right to left,
about the parallax plane of the ground (`ground_plane`). A parallax stays where both ways agree and
where it is part of a larger surface; it is then refined at every pixel, and kept where texture
exceeds noise and the windows agree (`refinement`). The sky, shadows without detail, and what only
one eye sees end as NaN.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from solmap.photogrammetry.arrays import ParallaxMap
from solmap.photogrammetry.matching.ground_plane import rough_parallax
from solmap.photogrammetry.matching.normalisation import (
    NormalisedImage,
    eight_bit,
    locally_normalised,
)
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.refinement import PixelwiseMatcher, RefinementParams
from solmap.photogrammetry.matching.resampling import shifted
from solmap.photogrammetry.matching.semi_global import (
    SemiGlobalParams,
    matched_both_ways,
    without_speckle,
)
from solmap.photogrammetry.matching.sparse import largest_parallax_px


@dataclass(frozen=True, slots=True)
class DenseParams:
    """How every pixel is matched."""

    nearest_range_m: float = 1.2
    """Nearest ground, as in sparse matching: sets the search."""
    least_parallax_px: int = -2
    """Parallax of infinity less what an error of the stereo bar of 0.1 degrees may take off."""
    normalisation_px: int = 31
    """Window of the local normalisation, odd: wider than any correlation window."""
    semi_global: SemiGlobalParams = field(default_factory=SemiGlobalParams)
    refinement: RefinementParams = field(default_factory=RefinementParams)


@dataclass(frozen=True, slots=True)
class SharedSigma:
    """What all parallaxes of a pair are off by together, as a standard deviation.

    No number of pixels averages it out: hypot(offset, stretch x parallax).
    """

    offset_px: float = 0.0
    """By a turn of one camera about the vertical."""
    stretch: float = 0.0
    """By the length of the base, as a share of it."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseMatches:
    """Parallax of every pixel that was matched, with its standard deviation."""

    parallax_px: ParallaxMap
    sigma_px: ParallaxMap
    shared: SharedSigma | None = None
    """The part of `sigma_px` that is one for all pixels; None where there is none."""


def match_densely(images: EpipolarImages, params: DenseParams | None = None) -> ParallaxMap:
    """Parallax on the grid of the left epipolar image; NaN where not matched."""
    return match_densely_with_sigma(images, params).parallax_px


def match_densely_with_sigma(
    images: EpipolarImages, params: DenseParams | None = None
) -> DenseMatches:
    """Parallax and its standard deviation on the grid of the left epipolar image."""
    params = params or DenseParams()
    left, right = _normalised(images, params)
    largest = int(np.ceil(largest_parallax_px(images.geometry, params.nearest_range_m)))
    search = (params.least_parallax_px, largest)
    rough = rough_parallax(left, right, search, params.semi_global)
    parallax, sigma = PixelwiseMatcher(left, right, params.refinement).refine(rough)
    parallax = without_speckle(parallax, params.semi_global)
    return DenseMatches(parallax, np.where(np.isfinite(parallax), sigma, np.float32(np.nan)))


def match_about(
    images: EpipolarImages, predicted: ParallaxMap, search_px: int, params: DenseParams
) -> DenseMatches:
    """Parallax and its standard deviation, searched to either side of a smooth prediction.

    The right image is shifted by the prediction less the search, R'(u) = R(u - t(u)), so that what
    is left, d = p(x) - t(x - d), is positive.
    """
    shift = predicted - np.float32(search_px)
    image, known = shifted(images.right, images.right_mask, shift)
    left, right = _normalised(replace(images, right=image, right_mask=known), params)
    pictures = (eight_bit(left.grey), eight_bit(right.grey))
    masks = (left.mask, right.mask)
    rough = matched_both_ways(*pictures, masks, (0, 2 * search_px), params.semi_global)
    d, sigma = PixelwiseMatcher(left, right, params.refinement).refine(rough)
    d = without_speckle(d, params.semi_global)
    grid = np.indices(d.shape, dtype=np.float32)
    there = cv2.remap(shift, grid[1] - np.nan_to_num(d), grid[0], cv2.INTER_LINEAR)
    parallax = d + there
    parallax[~(parallax > 0)] = np.nan
    return DenseMatches(parallax, np.where(np.isfinite(parallax), sigma, np.float32(np.nan)))


def parallax_sigma(
    images: EpipolarImages, parallax: ParallaxMap, params: DenseParams | None = None
) -> ParallaxMap:
    """Standard deviation of dense parallaxes, pixels, from how well the windows agree."""
    params = params or DenseParams()
    left, right = _normalised(images, params)
    sigma = PixelwiseMatcher(left, right, params.refinement).fit(parallax).sigma_px
    return np.where(np.isfinite(parallax), sigma, np.float32(np.nan))


def _normalised(
    images: EpipolarImages, params: DenseParams
) -> tuple[NormalisedImage, NormalisedImage]:
    """Both images, each in units of its local contrast."""
    left, right = (
        locally_normalised(image, mask, params.normalisation_px)
        for image, mask in ((images.left, images.left_mask), (images.right, images.right_mask))
    )
    return left, right
