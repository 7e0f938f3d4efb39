"""Horizons: elevation angle of the visible skyline, in every direction, from every cell.

Along a line of cells, the horizon of a cell is the next corner of the upper convex hull of the
cells ahead: of two corners, the nearer one is either hidden by the line from the cell to the
farther one or is the horizon (Dozier, Bruno and Downey 1981, A faster solution to the horizon
problem, Computers & Geosciences 7). Every cell enters and leaves the hull once, so a line of n
cells takes O(n) steps and not O(n^2).

For an azimuth within 45 degrees of north the lines are columns of the raster sheared row by row; in
a row sheared by i + f columns each cell contributes to two lines, with the weights 1 - f and f, and
its horizon is interpolated from both with the same weights. Other azimuths are reduced to this case
by quarter turns.

Unknown ground, and ground beyond the model, is assumed to be below the horizon: the result is a
lower limit. It is never below level.
"""

from __future__ import annotations

import math

import numpy as np

from solmap.photogrammetry.arrays import Float32, Raster
from solmap.photogrammetry.terrain.kernels import rise_along_lines

Horizons = Float32[np.ndarray, "azimuths rows cols"]
"""Tangent of the horizon's elevation, in equal steps of azimuth from north over east; NaN where the
ground is unknown."""
AZIMUTHS = 36
"""Number of directions: the sun moves by ten degrees of azimuth in 40 minutes; values between are
interpolated.
"""


def horizons(elevation: Raster, cell_m: float, azimuths: int = AZIMUTHS) -> Horizons:
    """Tangents of the horizon's elevation from every cell, in `azimuths` directions."""
    found = np.empty((azimuths, *elevation.shape), np.float32)
    turns = 2 * math.pi * np.arange(azimuths) / azimuths
    quarter = np.rint(turns / (math.pi / 2)).astype(int)
    known = np.isfinite(elevation)
    level = elevation[known].mean() if known.any() else np.float32(0)
    for turned in range(4):
        lying = np.flatnonzero(quarter % 4 == turned)
        facing = np.ascontiguousarray(np.rot90(elevation - level, turned))
        for azimuth in lying:
            leaning = turns[azimuth] - quarter[azimuth] * (math.pi / 2)
            found[azimuth] = np.rot90(_towards_the_top(facing, leaning, cell_m), -turned)
    np.maximum(found, np.float32(0), out=found)
    found[:, ~known] = np.nan
    return found


def _towards_the_top(elevation: Raster, leaning: float, cell_m: float) -> Raster:
    """Tangents towards an azimuth (radians) within 45 degrees of the top row's direction."""
    shift = np.arange(len(elevation)) * math.tan(leaning)
    shift -= shift.min()
    whole = np.floor(shift)
    share = (shift - whole).astype(np.float32)
    step_m = np.float32(cell_m / math.cos(leaning))
    return rise_along_lines(elevation, whole.astype(np.int64), share) / step_m
