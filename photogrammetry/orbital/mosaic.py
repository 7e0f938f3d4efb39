"""One map of the ground out of those of several stops, as registration needs it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.orbital.predictors import SURROUNDINGS_M, smoothed
from solmap.photogrammetry.orbital.records import GroundMap
from solmap.photogrammetry.terrain.dtm.grid import MapGrid


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
    relative = (image / smoothed(image, sigma_cells) for image in brightnesses)
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
        raise OrbitalError("no stop is mapped: there is no ground to find in an orbital image")
    with np.errstate(invalid="ignore", divide="ignore"):
        return (total / count).astype(np.float32)
