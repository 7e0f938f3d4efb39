"""Terrain models read at single places, and the finest of several models at each.

Elevation between cell centres is bilinear over the cells that are known, where these carry more
than half of the weight: a gap stays a gap. Standard deviations are averaged with the same weights,
as if neighbouring cells shared their errors, which is never too good.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64, Int32, PerPoint, Raster
from solmap.photogrammetry.terrain.grid import MapGrid

MapPoints = Float64[np.ndarray, "n 2"]
"""(east, north) in metres of the local map."""
LEAST_KNOWN = 0.5
"""Weight of known cells below which a place counts as not measured."""
NOWHERE = -1
"""Source of a place that no model knows."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundSamples:
    """The ground at n places; NaN where it was not measured."""

    elevation: PerPoint
    """Metres above the tangent plane."""
    sigma_m: PerPoint
    """Standard deviation of the elevation, that of the poses included."""
    pose_sigma_m: PerPoint
    """The part of it that neighbouring places share; 0 where poses are taken for true."""
    source: Int32[np.ndarray, " n"]
    """Number of the model that an elevation is of; `NOWHERE` where none has one."""

    def __len__(self) -> int:
        return len(self.elevation)

    @property
    def own_sigma_m(self) -> PerPoint:
        """Standard deviation without what neighbouring places share."""
        return np.sqrt(np.maximum(self.sigma_m**2 - self.pose_sigma_m**2, 0.0))

    @classmethod
    def none(cls, n: int) -> GroundSamples:
        """Places of which nothing is known."""
        unknown = np.full(n, np.nan)
        return cls(unknown, unknown.copy(), unknown.copy(), np.full(n, NOWHERE, np.int32))


def bilinear(values: Raster, grid: MapGrid, places: MapPoints) -> PerPoint:
    """Cell values between cell centres; NaN beyond the grid and in gaps."""
    row = (grid.north - places[:, 1]) / grid.cell_m - 0.5
    col = (places[:, 0] - grid.west) / grid.cell_m - 0.5
    inside = (row >= -0.5) & (row < grid.rows - 0.5) & (col >= -0.5) & (col < grid.cols - 0.5)  # noqa: PLR2004 - half a cell
    first_row, first_col = (
        np.floor(np.where(inside, at, 0.0)).astype(np.int64) for at in (row, col)
    )
    down, right = np.where(inside, row - first_row, 0.0), np.where(inside, col - first_col, 0.0)
    total, weight = np.zeros(len(places)), np.zeros(len(places))
    for step_down, step_right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        value = values[
            np.clip(first_row + step_down, 0, grid.rows - 1),
            np.clip(first_col + step_right, 0, grid.cols - 1),
        ].astype(np.float64)
        share = np.where(step_down, down, 1 - down) * np.where(step_right, right, 1 - right)
        share = np.where(np.isfinite(value), share, 0.0)
        total += share * np.where(np.isfinite(value), value, 0.0)
        weight += share
    known = inside & (weight > LEAST_KNOWN)
    return np.where(known, total / np.where(known, weight, 1.0), np.nan)


def finest(models: Sequence[tuple[float, GroundSamples]]) -> GroundSamples:
    """At every place what the model of the finest cell says; of equal cells, the surest.

    Args:
        models: Cell size in metres and samples of each model, all at the same places. Their own
            sources are kept.
    """
    if not models:
        raise ValueError("there is no model to choose from")
    cells = sorted({cell_m for cell_m, _ in models})
    rank = np.stack(
        [np.where(np.isfinite(s.elevation), float(cells.index(c)), np.inf) for c, s in models]
    )
    sigma = np.stack([np.nan_to_num(s.sigma_m, nan=np.inf) for _, s in models])
    sigma = np.where(rank == rank.min(axis=0), sigma, np.inf)
    unsure = np.where(np.isfinite(sigma), sigma, np.finfo(np.float64).max)
    best = np.argmin(np.where(rank == rank.min(axis=0), unsure, np.inf), axis=0)

    def chosen(name: str) -> np.ndarray:
        values: np.ndarray = np.stack([getattr(s, name) for _, s in models])
        return values[best, np.arange(values.shape[1])]

    return GroundSamples(
        chosen("elevation"), chosen("sigma_m"), chosen("pose_sigma_m"), chosen("source")
    )
