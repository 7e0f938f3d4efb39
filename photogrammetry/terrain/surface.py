"""Slope, aspect, northerly tilt and hillshade of a terrain model.

They follow from the planes fitted around every cell over a baseline (`terrain.planes`). With the
gradient (g_e, g_n) the normal in the LSL (north u, east v, down w; pointing up, so w < 0) is
unit(-g_n, -g_e, -1), and as in VICAR's `marsslope`

    slope = 90 deg + atan(w / sqrt(u^2 + v^2)),   aspect = atan2(v, u),   northerly tilt = asin(u)

The aspect is the azimuth in which the ground falls, clockwise from north. Hillshade is the cosine
of the sun's incidence, as for a Lambert surface, with no cast shadow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float32, Raster
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.planes import Gradients, gradients

Normals = Float32[np.ndarray, "3 rows cols"]
"""Unit normals (north, east, down) in the LSL, pointing up; NaN where none could be fitted."""


@dataclass(frozen=True, slots=True)
class SlopeParams:
    """How to map slope, aspect, northerly tilt and roughness."""

    baseline_m: float = 1.1
    """Length over which slope is felt: about a wheel base, so that pebbles do not count."""
    min_share: float = 0.5
    """Least share of the window that must have an elevation: at a straight edge, half has."""
    correlation_px: float = 9.0
    """Side of the window that refines dense parallax: points this close share their error. Seen
    from afar few points lie in a cell, so that the window covers many cells."""
    correlation_m: float = 0.15
    """Least length over which neighbouring cells share their error, however close: what is left of
    lens, light and matching is smooth over some decimetres."""
    cell_m: float = 0.08
    """Least side of a cell on the map: what is felt over a baseline of 1.1 m hardly changes over
    less. Every cell of the terrain model has its plane; a map's cell is the mean of some."""
    most_cells: int = 20_000_000
    """Cells at most, 1 GB: of larger areas the cells are doubled. A stop has 1 million."""


@dataclass(frozen=True, slots=True)
class HillshadeParams:
    """How to shade relief."""

    sun_azimuth_deg: float = 315.0
    """Clockwise from north. North-west, as on printed maps: lit from below, relief inverts."""
    sun_elevation_deg: float = 45.0
    """Above the horizon: flat ground is middle grey."""
    exaggeration: float = 1.0
    """Factor on heights."""
    baseline_cells: int = 3
    """Side of the window in cells: the smallest that fits a plane, so that edges stay crisp."""


def normals_of(gradient: Gradients) -> Normals:
    """Unit normals of surfaces with these gradients."""
    down = -1.0 / np.sqrt(1.0 + gradient[0] ** 2 + gradient[1] ** 2)
    return np.stack([gradient[1] * down, gradient[0] * down, down]).astype(np.float32)


def normals(dtm: Dtm, params: SlopeParams) -> Normals:
    """Normals of a terrain model over the baseline."""
    return normals_of(
        gradients(dtm.elevation, dtm.grid.cell_m, params.baseline_m, params.min_share)
    )


def slope(dtm: Dtm, params: SlopeParams) -> Raster:
    """Slope in degrees from the horizontal."""
    return slope_of(normals(dtm, params))


def aspect(dtm: Dtm, params: SlopeParams) -> Raster:
    """Azimuth in which the ground falls, degrees clockwise from north; NaN where level."""
    return aspect_of(normals(dtm, params))


def northerly_tilt(dtm: Dtm, params: SlopeParams) -> Raster:
    """Tilt towards north in degrees, positive where the ground faces north."""
    return northerly_tilt_of(normals(dtm, params))


def slope_of(normal: Normals) -> Raster:
    """Slope in degrees of surfaces with these normals."""
    u, v, w = normal
    return np.degrees(np.arctan2(np.hypot(u, v), -w))


def aspect_of(normal: Normals) -> Raster:
    """Aspect in degrees of surfaces with these normals; NaN where level."""
    u, v, _ = normal
    azimuth = np.mod(np.degrees(np.arctan2(v, u)), np.float32(360.0))
    azimuth[azimuth >= 360.0] = 0.0  # noqa: PLR2004 - a full circle, reached by rounding
    azimuth[np.hypot(u, v) < 1e-6] = np.nan  # noqa: PLR2004 - single precision of a unit vector
    return azimuth


def northerly_tilt_of(normal: Normals) -> Raster:
    """Tilt towards north in degrees of surfaces with these normals."""
    return np.degrees(np.arcsin(np.clip(normal[0], -1, 1)))


def hillshade(dtm: Dtm, params: HillshadeParams) -> Raster:
    """Brightness, 0 to 1, of the ground lit by a sun as given; 0 on slopes turned away."""
    baseline_m = params.baseline_cells * dtm.grid.cell_m
    gradient = gradients(dtm.elevation, dtm.grid.cell_m, baseline_m) * params.exaggeration
    azimuth, elevation = np.radians([params.sun_azimuth_deg, params.sun_elevation_deg])
    sun = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            -np.sin(elevation),
        ]
    )
    return np.clip(np.einsum("i,ijk->jk", sun, normals_of(gradient)), 0.0, 1.0).astype(np.float32)
