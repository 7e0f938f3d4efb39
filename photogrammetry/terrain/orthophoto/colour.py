"""Colour from images through several filters of one camera that did not move in between.

Pancam's left eye has, by number and middle of the band in nanometres, L2 753, L3 673, L4 601,
L5 535, L6 482 and L7 432 (Bell et al. 2003, table 1; L1 is empty). Red, green and blue are taken
from those nearest to what screens show, 601, 535 and 482 nm; where one is missing its neighbour
outwards stands in, which is false colour. Green has no neighbour that is not red or blue itself.

Frames of one pointing have the same mast angles in their labels, so their cameras see the same
ground to a small part of a pixel, whatever the true pointing was. What was adjusted for the stereo
pair then holds for all of them.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from solmap.photogrammetry.imagery import RoverImage

RED, GREEN, BLUE = (4, 3, 2), (5,), (6, 7)
"""Filters of Pancam's left eye in the order in which they are wanted."""
SAME_POINTING = 5e-5
"""Radians: a fifth of a pixel of Pancam, and far below one step of the mast's motors."""
SAME_PLACE_M = 1e-3

Triple = tuple[int, int, int]
"""Filters for red, green and blue."""


def colour_filters(filters: Collection[int]) -> Triple | None:
    """The filters to show as red, green and blue; None where there are not enough."""
    found = [next((f for f in wanted if f in filters), None) for wanted in (RED, GREEN, BLUE)]
    red, green, blue = found
    return None if red is None or green is None or blue is None else (red, green, blue)


def has_same_view(image: RoverImage, other: RoverImage) -> bool:
    """Whether two images of one eye were taken from one place in one direction.

    Their frames may differ in size: what is asked is where their cameras stand and look.
    """
    if (image.stop, image.instrument, image.eye) != (other.stop, other.instrument, other.eye):
        return False
    middle = np.array([[(image.samples - 1) / 2, (image.lines - 1) / 2]])
    ray = image.camera.rays(middle)[0]
    turned = float(np.linalg.norm(np.cross(ray, other.camera.rays(middle)[0])))
    apart_m = float(np.linalg.norm(image.camera.centre - other.camera.centre))
    return turned < SAME_POINTING and apart_m < SAME_PLACE_M
