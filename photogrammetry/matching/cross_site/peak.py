"""Pose of the later stop by a clear peak of the bird's-eye search alone.

Rovers 25 to 40 m apart share ground that both see at a few degrees, from opposite sides: too few
facets face both cameras for a registration of surfaces, and few patches look alike. Elevations of
the ground in between, averaged over cells, still correlate far above chance. A peak that cannot be
random (`links.LinkTestParams.clear_z`) then determines azimuth, position and height to decimetres,
where telemetry would leave metres. Tilt it does not determine.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import Float64, ObjectPoints
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.birds_eye import BirdsEyeView, PlaneFit, place_on
from solmap.photogrammetry.matching.cross_site.ground_grid import blocks_of

SHIFT_M, DOWN_M, AZIMUTH = 0.07, 0.05, 0.0052
"""Standard deviations of the position of the common ground, horizontally along each axis and in
height (metres), and of azimuth (radians), under the same sun. The peaks of 23 links at 22 to 44 m,
16 of them simulated, had RMS errors of 0.04 m along the way, 0.06 m across, 0.03 m and 0.003."""

OPPOSITE_SUNS_M = 0.15
"""What suns in opposite directions add to the first, as squares: the peaks of twelve links of four
path-traced worlds, most under opposite suns, had 0.165 m, 0.097 m, 0.026 m and 0.0053."""

UNKNOWN_TILT = 0.05
"""Standard deviation of each tilt (radians), several times that by gravity, so that the latter
determines it."""


def common_ground(
    earlier: BirdsEyeView, later: BirdsEyeView, fit: PlaneFit, block_m: float
) -> ObjectPoints:
    """Points of ground that both views show under a fit, one in each block that has any.

    Args:
        earlier: View of the earlier stop.
        later: View of the later stop, with cells and extent of the same size.
        fit: Position of the later view on the earlier one.
        block_m: Side of a block, metres.

    Returns:
        (n, 3), in the level frame of the earlier stop, metres.
    """
    there = place_on(later.elevation, later.cell_m, fit.azimuth, fit.north_m, fit.east_m)
    row, col = np.nonzero(np.isfinite(earlier.elevation + there))
    half = earlier.elevation.shape[0] / 2 - 0.5
    north, east = (half - row) * earlier.cell_m, (col - half) * earlier.cell_m
    places = np.column_stack([north, east, -earlier.elevation[row, col].astype(np.float64)])
    return places[np.unique(blocks_of(places, block_m), return_index=True)[1]]


def peak_covariance(
    pose: Pose, places: ObjectPoints, sun_difference: float
) -> Float64[np.ndarray, "6 6"]:
    """Covariance of a pose by a peak: errors are independent about the middle of the ground.

    Args:
        pose: Later level frame to earlier one.
        places: (n, 3), common ground in the earlier level frame, metres.
        sun_difference: 0 under the same sun to 1 under opposite ones (`light.sun_difference`).

    Returns:
        Of rotation vector (radians), then translation (metres), in the earlier level frame.
    """
    arm = places.mean(axis=0) - pose.translation_m
    shift_m = float(np.hypot(SHIFT_M, OPPOSITE_SUNS_M * sun_difference))
    at_middle = (UNKNOWN_TILT, UNKNOWN_TILT, AZIMUTH, shift_m, shift_m, DOWN_M)
    to_rover = np.eye(6)
    to_rover[3:, :3] = np.cross(arm, np.eye(3)).T
    return to_rover @ np.diag(np.square(at_middle)) @ to_rover.T
