"""Slope, aspect, northerly tilt, roughness and hillshade of a terrain model.

They follow from the planes fitted around every cell over a baseline (`planes.fit_window_planes`).
With the gradient (g_e, g_n) the normal in the LSL (north u, east v, down w; pointing up, so w < 0)
is unit(-g_n, -g_e, -1), and as in VICAR's `marsslope`

    slope = 90 deg + atan(w / sqrt(u^2 + v^2)),   aspect = atan2(v, u),   northerly tilt = asin(u)

The aspect is the azimuth of the steepest descent, clockwise from north. Hillshade is the cosine of
the sun's incidence, as for a Lambert surface, without cast shadows.

The standard deviation of slope is

    sigma^2 = d' (k v C^-1) d / (1 + g^2)^2        d = g / |g|, the direction of the slope

which on level ground is that of the gradient; v is the variance of the cells without the common
part of their poses, and k the number of cells in one matching window. Roughness is the standard
deviation of the elevations from the plane, including the terrain model's noise. VICAR's `marsrough`
gives the largest deviation in a ring of 4 cm instead, for an arm's tool.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float32, Raster
from solmap.photogrammetry.planes import (
    Gradients,
    fit_window_planes,
    gradient_blocks,
    half_window,
    window_mean,
)
from solmap.photogrammetry.ranges import (
    Azimuth,
    CellSize,
    Elevation,
    Factor,
    MapCells,
    Pixels,
    Share,
    ShortMetres,
)
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.parts import (
    Part,
    Terrain,
    Window,
    manageable_cell_m,
    seen_parts,
)
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.resampling import coarse_grid, coarse_means

CORRELATION_M = 0.15
"""Least correlation length of neighbouring cells, even at short range: remaining errors of lens,
light and matching are smooth over some decimetres."""
HILLSHADE_BASELINE_CELLS = 3
"""Side of the window in cells: the smallest that fits a plane, which keeps edges sharp."""
Normals = Float32[np.ndarray, "3 rows cols"]
"""Unit normals (north, east, down) in the LSL, pointing up; NaN where none could be fitted."""
LEAST_STEEPNESS = 1e-6
"""Gradient below which ground has no aspect: single precision."""


@dataclass(frozen=True, slots=True)
class SlopeParams:
    """Parameters of slope, aspect, northerly tilt and roughness."""

    baseline_m: ShortMetres = 1.1
    """Length over which slope is measured: about a wheel base, so that pebbles have no effect."""
    min_share: Share = 0.5
    """Least fraction of the window with an elevation: at a straight edge it is half."""
    correlation_px: Pixels = 9.0
    """Side of the window that refines dense parallax: points within it have a common error. At long
    range few points lie in a cell, so that the window covers many cells."""
    cell_m: CellSize = 0.08
    """Least side of a cell on the map: slope over a baseline of 1.1 m hardly changes over less.
    Every cell of the terrain model has its plane; a map's cell is the mean of some."""
    most_cells: MapCells = 20_000_000
    """Most cells, 1 GB: for larger areas the cells are doubled. A stop has 1 million."""


@dataclass(frozen=True, slots=True)
class HillshadeParams:
    """Parameters of shaded relief."""

    sun_azimuth_deg: Azimuth = 315.0
    """Clockwise from north. North-west, as on printed maps: lit from below, relief appears
    inverted."""
    sun_elevation_deg: Elevation = 45.0
    """Above the horizon: flat ground is middle grey."""
    exaggeration: Factor = 1.0
    """Factor on heights."""


def normals_of(gradient: Gradients) -> Normals:
    """Unit normals of surfaces with these gradients."""
    down = -1.0 / np.sqrt(1.0 + gradient[0] ** 2 + gradient[1] ** 2)
    return np.stack([gradient[1] * down, gradient[0] * down, down]).astype(np.float32)


def slope_of(normal: Normals) -> Raster:
    """Slope in degrees of surfaces with these normals."""
    return _of_known(normal, lambda n: np.degrees(np.arctan2(np.hypot(n[0], n[1]), -n[2])))


def aspect_of(normal: Normals) -> Raster:
    """Aspect in degrees of surfaces with these normals; NaN where level."""

    def aspect(n: np.ndarray) -> np.ndarray:
        azimuth = np.mod(np.degrees(np.arctan2(n[1], n[0])), np.float32(360.0))
        azimuth[azimuth >= 360.0] = 0.0  # noqa: PLR2004 - a full circle, reached by rounding
        level = np.hypot(n[0], n[1]) < 1e-6  # noqa: PLR2004 - single precision of a unit vector
        azimuth[level] = np.nan
        return azimuth

    return _of_known(normal, aspect)


def northerly_tilt_of(normal: Normals) -> Raster:
    """Tilt towards north in degrees of surfaces with these normals."""
    return _of_known(normal, lambda n: np.degrees(np.arcsin(np.clip(n[0], -1, 1))))


