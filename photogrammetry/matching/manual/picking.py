"""Measure a point that a person picked in images of two stops, to a fraction of a pixel.

The patch around the first point is transformed over its facet of ground into the second image, with
the present orientation (`parallax_planes`), and shifted to the picked point. Around it the patch is
found by correlation and measured by least squares (`conjugates`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, ParallaxMap
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.conjugates import (
    ConjugateParams,
    View,
    common_grids,
    find_conjugates,
)
from solmap.photogrammetry.matching.parallax_planes import (
    map_points,
    parallax_planes,
    plane_homographies,
)

PICK = ConjugateParams(half_px=10, threshold=0.7, ambiguity=0.85, sigma_floor_px=0.25)
"""Stricter than for verified ties, because a picked point is less certain: the match must be
unique."""
REACH_PX = 6.0
"""Search distance to each side of the picked point: the usual error of picking on a screen."""
LARGEST_REACH_PX = 40.0
LEAST_REACH = 2
"""Least reach in cells: a peak needs neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class PickedView:
    """The left epipolar image of a pair, and its pose."""

    view: View
    geometry: EpipolarPair
    parallax: ParallaxMap
    lsl_from_pair: Pose


@dataclass(frozen=True, slots=True)
class PickedPlace:
    """Position of the point in the second left epipolar image."""

    place: tuple[float, float]
    sigma_px: float
    """Root mean square over both axes."""
    correlation: float


def measure_pick(
    first: PickedView,
    second: PickedView,
    point: Float64[np.ndarray, " 2"],
    start: Float64[np.ndarray, " 2"],
    reach_px: float,
) -> PickedPlace:
    """The conjugate of a point of the first image within `reach_px` of a place of the second.

    Raises:
        MatchingError: the ground around the point is not known, or no match was found.
    """
    maps = _map(first, second, point)
    at, _ = map_points(maps, point[None])
    if not np.isfinite(at).all():
        raise MatchingError(
            "the ground at the first point is behind the second camera: do both images show the "
            "same ground?"
        )
    move = np.eye(3)
    move[:2, 2] = start - at[0]
    reach = _reach_cells(move @ maps, point, reach_px)
    found = find_conjugates(first.view, second.view, point[None], move @ maps, reach, PICK)
    if not found.found[0]:
        raise MatchingError(
            f"no unique match of the first point within {reach_px:g} pixels of the second one: "
            "pick nearer, or keep the points as they are"
        )
    place = found.points[0]
    return PickedPlace(
        (float(place[0]), float(place[1])), float(found.sigma_px[0]), float(found.correlation[0])
    )


def _reach_cells(
    maps: Float64[np.ndarray, "1 3 3"], point: Float64[np.ndarray, " 2"], reach_px: float
) -> int:
    """A reach in pixels of the second image, in cells of the common grid."""
    grid = common_grids(point[None], maps)
    _, derivative = map_points(maps @ grid, np.zeros((1, 2)))
    width = np.linalg.norm(derivative[0], axis=0).max()
    return max(LEAST_REACH, int(np.ceil(reach_px / width))) if np.isfinite(width) else LEAST_REACH


def _map(
    first: PickedView, second: PickedView, point: Float64[np.ndarray, " 2"]
) -> Float64[np.ndarray, "1 3 3"]:
    planes = parallax_planes(first.parallax, point[None], PICK.half_px)
    if not (planes.found[0] and planes.parallax_px[0] > 0):
        raise MatchingError(
            "the ground around the first point was not matched, so its patch cannot be "
            "transformed to the other stop; pick a point on matched ground"
        )
    between = second.lsl_from_pair.inverse @ first.lsl_from_pair
    return plane_homographies(first.geometry, second.geometry, between, point[None], planes)
