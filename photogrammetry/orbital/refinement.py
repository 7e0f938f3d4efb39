"""The last fraction of a cell: least-squares matching of the orbital image to the rover's map.

Unknown are shift and rotation of the image and the coefficients of the predictors; Gauss-Newton on
the residuals of the map's known cells. Residuals of neighbouring cells belong together (a rock that
the map has not seen is several cells wide), so the covariance is not that of independent cells but
the cluster-robust one: scores are summed over squares of ground before their products are. Shadows
and what else the linear terms cannot model pull the place by up to a third of a cell, mostly away
from the rover's sun; for these `MODEL_CELLS` is added (`tests/support/orbital_scenes.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import OrbitalError
from solmap.photogrammetry.orbital.predictors import Contrast, Predicted
from solmap.photogrammetry.orbital.search import ALL, lookup, samples_of, whiten
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

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
        unexplained = _unexplained(layers[:, use], value[use])
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


def _unexplained(layers: np.ndarray, value: np.ndarray) -> float:
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
        at_east, at_north = lookup(self.ground, turn_deg, east + place[0], north + place[1])
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
