"""Where in an orbital image a rover's map fits: to a cell by search, then to a fraction of it.

All places and rotations are tried by multiple correlation. For a shift d of the orbital image I,
with the predictors r_k of the map over its n known cells,

    c_k(d) = sum r_k(x) I(x + d),       explained(d) = c(d)' S^-1 c(d) / variance of I under the map

where the r_k are centred and S = sum r r'. That is the coefficient of determination (R squared) of
a linear regression of the image on the predictors, for all shifts at once by FFT, since S does not
depend on the shift. A map turned by theta against the image is found by turning the image.

The last fraction of a cell comes from least-squares matching. Unknown are shift and rotation of the
image and the coefficients of the predictors; Gauss-Newton on the residuals of the map's known
cells. Residuals of neighbouring cells belong together (a rock that the map has not seen is several
cells wide), so the covariance is not that of independent cells but the cluster-robust one: scores
are summed over squares of ground before their products are. Shadows and what else the linear terms
cannot model pull the place by up to a third of a cell, mostly away from the rover's sun; for these
`MODEL_CELLS` is added (`tests/support/orbital_scenes.py`).
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
"""Of a map: fewer say nothing about a place (10 m by 10 m at HiRISE's best)."""
ALL = 0.999
"""Weight of a look-up all of whose neighbours are known, less rounding."""
LEAST_SHOWN_OF_MAP = 0.9
"""Share of the map's cells that the image must show at a place that is judged."""


REACH_DEG = 2.5
"""How far a georeference may be turned, in each direction."""
STEP_DEG = 0.25
"""Between rotations tried: at 40 m, the radius of a stop's map, it moves the edge by 0.17 m."""
CLUSTER_M = 5.0
"""Side of the squares whose residuals may depend on each other: wider than any rock's shadow."""
MODEL_CELLS = 0.15
"""Standard deviation, in cells, of the pull of shadows on either coordinate, and on the map's edge
by a rotation: RMS over simulated scenes, three kinds of ground and suns of 25 to 65 degrees."""
ITERATIONS = 20
ROW = 1024
CONVERGED = 3e-3
"""Cells: no step moves the map's edge by more."""
LEAST_SHOWN = 0.5
"""Share of the map that the image must show."""


@dataclass(frozen=True, slots=True)
class SearchParams:
    """How far the georeference may be wrong."""

    reach_m: float = 12.0
    """In each direction: telemetry off by some percent of a drive, a georeference by some cells."""


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """How well the map fits at every rotation and shift."""

    explained: Float64[np.ndarray, "turns lags lags"]
    """Shifts of the map by (i - reach) rows down and (j - reach) columns right, NaN: not shown."""
    turns_deg: Float64[np.ndarray, " turns"]
    cell_m: float

    @property
    def reach(self) -> int:
        """Largest shift, cells."""
        return self.explained.shape[1] // 2

    def best(self) -> tuple[float, float, float, float]:
        """(explained, east, north, rotation deg): by how much the map lies off in the image."""
        if np.isnan(self.explained).all():
            raise OrbitalError("the image does not show the ground: nothing to compare")
        turn, row, col = np.unravel_index(np.nanargmax(self.explained), self.explained.shape)
        return (
            float(self.explained[turn, row, col]),
            (int(col) - self.reach) * self.cell_m,
            -(int(row) - self.reach) * self.cell_m,
            float(self.turns_deg[turn]),
        )

    def runner_up(self, apart_m: float) -> float:
        """How well the best place fits that lies at least so far from the best, at any rotation."""
        _, east, north, _ = self.best()
        lags = (np.arange(2 * self.reach + 1) - self.reach) * self.cell_m
        far = np.hypot(lags[None, :] - east, -lags[:, None] - north) > apart_m
        over_turns = np.nanmax(np.where(np.isfinite(self.explained), self.explained, -1.0), axis=0)
        return float(over_turns[far].max()) if far.any() else 0.0


def search(predicted: Predicted, contrast: Contrast, params: SearchParams) -> Landscape:
    """How well the map fits, for all rotations and shifts within reach.

    Raises:
        OrbitalError: the map is too small, or flat and plain: nothing in it could show.
    """
    grid, known = predicted.grid, predicted.known
    reach = int(np.ceil(params.reach_m / grid.cell_m))
    steps = int(np.floor(REACH_DEG / STEP_DEG))
    turns = np.arange(-steps, steps + 1) * STEP_DEG
    shape = tuple(fft.next_fast_len(n + 2 * reach, real=True) for n in grid.shape)
    layers = (*whiten(predicted), known.astype(np.float64))
    spectra = [np.conj(fft.rfft2(layer, shape)) for layer in layers]
    found = [
        _explained_share(spectra, _turn_image(contrast, grid, reach, turn), known) for turn in turns
    ]
    reached = [fit[: 2 * reach + 1, : 2 * reach + 1] for fit in found]
    return Landscape(np.array(reached), turns, grid.cell_m)


def whiten(predicted: Predicted) -> Stack:
    """Predictors made orthonormal over the known cells, zero elsewhere.

    Raises:
        OrbitalError: too few cells are known, or nothing varies in them.
    """
    known = predicted.known
    rows = predicted.stack[:, known]
    if rows.shape[1] < FEWEST_CELLS:
        raise OrbitalError(
            f"{rows.shape[1]} cells of ground are too few to be found from orbit: "
            f"at least {FEWEST_CELLS} are needed"
        )
    rows = rows - rows.mean(axis=1, keepdims=True)
    scale = np.sqrt((rows**2).mean(axis=1))
    varied = scale > 0
    if not varied.any():
        raise OrbitalError("the ground is flat and plain: nothing in it could show from orbit")
    rows = rows[varied] / scale[varied, None]
    normal = rows @ rows.T / rows.shape[1] + 1e-6 * np.eye(len(rows))
    orthonormal = solve_triangular(cholesky(normal, lower=True), rows, lower=True)
    out = np.zeros((len(rows), *known.shape))
    out[:, known] = orthonormal / np.sqrt(rows.shape[1])
    return out


def _turn_image(
    contrast: Contrast, grid: MapGrid, reach: int, rotation_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """The image on the map's grid with a margin of `reach` cells, looked up at turned places.

    Cell x shows what the image has at c + R' (x - c), c the centre of the map and R the rotation
    that carries the image onto the map.
    """
    cell_m = grid.cell_m
    rows, cols = grid.rows + 2 * reach, grid.cols + 2 * reach
    east = grid.west + (np.arange(cols) - reach + 0.5) * cell_m
    north = grid.north - (np.arange(rows) - reach + 0.5) * cell_m
    at_east, at_north = map_to_image(grid, rotation_deg, east[None, :], north[:, None])
    sample, line = samples_of(contrast.grid, at_east, at_north)
    values = cv2.remap(contrast.values, sample, line, cv2.INTER_CUBIC)
    shown = cv2.remap(contrast.known.astype(np.float32), sample, line, cv2.INTER_LINEAR)
    seen = shown > ALL
    return np.where(seen, values, 0.0), seen


def samples_of(grid: MapGrid, east: np.ndarray, north: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(column, row) of places, as OpenCV looks them up."""
    column = (east - grid.west) / grid.cell_m - 0.5
    row = (grid.north - north) / grid.cell_m - 0.5
    return column.astype(np.float32), row.astype(np.float32)


def map_to_image(
    grid: MapGrid, rotation_deg: float, east: np.ndarray, north: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where the image shows places of the map if it is turned by `rotation_deg` onto the map."""
    west, south, right, top = grid.bounds
    centre = ((west + right) / 2, (south + top) / 2)
    c, s = np.cos(np.radians(rotation_deg)), np.sin(np.radians(rotation_deg))
    de, dn = east - centre[0], north - centre[1]
    return centre[0] + c * de + s * dn, centre[1] - s * de + c * dn


def _explained_share(
    spectra: Sequence[np.ndarray], image: tuple[np.ndarray, np.ndarray], known: Mask
) -> np.ndarray:
    """R squared for every shift of the map over a turned image; useful up to twice the margin."""
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
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, "3 3"]]:
    """(east m, north m, rotation rad) by which the map lies off in the image, and its covariance.

    Args:
        predicted: What the map says of the image.
        contrast: What the image shows.
        start: (east m, north m, rotation deg), right to a cell or two.

    Raises:
        OrbitalError: the map slides off the image, or does not come to rest.
    """
    grid = predicted.grid
    rows, cols = np.nonzero(predicted.known)
    east = grid.west + (cols + 0.5) * grid.cell_m
    north = grid.north - (rows + 0.5) * grid.cell_m
    orthonormal = whiten(predicted)[:, predicted.known] * np.sqrt(len(rows))
    layers = np.vstack([orthonormal, np.ones(len(rows))])
    view = _View.of(contrast, grid)
    extent = np.hypot(np.ptp(east), np.ptp(north)) / 2
    scale = np.array([1.0, 1.0, extent]) / grid.cell_m  # steps in cells, at the edge for a turn
    found = np.array([start[0], start[1], np.radians(start[2])])
    least, step = np.inf, np.zeros(3)
    for _ in range(ITERATIONS):
        value, slopes, shown = view.at(found, east, north)
        use = shown > ALL
        if use.mean() < LEAST_SHOWN:
            break
        design = np.column_stack([*slopes, -layers.T])[use]
        solved, *_ = np.linalg.lstsq(design, -value[use], rcond=None)
        unexplained = _unexplained_share(layers[:, use], value[use])
        if unexplained > least:  # went too far: half the way back
            step /= 2
            found = found - step
        else:
            least, step = unexplained, solved[:3].copy()
            found = found + step
        if np.abs(step * scale).max() < CONVERGED:
            residuals = value[use] + design @ solved
            covariance = clustered_covariance(design, residuals, east[use], north[use])
            return found, covariance + np.diag((MODEL_CELLS / scale) ** 2)
    raise OrbitalError("the map does not come to rest in the orbital image: no place for it")


def _unexplained_share(layers: np.ndarray, value: np.ndarray) -> float:
    """Share of what the image shows that no combination of the predictors explains."""
    fitted, *_ = np.linalg.lstsq(layers.T, value, rcond=None)
    return float(np.var(value - layers.T @ fitted) / np.var(value))


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """The image with its slopes per metre east and north, looked up from places on the map."""

    pictures: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    image: MapGrid
    ground: MapGrid

    @classmethod
    def of(cls, contrast: Contrast, ground: MapGrid) -> _View:
        d_line, d_sample = np.gradient(contrast.values.astype(np.float64), contrast.grid.cell_m)
        layers = (contrast.values, d_sample, -d_line, contrast.known)
        value, d_east, d_north, shown = (np.asarray(k, dtype=np.float32) for k in layers)
        return cls((value, d_east, d_north, shown), contrast.grid, ground)

    def at(
        self, place: Float64[np.ndarray, " 3"], east: np.ndarray, north: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """What the image shows of the map, how it changes with `place`, and where it is known."""
        turn_deg = float(np.degrees(place[2]))
        at_east, at_north = map_to_image(self.ground, turn_deg, east + place[0], north + place[1])
        samples = samples_of(self.image, at_east, at_north)
        value, d_e, d_n, shown = (_looked_up(picture, *samples) for picture in self.pictures)
        c, s = np.cos(place[2]), np.sin(place[2])
        west, south, right, top = self.ground.bounds
        arm_e, arm_n = at_east - (west + right) / 2, at_north - (south + top) / 2
        slopes = (c * d_e - s * d_n, s * d_e + c * d_n, d_e * arm_n - d_n * arm_e)
        return value, slopes, shown


def _looked_up(picture: np.ndarray, sample: np.ndarray, line: np.ndarray) -> np.ndarray:
    """A picture at some places; OpenCV takes them as a picture of fewer than 32768 columns."""
    rows = -(-len(sample) // ROW)
    columns, lines = (
        np.pad(k, (0, rows * ROW - len(k))).reshape(rows, ROW) for k in (sample, line)
    )
    found = np.asarray(cv2.remap(picture, columns, lines, cv2.INTER_CUBIC))
    return found.ravel()[: len(sample)].astype(np.float64)


def clustered_covariance(
    design: Float64[np.ndarray, "cells unknowns"],
    residuals: Float64[np.ndarray, " cells"],
    east: np.ndarray,
    north: np.ndarray,
    cluster_m: float = CLUSTER_M,
) -> Float64[np.ndarray, "3 3"]:
    """Cluster-robust covariance of the first three unknowns (Liang and Zeger 1986)."""
    bread = np.linalg.inv(design.T @ design)
    squares = np.column_stack([np.floor(east / cluster_m), np.floor(north / cluster_m)])
    _, cluster = np.unique(squares, axis=0, return_inverse=True)
    scores = np.zeros((cluster.max() + 1, design.shape[1]))
    np.add.at(scores, cluster.ravel(), design * residuals[:, None])
    few = len(scores) / max(1, len(scores) - design.shape[1])
    return (bread @ (scores.T @ scores) @ bread)[:3, :3] * few
