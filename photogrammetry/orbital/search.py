"""Position of a rover's map in an orbital image: to a cell by search, then to a fraction of it.

All positions and rotations are tested by multiple correlation. For a shift d of the orbital image
I, with the predictors r_k of the map over its n known cells,

    c_k(d) = sum r_k(x) I(x + d),       explained(d) = c(d)' S^-1 c(d) / variance of I under the map

where the r_k are centred and S = sum r r'. That is the coefficient of determination (R squared) of
a linear regression of the image on the predictors, for all shifts at once by FFT, since S does not
depend on the shift. A map rotated by theta against the image is found by rotating the image. Wide
areas are searched in larger cells, with means of the predictors and of the image.

The last fraction of a cell comes from least-squares matching. Unknown are shift, rotation and scale
of the image and the coefficients of the predictors; Gauss-Newton on the residuals of the map's
known cells. Residuals of neighbouring cells are correlated (a rock missing in the map is several
cells wide), so the covariance is not that of independent cells but the cluster-robust one: scores
are summed over squares of ground before their products. Shadows and other effects outside the
linear terms bias the position by up to a third of a cell, mostly away from the rover's sun;
`MODEL_CELLS` is added for them (`tests/support/orbital_scenes.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import fft
from scipy.linalg import cholesky, solve_triangular

from solmap.photogrammetry.arrays import Float64, Mask
from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.orbital.ground_map import Contrast, Predicted, Stack
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

FEWEST_CELLS = 400
"""Fewest cells of a map: fewer do not determine a position (10 m by 10 m at HiRISE's best)."""
ALL = 0.999
"""Weight of an interpolation with all neighbours known, minus rounding."""
LEAST_SHOWN_OF_MAP = 0.9
"""Fraction of the map's cells that the image must show at a position."""


REACH_DEG = 4.5
"""Range of rotations of the image against the map, in each direction: an uncontrolled mosaic by
three degrees, the azimuth of a stop at telemetry by somewhat more."""
NEAR_M = 12.0
"""Searched first, in the image's own cells: telemetry errors of some percent of a drive,
georeference errors of some cells."""
MOST_LAGS = 300
"""Most shifts in each direction: cells are made larger for a wider search."""
SCALE_SIGMA = 0.01
"""Standard deviation of the scale of an uncontrolled mosaic, and of a map by the error of a stereo
rig."""
STEP_DEG_PER_M, WIDEST_STEP_DEG = 1.0, 1.0
"""Step of rotations per metre of a cell: at 40 m, the radius of a stop's map, a step moves the edge
by 0.7 cells."""
CLUSTER_M = 5.0
"""Side of the squares whose residuals may be correlated: wider than any rock's shadow."""
MODEL_CELLS = 0.15
"""Standard deviation, in cells, of the bias of either coordinate by shadows, and of the map's edge
by a rotation: RMS over simulated scenes, three kinds of ground and suns of 25 to 65 degrees."""
UNKNOWNS = 4
"""Unknowns of a position: shift east and north, rotation and scale."""
ITERATIONS = 20
ROW = 1024
CONVERGED = 3e-3
"""Largest movement of the map's edge in a step, cells."""
LEAST_SHOWN = 0.5
"""Fraction of the map that the image must show."""


@dataclass(frozen=True, slots=True)
class SearchParams:
    """Possible error of the georeference."""

    reach_m: float = 300.0
    """Search distance in each direction; an uncontrolled mosaic may be hundreds of metres off."""
    around_m: tuple[float, float] = (0.0, 0.0)
    """Centre of the search: shift of the map in the image, (east, north)."""

    def near(self, around_m: tuple[float, float] | None = None) -> SearchParams:
        """A search in the image's own cells, about a shift."""
        return SearchParams(min(self.reach_m, NEAR_M), around_m or self.around_m)


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """Fit of the map at every rotation and shift."""

    explained: Float64[np.ndarray, "turns lags lags"]
    """Shifts of the map by (i - reach) rows down and (j - reach) columns right, NaN: not
    visible."""
    turns_deg: Float64[np.ndarray, " turns"]
    cell_m: float
    around_m: tuple[float, float] = (0.0, 0.0)

    @property
    def reach(self) -> int:
        """Largest shift, cells."""
        return self.explained.shape[1] // 2

    def best(self) -> tuple[float, float, float, float]:
        """(explained, east, north, rotation deg) of the map's best displacement in the image."""
        if np.isnan(self.explained).all():
            raise OrbitalError("the image does not show the ground of the map")
        turn, row, col = np.unravel_index(np.nanargmax(self.explained), self.explained.shape)
        east, north = (float(shifts[row, col]) for shifts in self._shifts(int(turn)))
        explained = float(self.explained[turn, row, col])
        return explained, east, north, float(self.turns_deg[turn])

    def runner_up(self, apart_m: float) -> float:
        """Fit of the best position at least that far from the best, at any rotation."""
        _, east, north, _ = self.best()
        best = 0.0
        for turn, explained in enumerate(self.explained):
            at_east, at_north = self._shifts(turn)
            far = np.hypot(at_east - east, at_north - north) > apart_m
            best = max(
                best, float(np.nanmax(explained, initial=0.0, where=far & ~np.isnan(explained)))
            )
        return best

    def _shifts(self, turn: int) -> tuple[np.ndarray, np.ndarray]:
        """Displacements of the map's centre in the image, at all shifts of the rotated map."""
        lags = (np.arange(2 * self.reach + 1) - self.reach) * self.cell_m
        c, s = (f(np.radians(self.turns_deg[turn])) for f in (np.cos, np.sin))
        east, north = lags[None, :], -lags[:, None]
        return (
            self.around_m[0] + c * east + s * north,
            self.around_m[1] - s * east + c * north,
        )


def search(predicted: Predicted, contrast: Contrast, params: SearchParams) -> Landscape:
    """Fit of the map for all rotations and shifts within reach.

    Raises:
        OrbitalError: the map is too small, or flat and without contrast.
    """
    grid, known = predicted.grid, predicted.known
    reach = int(np.ceil(params.reach_m / grid.cell_m))
    step_deg = min(WIDEST_STEP_DEG, STEP_DEG_PER_M * grid.cell_m)
    steps = int(np.floor(REACH_DEG / step_deg))
    turns = np.arange(-steps, steps + 1) * step_deg
    shape = tuple(fft.next_fast_len(n + 2 * reach, real=True) for n in grid.shape)
    layers = (*whiten(predicted), known.astype(np.float64))
    spectra = [np.conj(fft.rfft2(layer, shape)) for layer in layers]
    found = [
        _explained_share(
            spectra, _turn_image(contrast, grid, reach, (*params.around_m, turn)), known
        )
        for turn in turns
    ]
    reached = [fit[: 2 * reach + 1, : 2 * reach + 1] for fit in found]
    return Landscape(np.array(reached), turns, grid.cell_m, params.around_m)


def in_larger_cells(
    predicted: Predicted, contrast: Contrast, reach_m: float
) -> tuple[Predicted, Contrast]:
    """Both in cells large enough that `reach_m` is at most `MOST_LAGS` of them."""
    factor = int(np.ceil(reach_m / (MOST_LAGS * predicted.grid.cell_m)))
    if factor <= 1:
        return predicted, contrast
    grid, known, stack = _means(predicted.grid, predicted.known, predicted.stack, factor)
    wide, shown, (values,) = _means(contrast.grid, contrast.known, contrast.values[None], factor)
    return Predicted(grid, stack, known), Contrast(wide, values.astype(np.float32), shown)


def _means(
    grid: MapGrid, known: np.ndarray, layers: np.ndarray, factor: int
) -> tuple[MapGrid, np.ndarray, Stack]:
    """Means over squares of n x n cells, and where more than half of them are known."""
    rows, cols = grid.rows // factor, grid.cols // factor
    cut = np.s_[..., : rows * factor, : cols * factor]
    shape = (rows, factor, cols, factor)
    count = known[cut].reshape(shape).sum(axis=(1, 3))
    total = np.where(known, layers, 0.0)[cut].reshape(-1, *shape).sum(axis=(2, 4))
    larger = MapGrid(grid.west, grid.north, grid.cell_m * factor, rows, cols)
    is_known = count > factor**2 / 2
    return larger, is_known, np.where(is_known, total / np.maximum(count, 1), 0.0)


def whiten(predicted: Predicted) -> Stack:
    """Predictors made orthonormal over the known cells, zero elsewhere.

    Raises:
        OrbitalError: too few cells are known, or nothing varies in them.
    """
    known = predicted.known
    rows = predicted.stack[:, known]
    if rows.shape[1] < FEWEST_CELLS:
        raise OrbitalError(
            f"{rows.shape[1]} cells of ground are too few to register: at least {FEWEST_CELLS} "
            "are needed"
        )
    rows = rows - rows.mean(axis=1, keepdims=True)
    scale = np.sqrt((rows**2).mean(axis=1))
    varied = scale > 0
    if not varied.any():
        raise OrbitalError("the ground is flat and without contrast: there is nothing to register")
    rows = rows[varied] / scale[varied, None]
    normal = rows @ rows.T / rows.shape[1] + 1e-6 * np.eye(len(rows))
    orthonormal = solve_triangular(cholesky(normal, lower=True), rows, lower=True)
    out = np.zeros((len(rows), *known.shape))
    out[:, known] = orthonormal / np.sqrt(rows.shape[1])
    return out


def _turn_image(
    contrast: Contrast, grid: MapGrid, reach: int, place: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """The image on the map's grid with a margin of `reach` cells, interpolated after rotation.

    Cell x has the value of the image at c + d + R' (x - c), with the centre c of the map, and d and
    the rotation R from the image to the map by `place` (m, m, deg).
    """
    cell_m = grid.cell_m
    rows, cols = grid.rows + 2 * reach, grid.cols + 2 * reach
    east = grid.west + (np.arange(cols) - reach + 0.5) * cell_m
    north = grid.north - (np.arange(rows) - reach + 0.5) * cell_m
    turned = np.array([place[0], place[1], np.radians(place[2]), 0.0])
    at = map_to_image(grid, turned, east[None, :], north[:, None])
    sample, line = samples_of(contrast.grid, *at)
    values = cv2.remap(contrast.values, sample, line, cv2.INTER_CUBIC)
    shown = cv2.remap(contrast.known.astype(np.float32), sample, line, cv2.INTER_LINEAR)
    seen = shown > ALL
    return np.where(seen, values, 0.0), seen


def samples_of(grid: MapGrid, east: np.ndarray, north: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(column, row) of positions, as in OpenCV's images."""
    column = (east - grid.west) / grid.cell_m - 0.5
    row = (grid.north - north) / grid.cell_m - 0.5
    return column.astype(np.float32), row.astype(np.float32)


def map_to_image(
    grid: MapGrid, place: Float64[np.ndarray, " 4"], east: np.ndarray, north: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the image of points of the map whose centre is displaced in it.

    The point x of the map is at c + d + R' (x - c) / m in the image, with the map's centre c, and
    d, the rotation R, and m - 1 by `place` (m, m, rad, scale).
    """
    west, south, right, top = grid.bounds
    centre = ((west + right) / 2, (south + top) / 2)
    c, s = (f(place[2]) / (1 + place[3]) for f in (np.cos, np.sin))
    de, dn = east - centre[0], north - centre[1]
    return centre[0] + place[0] + c * de + s * dn, centre[1] + place[1] - s * de + c * dn


def _explained_share(
    spectra: Sequence[np.ndarray], image: tuple[np.ndarray, np.ndarray], known: Mask
) -> np.ndarray:
    """R squared for every shift of the map over a rotated image; valid up to twice the margin."""
    values, shown = (layer.astype(np.float64) for layer in image)
    shape = shown.shape[0], shown.shape[1]
    size = tuple(fft.next_fast_len(n, real=True) for n in shape)
    of_values, of_squares, of_shown = (
        fft.rfft2(layer, size) for layer in (values, values**2, shown)
    )
    *layers, mask = spectra
    cells = float(known.sum())
    mean = fft.irfft2(mask * of_values, size) / cells
    variance = fft.irfft2(mask * of_squares, size) - cells * mean**2
    together = np.sum([fft.irfft2(layer * of_values, size) ** 2 for layer in layers], axis=0)
    shares = fft.irfft2(mask * of_shown, size) / cells
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where((shares > LEAST_SHOWN_OF_MAP) & (variance > 0), together / variance, np.nan)


def refine(
    predicted: Predicted, contrast: Contrast, start: tuple[float, float, float]
) -> tuple[Float64[np.ndarray, " 4"], Float64[np.ndarray, "4 4"]]:
    """(east m, north m, rotation rad, scale) of the map in the image, and the covariance.

    Args:
        predicted: Predictors from the map.
        contrast: Contrast of the image.
        start: (east m, north m, rotation deg), accurate to a cell or two.

    Raises:
        OrbitalError: the map leaves the image, or the position does not converge.
    """
    grid = predicted.grid
    rows, cols = np.nonzero(predicted.known)
    east = grid.west + (cols + 0.5) * grid.cell_m
    north = grid.north - (rows + 0.5) * grid.cell_m
    orthonormal = whiten(predicted)[:, predicted.known] * np.sqrt(len(rows))
    layers = np.vstack([orthonormal, np.ones(len(rows))])
    view = _View.of(contrast, grid)
    steps = steps_in_cells(east, north, grid.cell_m)
    found = np.array([start[0], start[1], np.radians(start[2]), 0.0])
    least, step = np.inf, np.zeros(UNKNOWNS)
    for _ in range(ITERATIONS):
        value, slopes, shown = view.at(found, east, north)
        use = shown > ALL
        if use.mean() < LEAST_SHOWN:
            break
        design = np.column_stack([*slopes, -layers.T])[use]
        solved, *_ = np.linalg.lstsq(design, -value[use], rcond=None)
        residuals = value[use] + design @ solved
        covariance = clustered_covariance(design, residuals, east[use], north[use])
        covariance += np.diag((MODEL_CELLS / steps) ** 2)
        place, covariance = with_likely_scale(found + solved[:UNKNOWNS], covariance)
        unexplained = _unexplained_share(layers[:, use], value[use])
        if unexplained > least:  # too far: half the way back
            step /= 2
            found = found - step
        else:
            least, step, found = unexplained, place - found, place
        if np.abs(step * steps).max() < CONVERGED:
            return found, covariance
    raise OrbitalError("the position of the map in the orbital image does not converge")


def steps_in_cells(east: np.ndarray, north: np.ndarray, cell_m: float) -> Float64[np.ndarray, " 4"]:
    """Movement of the map's edge, in cells, by a unit of each unknown."""
    extent = np.hypot(np.ptp(east), np.ptp(north)) / 2
    return np.array([1.0, 1.0, extent, extent]) / cell_m


def with_likely_scale(
    place: Float64[np.ndarray, " 4"], covariance: Float64[np.ndarray, "4 4"]
) -> tuple[Float64[np.ndarray, " 4"], Float64[np.ndarray, "4 4"]]:
    """A position and its covariance, combined with the prior of the scale."""
    gain = covariance[:, -1] / (covariance[-1, -1] + SCALE_SIGMA**2)
    return place - gain * place[-1], covariance - np.outer(gain, covariance[-1])


def _unexplained_share(layers: np.ndarray, value: np.ndarray) -> float:
    """Fraction of the image's contrast that no combination of the predictors explains."""
    fitted, *_ = np.linalg.lstsq(layers.T, value, rcond=None)
    return float(np.var(value - layers.T @ fitted) / np.var(value))


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """The image with its slopes per metre east and north, interpolated at points of the map."""

    rasters: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    image: MapGrid
    ground: MapGrid

    @classmethod
    def of(cls, contrast: Contrast, ground: MapGrid) -> _View:
        d_line, d_sample = np.gradient(contrast.values.astype(np.float64), contrast.grid.cell_m)
        layers = (contrast.values, d_sample, -d_line, contrast.known)
        value, d_east, d_north, shown = (np.asarray(k, dtype=np.float32) for k in layers)
        return cls((value, d_east, d_north, shown), contrast.grid, ground)

    def at(
        self, place: Float64[np.ndarray, " 4"], east: np.ndarray, north: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
        """Image values at the map's points, derivatives by `place`, and where they are known."""
        at = map_to_image(self.ground, place, east, north)
        value, d_e, d_n, shown = (
            _interpolated(raster, *samples_of(self.image, *at)) for raster in self.rasters
        )
        west, south, right, top = self.ground.bounds
        arm_e, arm_n = at[0] - place[0] - (west + right) / 2, at[1] - place[1] - (south + top) / 2
        by_scale = -(d_e * arm_e + d_n * arm_n) / (1 + place[3])
        return value, (d_e, d_n, d_e * arm_n - d_n * arm_e, by_scale), shown


def _interpolated(raster: np.ndarray, sample: np.ndarray, line: np.ndarray) -> np.ndarray:
    """An image at some points, in rows of fewer than 32768, which OpenCV requires."""
    rows = -(-len(sample) // ROW)
    columns, lines = (
        np.pad(k, (0, rows * ROW - len(k))).reshape(rows, ROW) for k in (sample, line)
    )
    found = np.asarray(cv2.remap(raster, columns, lines, cv2.INTER_CUBIC))
    return found.ravel()[: len(sample)].astype(np.float64)


def clustered_covariance(
    design: Float64[np.ndarray, "cells unknowns"],
    residuals: Float64[np.ndarray, " cells"],
    east: np.ndarray,
    north: np.ndarray,
    cluster_m: float = CLUSTER_M,
) -> Float64[np.ndarray, "4 4"]:
    """Cluster-robust covariance of the position (Liang and Zeger 1986)."""
    inverse = np.linalg.inv(design.T @ design)
    squares = np.column_stack([np.floor(east / cluster_m), np.floor(north / cluster_m)])
    _, cluster = np.unique(squares, axis=0, return_inverse=True)
    scores = np.zeros((cluster.max() + 1, design.shape[1]))
    np.add.at(scores, cluster.ravel(), design * residuals[:, None])
    few = len(scores) / max(1, len(scores) - design.shape[1])
    return (inverse @ (scores.T @ scores) @ inverse)[:UNKNOWNS, :UNKNOWNS] * few
