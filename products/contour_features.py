"""Contours as features."""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.terrain.relief.contours import Contour
from solmap.products.formats.vector.geojson import Feature


def contour_feature(contour: Contour) -> Feature:
    """A contour as a line at its elevation, metres of the local map."""
    up = np.full(len(contour.points), contour.elevation_m)
    return Feature(
        "LineString",
        np.column_stack([contour.points, up]),
        {"elevation_m": contour.elevation_m, "is_index": contour.is_index},
    )
