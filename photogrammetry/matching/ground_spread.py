"""What an error of a match along the ground does to a measurement.

A patch that is found beside its true place is found on the ground there: its image moves along the
surface, and its parallax is that of the ground where it was found. With the standard deviation s of
a cell and the derivative P of the image by cells (columns: the axes of the patch), displacements of
one standard deviation are the columns of S = s P, and with g the slope of parallax over the image,
as the surface around has it,

    s_x^2 = |S_x|^2 + (f r/Z)^2      s_y^2 = |S_y|^2 + (f r/Z)^2      s_p'^2 = s_p^2 + |g' S|^2

where r is by how much ground lies above or below the surface on which the patch was compared, and
with it what stops on different sides see of it: no patch is found better than that. Seen
at a grazing angle ground moves far more across an image than up: at 17 m a shift of 10 cm is 20
pixels of a Pancam to the side, 2 pixels up. Held for equal, heights counted a tenth of what they
are worth, ranges ten times as much, and links between stops were off by more than they stated.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.arrays import Float64, ImagePoints, PerPoint
from solmap.photogrammetry.matching.conjugates import TieView
from solmap.photogrammetry.matching.parallax_planes import parallax_planes

RELIEF_M = 0.015
"""r: what soil and pebbles rise above the mean of a patch; against truth 1 to 2 cm."""
HALF_PX = 10
"""Half the window of the surface around."""


def spread_on_the_ground(
    view: TieView,
    points: ImagePoints,
    parallax_px: PerPoint,
    sigma_parallax_px: PerPoint,
    spread: Float64[np.ndarray, "n 2 2"],
) -> tuple[PerPoint, PerPoint, PerPoint]:
    """Standard deviations of (sample, line, parallax) of points found on the ground, pixels.

    `spread` is S, `sigma_parallax_px` that of the parallax measured where the point was found.
    """
    slope = np.nan_to_num(parallax_planes(view.pair.parallax, points, HALF_PX).gradient)
    along = (slope[:, None] @ spread)[:, 0]
    relief = RELIEF_M * parallax_px / view.geometry.base_m
    sample, line = (np.hypot(np.linalg.norm(spread[:, k], axis=1), relief) for k in (0, 1))
    return sample, line, np.hypot(sigma_parallax_px, np.linalg.norm(along, axis=1))
