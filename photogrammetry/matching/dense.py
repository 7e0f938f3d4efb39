"""Dense parallax of a pair: semi-global matching, checked both ways, then refined by least squares.

The locally normalised images are matched semi-globally from left to right and from right to left,
about the parallax plane of the ground (`ground_plane`). A parallax stays where both ways agree and
where it is part of a larger surface; it is then refined at every pixel, and kept where texture
exceeds noise and the windows agree (`refinement`). The sky, shadows without detail, and what only
one eye sees end as NaN.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from photogrammetry.arrays import ParallaxMap
from photogrammetry.matching.ground_plane import rough_parallax
from photogrammetry.matching.normalisation import NormalisedImage, locally_normalised
from photogrammetry.matching.records import EpipolarImages
from photogrammetry.matching.refinement import PixelwiseMatcher, RefinementParams
from photogrammetry.matching.semi_global import SemiGlobalParams, without_speckle
from photogrammetry.matching.sparse import largest_parallax_px


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


@dataclass(frozen=True, slots=True, eq=False)
class DenseMatches:
    """Parallax of every pixel that was matched, with its standard deviation."""

    parallax_px: ParallaxMap
    sigma_px: ParallaxMap


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
