"""Slope, aspect, northerly tilt and hillshade of a terrain model, from planes fitted to its cells.

Around every cell a plane h = a + g_e e + g_n n is fitted by least squares to the cells with an
elevation inside a square window, whose side is the baseline over which slope is felt. With the
weights m = 1 where there is an elevation, and e, n counted from the middle of the window, all
sums are convolutions of m, m h and their moments, and the normal equations

    | S_1  S_e  S_n  | | a   |   | S_h  |
    | S_e  S_ee S_en | | g_e | = | S_eh |
    | S_n  S_en S_nn | | g_n |   | S_nh |

are solved in every cell at once: exact on tilted planes, whatever cells are missing. The normal in
the LSL (north u, east v, down w; pointing up, so w < 0) is unit(-g_n, -g_e, -1), and as in VICAR's
`marsslope`

    slope = 90 deg + atan(w / sqrt(u^2 + v^2)),   aspect = atan2(v, u),   northerly tilt = asin(u)

The aspect is the azimuth in which the ground falls, clockwise from north. Hillshade is the cosine
of the sun's incidence, as for a Lambert surface, with no cast shadow.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from photogrammetry.arrays import Float32, Raster
from photogrammetry.errors import TerrainError
from photogrammetry.terrain.records import Dtm

Normals = Float32[np.ndarray, "3 rows cols"]
"""Unit normals (north, east, down) in the LSL, pointing up; NaN where none could be fitted."""
Gradients = Float32[np.ndarray, "2 rows cols"]
"""Rise per metre towards east and towards north; NaN where no plane could be fitted."""

LEAST_SPREAD = 0.02
"""Second moment of the cells used, along their thinnest direction, over that of a full window. A
strip of cells a seventh as wide as the window is the least that holds a plane."""


@dataclass(frozen=True, slots=True)
class SlopeParams:
    """How to map slope, aspect and northerly tilt."""

    baseline_m: float = 1.1
    """Length over which slope is felt: about a wheel base, so that pebbles do not count."""
    min_share: float = 0.5
    """Least share of the window that must have an elevation: at a straight edge, half has."""


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


def gradients(
    elevation: Raster, cell_m: float, baseline_m: float, min_share: float = 0.5
) -> Gradients:
    """Gradient of the plane through the cells of a window of side `baseline_m` around each cell."""
    half = max(1, round((baseline_m / cell_m - 1) / 2))
    if 2 * half + 1 > min(elevation.shape) * 2:
        raise TerrainError(
            f"a baseline of {baseline_m} m is {2 * half + 1} cells of {cell_m} m, but the terrain "
            f"model has only {elevation.shape}: take a shorter baseline"
        )
    known = np.isfinite(elevation)
    level = float(np.mean(elevation[known], dtype=np.float64)) if known.any() else 0.0
    m = known.astype(np.float32)
    h = np.where(known, elevation - np.float32(level), np.float32(0))
    S_1, S_e, S_n = (_moment(m, half, powers) for powers in ((0, 0), (1, 0), (0, 1)))
    S_ee, S_en, S_nn = (_moment(m, half, powers) for powers in ((2, 0), (1, 1), (0, 2)))
    S_h, S_eh, S_nh = (_moment(h, half, powers) for powers in ((0, 0), (1, 0), (0, 1)))
    with np.errstate(invalid="ignore", divide="ignore"):
        C_ee, C_en, C_nn = S_ee - S_e**2 / S_1, S_en - S_e * S_n / S_1, S_nn - S_n**2 / S_1
        C_eh, C_nh = S_eh - S_e * S_h / S_1, S_nh - S_n * S_h / S_1
        determinant = C_ee * C_nn - C_en**2
        g = np.stack([C_nn * C_eh - C_en * C_nh, C_ee * C_nh - C_en * C_eh]) / determinant
        thinnest = (C_ee + C_nn) / 2 - np.sqrt((C_ee - C_nn) ** 2 / 4 + C_en**2)
    window = 2 * half + 1
    full = window * window * (window * window - 1) / 12
    enough = S_1 / window**2 >= min_share
    fits = known & enough & (thinnest > LEAST_SPREAD * full)
    g[:, ~fits] = np.nan
    return g / np.float32(cell_m)


def _moment(values: Raster, half: int, powers: tuple[int, int]) -> Raster:
    """Sum of values times e^a n^b over the window around every cell, in cells; north is up."""
    steps = np.arange(-half, half + 1, dtype=np.float32)
    return cv2.sepFilter2D(
        values,
        cv2.CV_32F,
        steps ** powers[0],
        (-steps) ** powers[1],
        borderType=cv2.BORDER_CONSTANT,
    )


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