def _of_known(normal: Normals, angle: Callable[[np.ndarray], np.ndarray]) -> Raster:
    """A function of the normals that are known: few of a region are. NaN elsewhere."""
    known = np.isfinite(normal[2])
    out = np.full(known.shape, np.nan, normal.dtype)
    out[known] = angle(normal[:, known])
    return out


def hillshade_parts(terrain: Terrain, params: HillshadeParams) -> Iterator[tuple[Window, Raster]]:
    """The brightness of a terrain model part by part, and where each part lies."""
    for part in seen_parts(terrain, HILLSHADE_BASELINE_CELLS * terrain.grid.cell_m):
        light = hillshade(part.dtm.elevation, part.grid.cell_m, params)
        yield part.own, part.own_values(light)


def hillshade(elevation: Raster, cell_m: float, params: HillshadeParams) -> Raster:
    """Brightness, 0 to 1, of the ground lit by a sun as given; 0 on slopes turned away."""
    azimuth, height = np.radians([params.sun_azimuth_deg, params.sun_elevation_deg])
    sun = np.array(
        [
            np.cos(height) * np.cos(azimuth),
            np.cos(height) * np.sin(azimuth),
            -np.sin(height),
        ]
    )
    light = np.full(elevation.shape, np.nan, np.float32)
    for own, gradient in gradient_blocks(elevation, cell_m, HILLSHADE_BASELINE_CELLS * cell_m):
        normal = normals_of(gradient * params.exaggeration)
        light[own] = np.clip(np.einsum("i,ijk->jk", sun, normal), 0.0, 1.0)
    return light


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """Results of fitting planes over one baseline to every cell."""

    normal: Normals
    slope_sigma_deg: Raster
    """Standard deviation of the slope."""
    roughness_m: Raster
    """Standard deviation of the elevations from the plane."""

    @property
    def layers(self) -> tuple[Raster, ...]:
        """North, east and down of the normal, deviation of the slope, and roughness."""
        return (*self.normal, self.slope_sigma_deg, self.roughness_m)


def relief(dtm: Dtm, params: SlopeParams) -> Relief:
    """Normals of a terrain model over the baseline, their standard deviations, and roughness."""
    cell_m = dtm.grid.cell_m
    fit = fit_window_planes(dtm.elevation, cell_m, params.baseline_m, params.min_share)
    pose = np.float32(0) if dtm.pose_sigma_m is None else dtm.pose_sigma_m
    # a tilted pose tilts all slopes, by 0.1 degrees
    own = np.maximum(dtm.sigma_m**2 - pose**2, 0)
    variance = window_mean(own, cell_m, params.baseline_m)
    shared = _cells_that_share(dtm, params)
    g_e, g_n = fit.gradient
    C_ee, C_en, C_nn = fit.shape
    steepness = np.maximum(np.hypot(g_e, g_n), LEAST_STEEPNESS)
    d_e, d_n = g_e / steepness, np.where(steepness > LEAST_STEEPNESS, g_n / steepness, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        along = (C_nn * d_e**2 - 2 * C_en * d_e * d_n + C_ee * d_n**2) / (C_ee * C_nn - C_en**2)
        sigma = np.sqrt(shared * variance * along) / (1 + steepness**2)
    return Relief(normals_of(fit.gradient), np.degrees(sigma), fit.scatter)


def _cells_that_share(dtm: Dtm, params: SlopeParams) -> Raster:
    """Number k of neighbouring cells with a common error: those in a window of matched points.

    At most a quarter of the plane's window: a tilt common to all of it would be an error of the
    pose, not of the slope.
    """
    cell_m = dtm.grid.cell_m
    points = window_mean(dtm.observations, cell_m, params.baseline_m)
    least = max(1.0, (CORRELATION_M / cell_m) ** 2)
    most = max(least, (params.baseline_m / cell_m) ** 2 / 4)
    with np.errstate(divide="ignore"):
        return np.clip(np.float32(params.correlation_px**2) / points, least, most)


def relief_parts(
    terrain: Terrain, params: SlopeParams
) -> tuple[list[tuple[Window, Relief]], MapGrid]:
    """The same as means over cells of at least `params.cell_m`, part by part, and their grid."""
    grid = terrain.grid
    cell_m = max(grid.cell_m, params.cell_m)
    cell_m = manageable_cell_m(terrain, cell_m, params.most_cells)
    place = coarse_grid(grid, cell_m)
    half = half_window(grid.shape, grid.cell_m, params.baseline_m)
    return [
        _mean_relief(part, relief(part.dtm, params), place)
        for part in seen_parts(terrain, half * grid.cell_m)
    ], place


def _mean_relief(part: Part, fine: Relief, place: MapGrid) -> tuple[Window, Relief]:
    """Relief in larger cells, and where they lie."""
    means = [coarse_means(layer[part.inner], part.grid, place) for layer in fine.layers]
    (own, _), (north, east, down, sigma, rough) = means[0], (mean for _, mean in means)
    normal = np.stack([north, east, down])
    normal /= np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    return own, Relief(normal, sigma, rough)
