"""Verification of matches by the parallax curve, and by their neighbours.

Ordered row first, from the top of the image to its foot, parallaxes follow a curve: the general
shape of the terrain. A median filter extracts it, and matches further from it than the roughness of
the terrain allows are blunders (Di et al. 2008, section 5). Two things are added. The image is cut
into upright strips with a curve each, because ground that falls off sideways has no single parallax
a row. And each match is held against the median of its nearest neighbours, whose spread says how
rough the terrain is just there.

Roughness is relative: over level ground seen from height H, an object of height t on it changes the
parallax p of a ray by p t / (H - t), whatever the distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from photogrammetry.arrays import Flags, ImagePoints, PerPoint


@dataclass(frozen=True, slots=True)
class VerificationParams:
    """What counts as a blunder."""

    strips: int = 4
    """Upright strips with a parallax curve each: a quarter of a 45 degree field is about 11
    degrees, over which ground of 20 degrees cross slope changes its parallax by less than half."""
    curve_points: int = 31
    """Length of the median filter, odd: up to 15 blunders in a row are outvoted."""
    roughness: float = 0.5
    """Terrain roughness as a share of the parallax: rocks of half a metre below a 1.5 m mast."""
    roughness_px: float = 3.0
    """Least terrain roughness, pixels: far away, ridges behind each other."""
    neighbours: int = 12
    """Nearest matches that vote on one."""
    spread: float = 4.0
    """Distance from the neighbours' median, in robust standard deviations of theirs."""
    least_spread_px: float = 0.75
    """Smallest standard deviation assumed of neighbours: pixel-sized relief on smooth ground."""


def follows_the_terrain(
    points: ImagePoints, parallax_px: PerPoint, params: VerificationParams
) -> Flags:
    """Which matches lie on the terrain that the others describe."""
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
        length = min(params.curve_points, 2 * (len(members) // 2) + 1)
        curve[row_first] = ndimage.median_filter(parallax_px[row_first], length, mode="reflect")
    return curve


def _agrees_with_neighbours(
    points: ImagePoints, parallax_px: PerPoint, params: VerificationParams
) -> Flags:
    """Whether a match lies within the spread of its nearest neighbours about their plane's median.

    With too few matches to vote there is nothing to hold them against, and all are kept.
    """
    if len(points) <= params.neighbours:
        return np.ones(len(points), dtype=bool)
    _, nearest = KDTree(points).query(points, k=params.neighbours + 1)
    around = parallax_px[nearest[:, 1:]]
    middle = np.median(around, axis=1)
    spread = 1.4826 * np.median(np.abs(around - middle[:, None]), axis=1)
    return np.abs(parallax_px - middle) <= params.spread * np.maximum(
        spread, params.least_spread_px
    )
