"""Verification of matches by the parallax curve, and by their neighbours.

Ordered row first, from the top of the image to its foot, parallaxes follow a curve: the general
shape of the terrain. A median filter extracts it, and matches further from it than the roughness of
the terrain allows are blunders (Di et al. 2008, section 5). Two things are added. The image is
divided into vertical strips with a curve each, because ground with a cross slope has no single
parallax per row. And each match is compared with the plane of least absolute deviations through its
nearest neighbours, whose spread about it is the local roughness.

Roughness is relative: over level ground seen from height H, an object of height t on it changes the
parallax p of a ray by p t / (H - t) at any distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from solmap.photogrammetry.arrays import Flags, ImagePoints, PerPoint
from solmap.photogrammetry.matching.kernels import fit_planes
from solmap.photogrammetry.ranges import Factor, FactorOrZero, Few, Pixels, PixelsOrZero
from solmap.photogrammetry.robust import MAD_TO_SIGMA

PLANE_STEPS = 6
"""Reweightings of the neighbours' plane."""

LEAST_DEVIATION_PX = 0.1
"""Deviations below this have equal weight."""


CURVE_POINTS = 31
"""Length of the median filter, odd: tolerates up to 15 blunders in a row."""


NEIGHBOURS = 12
"""Nearest matches used to test one."""


@dataclass(frozen=True, slots=True)
class VerificationParams:
    """Criteria of blunders."""

    strips: Few = 4
    """Vertical strips with a parallax curve each: a quarter of a 45 degree field is about 11
    degrees, over which ground of 20 degrees cross slope changes its parallax by less than half."""
    roughness: FactorOrZero = 0.5
    """Terrain roughness as a fraction of the parallax: rocks of half a metre below a 1.5 m mast."""
    roughness_px: PixelsOrZero = 3.0
    """Least terrain roughness, pixels: distant ridges behind each other."""
    spread: Factor = 4.0
    """Distance from the neighbours' plane, in their robust standard deviations."""
    least_spread_px: Pixels = 0.75
    """Smallest standard deviation assumed of neighbours: pixel-sized relief on smooth ground."""


def agrees_with_terrain(
    points: ImagePoints, parallax_px: PerPoint, params: VerificationParams
) -> Flags:
    """Which matches agree with the terrain by the others."""
    curve = parallax_curve(points, parallax_px, params)
    limit = np.maximum(params.roughness * np.abs(curve), params.roughness_px)
    accepted = np.abs(parallax_px - curve) <= limit
    accepted[accepted] = _agrees_with_neighbours(points[accepted], parallax_px[accepted], params)
    return accepted


def parallax_curve(
    points: ImagePoints, parallax_px: PerPoint, params: VerificationParams
) -> PerPoint:
    """Median-filtered parallax in row-first order, strip by strip, at each point."""
    curve = np.array(parallax_px)
    if not len(points):
        return curve
    edges = np.linspace(points[:, 0].min(), points[:, 0].max(), params.strips + 1)[1:-1]
    strip = np.searchsorted(edges, points[:, 0], side="right")
    for number in range(params.strips):
        members = np.nonzero(strip == number)[0]
        row_first = members[np.lexsort((points[members, 0], np.floor(points[members, 1])))]
        length = min(CURVE_POINTS, 2 * (len(members) // 2) + 1)
        curve[row_first] = ndimage.median_filter(parallax_px[row_first], length, mode="reflect")
    return curve


def _agrees_with_neighbours(
    points: ImagePoints, parallax_px: PerPoint, params: VerificationParams
) -> Flags:
    """Whether a match lies on the plane through its nearest neighbours, within their spread.

    With too few matches for the test, all are kept.
    """
    if len(points) <= NEIGHBOURS:
        return np.ones(len(points), dtype=bool)
    _, nearest = KDTree(points).query(points, k=NEIGHBOURS + 1)
    around = parallax_px[nearest[:, 1:]]
    offsets = points[nearest[:, 1:]] - points[:, None]
    planes = fit_planes(offsets, around, LEAST_DEVIATION_PX, PLANE_STEPS)
    spread = MAD_TO_SIGMA * np.median(np.abs(planes[:, 1:]), axis=1)
    limit = params.spread * np.maximum(spread, params.least_spread_px)
    return np.abs(parallax_px - planes[:, 0]) <= limit
