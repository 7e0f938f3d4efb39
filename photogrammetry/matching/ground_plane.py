"""Search about the parallax plane of the ground, found in a reduced image.

Seen from a mast, level or tilted ground has a parallax that is linear over the image: with the
plane n.P = h and P = Z ((x - c_x)/f, (y - c_y)/f, 1) one finds p = f B / Z = a + b x + c y. What
remains after taking that plane out is relief, whose range is a fraction of the whole. So the pair
is first matched in a reduced image, over the whole range; a plane is fitted to what was found by
least absolute deviations; and the full image is matched against the right image shifted by the
plane, over the range of the relief alone. On top of the time saved, the ground lies parallel to the
image, which is what semi-global matching favours.
"""

from __future__ import annotations

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Mask, ParallaxMap, Picture
from solmap.photogrammetry.matching.normalisation import NormalisedImage, eight_bit
from solmap.photogrammetry.matching.parallax_planes import ParallaxPlane, fit_plane
from solmap.photogrammetry.matching.semi_global import SemiGlobalParams, matched_both_ways

REDUCED_SEARCH_PX = 128
"""Widest search in the reduced image; the image is halved until the range fits."""

MARGIN_PX = 3
"""Pixels of the reduced image added to either end of the relief it showed."""

WHOLLY = 0.99
"""Share of a shifted pixel that must come from usable ones."""

FIT_POINTS = 20_000
"""Points that the plane is fitted to; more do not change it."""


def rough_parallax(
    left: NormalisedImage,
    right: NormalisedImage,
    search: tuple[int, int],
    params: SemiGlobalParams,
) -> ParallaxMap:
    """Semi-global parallax of locally normalised images."""
    halvings = max(1, int(np.ceil(np.log2((search[1] - search[0]) / REDUCED_SEARCH_PX))))
    scale = 2**halvings
    reduced = _reduced_parallax(left, right, search, scale, params)
    if not np.isfinite(reduced).any():
        return np.full(left.grey.shape, np.nan, np.float32)
    plane, relief = _plane_and_relief(reduced, scale)
    parallax = _matched_about(plane, relief, left, right, params)
    within = (parallax >= search[0]) & (parallax <= search[1])
    return np.where(within, parallax, np.float32(np.nan))


def _reduced_parallax(
    left: NormalisedImage,
    right: NormalisedImage,
    search: tuple[int, int],
    scale: int,
    params: SemiGlobalParams,
) -> ParallaxMap:
    """Parallax of the reduced pair, in pixels of the full one."""
    pictures: list[Picture] = []
    masks: list[Mask] = []
    for image, mask in ((left.grey, left.mask), (right.grey, right.mask)):
        size = (-(-image.shape[1] // scale) * scale, -(-image.shape[0] // scale) * scale)
        border = (0, size[1] - image.shape[0], 0, size[0] - image.shape[1])
        whole = cv2.copyMakeBorder(image, *border, cv2.BORDER_REPLICATE)
        known = cv2.copyMakeBorder(mask.astype(np.float32), *border, cv2.BORDER_CONSTANT, value=0)
        small = (size[0] // scale, size[1] // scale)
        pictures.append(eight_bit(cv2.resize(whole, small, interpolation=cv2.INTER_AREA)))
        masks.append(cv2.resize(known, small, interpolation=cv2.INTER_AREA) > 0.5)  # noqa: PLR2004
    reduced_search = (int(np.floor(search[0] / scale)), int(np.ceil(search[1] / scale)))
    found = matched_both_ways(
        pictures[0], pictures[1], (masks[0], masks[1]), reduced_search, params
    )
    return found * np.float32(scale)


def _plane_and_relief(reduced: ParallaxMap, scale: int) -> tuple[ParallaxPlane, tuple[int, int]]:
    """The plane through the parallaxes, and by how much they leave it."""
    line, sample = np.nonzero(np.isfinite(reduced))
    parallax = reduced[line, sample].astype(np.float64)
    x, y = (sample + 0.5) * scale - 0.5, (line + 0.5) * scale - 0.5
    some = slice(None, None, max(1, len(x) // FIT_POINTS))
    plane = fit_plane(np.column_stack([x[some], y[some]]), parallax[some])
    relief = parallax - plane.parallax_px(x, y)
    margin = MARGIN_PX * scale
    return plane, (
        int(np.floor(relief.min())) - margin,
        int(np.ceil(relief.max())) + margin,
    )


def _matched_about(
    plane: ParallaxPlane,
    relief: tuple[int, int],
    left: NormalisedImage,
    right: NormalisedImage,
    params: SemiGlobalParams,
) -> ParallaxMap:
    """Parallax of the full images, searched within the relief above and below the plane.

    With R'(x) = R(x - t(x)) the shifted right image and d the parallax between L and R', the
    partner of x is x - d - t(x - d).
    """
    grid = np.indices(left.grey.shape, dtype=np.float32)
    lines, samples = grid[0], grid[1]
    shifted = (samples - plane.parallax_px(samples, lines)).astype(np.float32)
    image = cv2.remap(right.grey, shifted, lines, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    known = cv2.remap(
        right.mask.astype(np.float32),
        shifted,
        lines,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
    )
    d = matched_both_ways(
        eight_bit(left.grey),
        eight_bit(image),
        (left.mask, known > WHOLLY),
        relief,
        params,
    )
    return (d + plane.parallax_px(samples - d, lines)).astype(np.float32)
