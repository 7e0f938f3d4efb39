"""Semi-global matching of eight-bit epipolar images, both ways.

OpenCV's StereoSGBM (after Hirschmüller 2008) minimises the Birchfield-Tomasi difference over small
blocks plus a penalty P1 for parallax steps of one pixel and P2 for larger ones along five paths.
Its penalties are kept at the proportion of its authors, 8 and 32 times the area of the block.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Mask, ParallaxMap, Picture

FIXED_POINT = 16
"""OpenCV's parallaxes are whole sixteenths of a pixel."""


@dataclass(frozen=True, slots=True)
class SemiGlobalParams:
    """How parallaxes are found before refinement."""

    block_px: int = 5
    """Side of the block, odd: small, so that depth edges stay sharp; 3 to 11 by OpenCV."""
    uniqueness_percent: int = 5
    """By how much the best cost must win: 5 to 15 by OpenCV."""
    agreement_px: float = 1.0
    """Largest difference between the parallax from left to right and from right to left."""
    smallest_surface_px: int = 100
    """Patches of fewer pixels are speckle: 50 to 200 by OpenCV."""
    surface_step_px: float = 1.5
    """Step of parallax between neighbours of one surface: steep rock faces reach about one."""


def matched_both_ways(
    left: Picture,
    right: Picture,
    masks: tuple[Mask, Mask],
    search: tuple[int, int],
    params: SemiGlobalParams,
) -> ParallaxMap:
    """Parallax on the left grid where both ways agree; `search` is least and largest parallax."""
    forth = _matched(left, right, search, params)
    back = _matched(left=right[:, ::-1], right=left[:, ::-1], search=search, params=params)[:, ::-1]
    forth = np.where(masks[0], forth, np.float32(np.nan))
    back = np.where(masks[1], back, np.float32(np.nan))
    agrees = np.abs(forth - _at_partner(back, forth)) <= params.agreement_px
    return without_speckle(np.where(agrees, forth, np.float32(np.nan)), params)


def without_speckle(parallax: ParallaxMap, params: SemiGlobalParams) -> ParallaxMap:
    """The parallaxes that belong to surfaces of some size."""
    gap = -32_000
    scaled = np.where(np.isfinite(parallax), parallax * FIXED_POINT, gap)
    fixed = np.ascontiguousarray(np.rint(scaled).clip(gap, 32_000).astype(np.int16))
    cv2.filterSpeckles(
        fixed, gap, params.smallest_surface_px, round(params.surface_step_px * FIXED_POINT)
    )
    return np.where(fixed == gap, np.float32(np.nan), parallax)


def _matched(
    left: Picture, right: Picture, search: tuple[int, int], params: SemiGlobalParams
) -> ParallaxMap:
    """OpenCV's parallax from left to right; NaN where it found none.

    OpenCV leaves out the columns whose search would leave the image, hence the borders.
    """
    least, largest = search
    count = max(16, 16 * int(np.ceil((largest - least + 1) / 16)))
    before, after = max(0, least + count), max(0, -least)
    padded = [
        cv2.copyMakeBorder(np.ascontiguousarray(image), 0, 0, before, after, cv2.BORDER_REPLICATE)
        for image in (left, right)
    ]
    area = params.block_px**2
    matcher = cv2.StereoSGBM.create(
        minDisparity=least,
        numDisparities=count,
        blockSize=params.block_px,
        P1=8 * area,
        P2=32 * area,
        preFilterCap=63,
        uniquenessRatio=params.uniqueness_percent,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
    fixed = matcher.compute(*padded)[:, before : before + left.shape[1]]
    found = fixed >= least * FIXED_POINT
    return np.where(found, fixed.astype(np.float32) / FIXED_POINT, np.float32(np.nan))


def _at_partner(back: ParallaxMap, forth: ParallaxMap) -> ParallaxMap:
    """The right image's parallax where the left one points to; NaN outside."""
    samples = forth.shape[1]
    sample = np.arange(samples) - np.where(np.isfinite(forth), forth, 1e6)
    nearest = np.rint(sample).astype(np.int64)
    inside = (nearest >= 0) & (nearest < samples)
    found = np.take_along_axis(back, nearest.clip(0, samples - 1), axis=1)
    return np.where(inside, found, np.float32(np.nan))
