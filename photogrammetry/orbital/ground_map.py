"""The map of several stops, and its prediction of the ground's brightness from orbit.

Under a sun in direction s, matt ground of normal n and albedo a has the brightness a (n . s). For
gentle slopes that is linear in the slopes: a (s_z - s_e dz/de - s_n dz/dn). Neither the sun nor the
contrast of the orbital camera need to be known if its brightness is fitted, at every position, as a
linear combination of the slopes and of the rover's brightness:

    orbital = b0 + b1 dz/de + b2 dz/dn + b3 (rover's brightness) + b4 (height above surroundings)

The last represents rocks and hollows, whose shadows no linear term of the slope predicts. All
quantities are compared after subtracting the mean of the surroundings, so that haze, shading by
large slopes and changes of albedo over tens of metres have no effect.

Of several stops the map is the mean of theirs; brightness is relative to its surroundings at every
stop.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float64, Mask, Raster
from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.orbital.records import GroundMap, OrbitalImage
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

SURROUNDINGS_M = 6.0
"""Standard deviation of the Gaussian whose mean is subtracted: the size of some rocks and
ripples."""
MIXING = 0.5
"""Standard deviation, in cells, of the blur of an orbital detector."""
LEAST_SEEN = 0.3
"""Fraction of the surroundings that must be visible for their mean."""

Stack = Float64[np.ndarray, "predictors rows cols"]


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """Predictors of what is visible from orbit."""

    grid: MapGrid
    stack: Stack
    """Zero where unknown."""
    known: Mask

    def within(self, part: Mask) -> Predicted:
        """Only what lies in a part of the grid."""
        return Predicted(self.grid, self.stack, self.known & part)


@dataclass(frozen=True, slots=True, eq=False)
class Contrast:
    """Contrast of the orbital image: brightness minus that of its surroundings."""

    grid: MapGrid
    values: Raster
    """Zero where unknown."""
    known: Mask


def predictors(ground: GroundMap) -> Predicted:
    """Predictors of the orbital image from a rover's map."""
    cell_m = ground.grid.cell_m
    surroundings = SURROUNDINGS_M / cell_m
    elevation, brightness = (
        raster.astype(np.float64) for raster in (ground.elevation, ground.brightness)
    )
    d_south, d_east = np.gradient(smooth(elevation, MIXING), cell_m)
    layers = [
        _local(layer, surroundings)
        for layer in (d_east, -d_south, smooth(brightness, MIXING), elevation)
    ]
    known = np.asarray(np.isfinite(layers).all(axis=0))
    return Predicted(ground.grid, np.where(known, np.stack(layers), 0.0), known)


def local_contrast(image: OrbitalImage) -> Contrast:
    """The orbital brightness minus that of its surroundings."""
    contrast = _local(image.brightness.astype(np.float64), SURROUNDINGS_M / image.grid.cell_m)
    known = np.isfinite(contrast)
    return Contrast(image.grid, np.where(known, contrast, 0.0).astype(np.float32), known)


def _local(raster: np.ndarray, sigma_cells: float) -> np.ndarray:
    return raster - smooth(raster, sigma_cells, LEAST_SEEN)


def smooth(raster: np.ndarray, sigma_cells: float, least: float = 0.0) -> np.ndarray:
    """Gaussian mean of known values; NaN where they have less than `least` of the weight."""
    known = np.isfinite(raster)
    weight = cv2.GaussianBlur(known.astype(np.float64), (0, 0), sigma_cells)
    total = cv2.GaussianBlur(np.where(known, raster, 0.0), (0, 0), sigma_cells)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known & (weight > least), total / weight, np.nan)


def ground_map(
    grid: MapGrid, elevations: Iterable[Raster], brightnesses: Iterable[Raster]
) -> GroundMap:
    """The mean of what stops mapped; brightness is relative to its surroundings at every stop.

    Args:
        grid: Cells as large as the orbital image's.
        elevations: Of every stop on that grid, metres; NaN where it saw nothing.
        brightnesses: Of every stop on that grid, of any unit.

    Raises:
        OrbitalError: there is no stop.
    """
    sigma_cells = SURROUNDINGS_M / grid.cell_m
    relative = (image / smooth(image, sigma_cells) for image in brightnesses)
    return GroundMap(grid, _mean(elevations), _mean(relative))


def _mean(rasters: Iterable[Raster]) -> Raster:
    total: np.ndarray | None = None
    for raster in rasters:
        seen = np.isfinite(raster)
        if total is None:
            total, count = np.zeros(raster.shape), np.zeros(raster.shape)
        total += np.where(seen, raster, 0.0)
        count += seen
    if total is None:
        raise OrbitalError("no stop is mapped: there is no ground to register an orbital image to")
    with np.errstate(invalid="ignore", divide="ignore"):
        return (total / count).astype(np.float32)
