"""Windows of the left image searched over an area of the right one.

Where two views differ much, what is a point of interest in one is none in the other. So windows
about the interest points of the left image are compared with every place within reach, by the
normalised cross-correlation; the best place is searched back in the left image, and a point whose
way back ends elsewhere is dropped.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from solmap.photogrammetry.arrays import GreyImage, Int32
from solmap.photogrammetry.matching.interest_points import FoerstnerParams, interest_points
from solmap.photogrammetry.matching.least_squares import refined_offsets
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.vertical_parallax import VerticalParallax

BACK_PX = 1
"""Distance by which the way back may miss: places are whole pixels."""


@dataclass(frozen=True, slots=True)
class AreaSearchParams:
    """How windows are searched; defaults as in sparse matching, where Di et al. 2008 give them."""

    interest: FoerstnerParams = field(
        default_factory=lambda: FoerstnerParams(smallest_weight=0.1, count=1200, cell_px=32)
    )
    """Points of the left image: also in faint texture, and no more than are needed."""
    window_px: int = 15
    """Side of the correlation window, odd."""
    least_correlation: float = 0.8
    """Threshold of the normalised cross-correlation."""
    lines: int = 6
    """Rows searched to either side: 0.3 degrees of a Navcam."""


def search_area(
    images: EpipolarImages, reach_px: int, params: AreaSearchParams
) -> VerticalParallax:
    """Offsets, to a fraction of a pixel, of left points searched `reach_px` along their rows."""
    half = params.window_px // 2
    margin = half + max(2, half // 2)
    found = interest_points(images.left, images.left_mask, params.interest, margin).pixels
    reach = (reach_px, params.lines)
    right, good = _best(images.left, images.right, found, reach, params)
    good &= images.right_mask[right[:, 1], right[:, 0]]
    left, right = found[good], right[good]
    back, good = _best(images.right, images.left, right, reach, params)
    good &= np.abs(back - left).max(axis=1, initial=0) <= BACK_PX
    left, start = left[good], (right - left)[good].astype(np.float64)
    offset = refined_offsets(images, left, start, params.window_px)
    settled = np.isfinite(offset).all(axis=1)
    return VerticalParallax(
        left[settled].astype(np.float64),
        offset[settled, 1],
        -offset[settled, 0],
        images.geometry,
    )


def _best(
    source: GreyImage,
    target: GreyImage,
    pixels: Int32[np.ndarray, "n 2"],
    reach: tuple[int, int],
    params: AreaSearchParams,
) -> tuple[Int32[np.ndarray, "n 2"], np.ndarray]:
    """The place within reach that correlates best with the window of each pixel, and whether well.

    A best place on the rim of the area is no maximum.
    """
    half, (dx, dy) = params.window_px // 2, reach
    border = (dy + half, dy + half, dx + half, dx + half)
    wide = cv2.copyMakeBorder(target, *border, cv2.BORDER_REPLICATE)
    places, good = pixels.copy(), np.zeros(len(pixels), dtype=bool)
    for k, (x, y) in enumerate(pixels.tolist()):
        window = source[y - half : y + half + 1, x - half : x + half + 1]
        if window.shape != (params.window_px, params.window_px):
            continue
        area = wide[y : y + 2 * (dy + half) + 1, x : x + 2 * (dx + half) + 1]
        score = cv2.matchTemplate(area, window, cv2.TM_CCOEFF_NORMED)
        _, best, _, (right, down) = cv2.minMaxLoc(score)
        inside = 0 < right < 2 * dx and 0 < down < 2 * dy
        good[k] = inside and best >= params.least_correlation
        places[k] = (x + right - dx, y + down - dy)
    limits = np.array([target.shape[1] - 1, target.shape[0] - 1])
    good &= ((places >= 0) & (places <= limits)).all(axis=1)
    return places.clip(0, limits).astype(np.int32), good
