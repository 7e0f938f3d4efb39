"""Colour from images through several filters of one camera in the same pose.

Pancam's left eye has, by number and middle of the band in nanometres, L2 753, L3 673, L4 601, L5
535, L6 482 and L7 432 (Bell et al. 2003, table 1; L1 is empty). Red, green and blue are the filters
nearest to the primaries of screens, 601, 535 and 482 nm; a missing one is replaced by its outer
neighbour, which gives false colour. Green has no neighbour other than red and blue.

Frames of one pointing have the same mast angles in their labels, so their views agree to a small
part of a pixel, even if the true pointing differs from the label. The adjusted pointing of the
stereo pair therefore applies to all of them.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from solmap.photogrammetry.imagery import RoverImage

RED, GREEN, BLUE = (4, 3, 2), (5,), (6, 7)
"""Filters of Pancam's left camera in order of preference."""
SAME_POINTING = 5e-5
"""Radians: a fifth of a pixel of Pancam, and far below one step of the mast's motors."""
SAME_PLACE_M = 1e-3

Triple = tuple[int, int, int]
"""Filters for red, green and blue."""


def colour_filters(filters: Collection[int]) -> Triple | None:
    """The filters used as red, green and blue; None where there are too few."""
    found = [
        next((f for f in candidates if f in filters), None) for candidates in (RED, GREEN, BLUE)
    ]
    red, green, blue = found
    return None if red is None or green is None or blue is None else (red, green, blue)


def has_same_view(image: RoverImage, other: RoverImage) -> bool:
    """Whether two images of one eye have the same position and direction.

    Their frames may differ in size: only the poses of the cameras are compared.
    """
    if (image.stop, image.instrument, image.eye) != (other.stop, other.instrument, other.eye):
        return False
    middle = np.array([[(image.samples - 1) / 2, (image.lines - 1) / 2]])
    ray = image.camera.rays(middle)[0]
    turned = float(np.linalg.norm(np.cross(ray, other.camera.rays(middle)[0])))
    apart_m = float(np.linalg.norm(image.camera.centre - other.camera.centre))
    return turned < SAME_POINTING and apart_m < SAME_PLACE_M
