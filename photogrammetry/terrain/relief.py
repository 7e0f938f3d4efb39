"""Relief of a terrain model over a baseline: normals, how certain slope is, and roughness.

All follow from the planes fitted around every cell (`terrain.planes`). Slope is uncertain by

    sigma^2 = d' (k v C^-1) d / (1 + g^2)^2        d = g / |g|, the direction of the slope

which on level ground is the deviation of its gradient; v is the variance of the cells without what
their poses share, and k the number of cells below one matching window. Roughness is the standard
deviation of the elevations from the plane: a terrain model's own noise is in it. VICAR's
`marsrough` gives the largest deviation in a ring of 4 cm instead, for an arm's tool.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.resampling import (
    coarse_grid,
    manageable_cell_m,
    place_means,
)
from solmap.photogrammetry.terrain.planes import fit_planes, window_cells, window_mean
from solmap.photogrammetry.terrain.surface import Normals, SlopeParams, normals_of

STRIP = 512
"""Rows that are worked on together: 70 MB of a stop's width."""
LEAST_STEEPNESS = 1e-6
"""Gradient below which ground has no direction in which it falls: single precision."""


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """What planes fitted over one baseline say of every cell."""

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
    """Normals of a terrain model over the baseline, how certain they are, and roughness."""
    cell_m = dtm.grid.cell_m
    fit = fit_planes(dtm.elevation, cell_m, params.baseline_m, params.min_share)
    pose = np.float32(0) if dtm.pose_sigma_m is None else dtm.pose_sigma_m
    own = np.maximum(dtm.sigma_m**2 - pose**2, 0)  # a tilted pose tilts all slopes, by 0.1 degrees
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
    """Number k of neighbouring cells that share one error: those below a window of matched points.

    At most a quarter of the plane's window: a tilt that all of it shares would be no error of slope
    but of pose.
    """
    cell_m = dtm.grid.cell_m
    points = window_mean(dtm.observations, cell_m, params.baseline_m)
    least = max(1.0, (params.correlation_m / cell_m) ** 2)
    most = max(least, (params.baseline_m / cell_m) ** 2 / 4)
    with np.errstate(divide="ignore"):
        return np.clip(np.float32(params.correlation_px**2) / points, least, most)


def mapped_relief(dtm: Dtm, params: SlopeParams) -> tuple[Relief, MapGrid]:
    """The same as means over cells of at least `params.cell_m`, and their grid.

    Strips of the model are worked on one after the other, so that a region takes no more memory
    than its map.
    """
    cell_m = max(dtm.grid.cell_m, params.cell_m)
    cell_m = manageable_cell_m(dtm.elevation, dtm.grid, cell_m, params.most_cells)
    place = coarse_grid(dtm.grid, cell_m)
    layers = np.full((5, *place.shape), np.nan, np.float32)
    margin = window_cells(dtm.grid, params.baseline_m)
    for top in range(0, dtm.grid.rows, STRIP):
        rows = min(STRIP, dtm.grid.rows - top)
        above = min(top, margin)
        around = _strip(dtm, top - above, rows + above + margin)
        own = (slice(above, above + rows), slice(None))
        fine = relief(around, params)
        for whole, part in zip(layers, fine.layers, strict=True):
            place_means(whole, place, part[own], dtm.grid.part(top, 0, rows, dtm.grid.cols))
    north, east, down, sigma, rough = layers
    length = np.sqrt(north**2 + east**2 + down**2)
    return Relief(np.stack([north, east, down]) / length, sigma, rough), place


def _strip(dtm: Dtm, top: int, rows: int) -> Dtm:
    """Some rows of a terrain model, fewer at its lower edge."""
    rows = min(rows, dtm.grid.rows - top)
    own = slice(top, top + rows)
    pose = None if dtm.pose_sigma_m is None else dtm.pose_sigma_m[own]
    return Dtm(
        dtm.grid.part(top, 0, rows, dtm.grid.cols),
        dtm.elevation[own],
        dtm.sigma_m[own],
        dtm.observations[own],
        dtm.ground[own],
        pose,
    )
