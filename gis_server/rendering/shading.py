"""What is drawn of a terrain model's cells: shades, slopes and directions.

All follow from the gradient of the plane fitted to the elevations around a cell, as those of the
layers that are made once (`terrain.surface`). A cell is a pixel of the tile: seen from afar the
ground is felt over a longer way, so that a hillshade is as crisp, and as right, at every zoom.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from solmap.gis_server.rendering.looks import Look, UnknownLookError
from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.planes import Gradients, nine_cell_gradients, window_gradients

_WIDEST = 128
"""Cells that a window may reach to either side: half a tile."""
_LEVEL = np.float32(1e-6)
"""Gradient below which ground has no aspect: single precision."""


def margin_of(look: Look, cell_m: float) -> int:
    """Cells that a window reaches to either side.

    Raises:
        UnknownLookError: it is too wide for a tile.
    """
    if look.baseline_m is None:
        return 1
    half = max(1, round((look.baseline_m / cell_m - 1) / 2))
    if half > _WIDEST:
        raise UnknownLookError(
            f"a baseline of {look.baseline_m:g} m is {2 * half + 1} cells of {cell_m:g} m; ask for "
            f"one below {2 * _WIDEST * cell_m:g} m or for a tile of a lower zoom"
        )
    return half


def gradient_of(elevation: Raster, cell_m: float, half: int) -> Gradients:
    """Rise per metre towards east and north; the outer `half` cells are without meaning."""
    if half == 1:
        return nine_cell_gradients(elevation, cell_m)
    return window_gradients(elevation, cell_m, (2 * half + 1) * cell_m)


def hillshade(gradient: Gradients, look: Look) -> Raster:
    """Cosine of the sun's incidence, 0 to 1: 0 where the ground turns away from the sun."""
    azimuth, elevation = math.radians(look.azimuth_deg), math.radians(look.elevation_deg)
    g_e, g_n = gradient * np.float32(look.exaggeration)
    across = np.float32(math.cos(elevation) * math.sin(azimuth))
    along = np.float32(math.cos(elevation) * math.cos(azimuth))
    light = np.float32(math.sin(elevation)) - across * g_e - along * g_n
    light /= np.sqrt(np.float32(1.0) + g_e * g_e + g_n * g_n)
    return np.clip(light, 0.0, 1.0)


def slope(gradient: Gradients, _look: Look) -> Raster:
    """Degrees from the horizontal."""
    return np.degrees(np.arctan(np.hypot(*gradient)))


def aspect(gradient: Gradients, _look: Look) -> Raster:
    """Azimuth in which the ground falls, degrees clockwise from north; NaN where level."""
    g_e, g_n = gradient
    azimuth = np.degrees(np.arctan2(-g_e, -g_n))
    azimuth[azimuth < 0] += np.float32(360.0)
    azimuth[(np.abs(g_e) < _LEVEL) & (np.abs(g_n) < _LEVEL)] = np.nan
    return azimuth


def northerly_tilt(gradient: Gradients, _look: Look) -> Raster:
    """Tilt towards north in degrees, positive where the ground faces north."""
    g_e, g_n = gradient
    return np.degrees(np.arctan(-g_n / np.sqrt(np.float32(1.0) + g_e * g_e)))


def north_facing(tilt: Raster, look: Look) -> Raster:
    """Tilt towards north where it reaches the threshold, NaN elsewhere."""
    return np.where(tilt >= np.float32(look.threshold_deg), tilt, np.float32(np.nan))


OF_TERRAIN: dict[str, Callable[[Gradients, Look], Raster]] = {
    "hillshade": hillshade,
    "slope": slope,
    "aspect": aspect,
    "northerly-tilt": northerly_tilt,
    "north-facing": lambda gradient, look: north_facing(northerly_tilt(gradient, look), look),
}
"""What follows from the gradient, by the name of the style."""
