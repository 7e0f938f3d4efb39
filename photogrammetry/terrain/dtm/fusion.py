"""Fusion of all views of a stop: the weighted mean height of every cell.

The variances are those of `stop_dtm`. Views are averaged with weights 1/sigma_h^2, reduced for
those that differ by more than two sigma (Huber), and the remaining differences enlarge the standard
deviation.

An error of a view's pose, a rotation w and a shift t with the covariance C, moves a point at P from
the camera by w x P + t. On ground with the normal n = (-g, 1) the elevation at a fixed position
changes by

    dh = w . (P x n) + t . n                  sigma_pose^2 = a' C a,  a = (P x n, n)

Views of one stop have one mast and one pose, and images hardly determine the common part of their
pointings, so these errors do not average out: with the weights w_v of the views in a cell, the part
of the poses in its standard deviation is sum(w_v sigma_pose,v), as for fully correlated errors. The
error common to all parallaxes of a view, that of its stereo rig, is added to that of its pose,
because all views of the rig have it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float32, Float64, Raster
from solmap.photogrammetry.matching.records import SharedSigma
from solmap.photogrammetry.planes import Gradients
from solmap.photogrammetry.ranges import FactorOrZero, Pixels
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.ground import (
    MAP_FROM_LSL,
    SightParams,
    camera_on_map,
    map_from_pair_rotation,
)
from solmap.photogrammetry.terrain.dtm.heights import ViewHeights
from solmap.photogrammetry.terrain.dtm.records import PoseCovariance, TerrainView

HUBER = 2.0
"""Standard deviations beyond which a view gets less weight."""
ROUNDS = 3
"""Rounds of reweighting; the weights hardly change after two."""
TINY_M2 = 1e-10
"""Lower limit of the variance: a hundredth of a millimetre squared."""

PATCH = 4
"""Cells along the side of a patch with one gradient: the baseline of slopes is some patches."""

PerEntry = Float32[np.ndarray, " entries"]
PerCell = Float64[np.ndarray, " cells"]


@dataclass(frozen=True, slots=True)
class FusionParams(SightParams):
    """Accuracy of the elevation of a cell."""

    sigma_image_px: Pixels = 0.25
    """Standard deviation of an image coordinate: half a pixel's rounding by the matching window."""
    correlation_px: Pixels = 9.0
    """Side of the window that refines dense parallax: pixels within it have correlated errors."""
    roughness: FactorOrZero = 0.2
    """Deviation of ground between pixels, over the length: the slope of rocky plains over some
    decimetres is about ten degrees (RMS)."""


@dataclass(frozen=True, slots=True, eq=False)
class Entries:
    """Contributions of all views to all cells, one row per view and cell, ordered by view."""

    grid: MapGrid
    view: tuple[slice, ...]
    """The rows of every view."""
    cell: np.ndarray
    height: Float64[np.ndarray, " entries"]
    points: PerEntry
    scatter: PerEntry
    sigma_px: PerEntry
    sag: PerEntry

    @classmethod
    def of(cls, heights: Sequence[ViewHeights], grid: MapGrid) -> Entries:
        """The entries inside the grid."""
        first_row, first_col = round(-grid.north / grid.cell_m), round(grid.west / grid.cell_m)
        parts, rows, start = [], [], 0
        for one in heights:
            row, col = one.row - first_row, one.col - first_col
            inside = (row >= 0) & (row < grid.rows) & (col >= 0) & (col < grid.cols)
            cell = row[inside] * grid.cols + col[inside]
            fields = (one.height, one.points, one.scatter, one.sigma_px, one.sag)
            parts.append((cell, *(field[inside] for field in fields)))
            rows.append(slice(start, start := start + len(cell)))
        columns = (np.concatenate(column) for column in zip(*parts, strict=True))
        return cls(grid, tuple(rows), *columns)

    def __len__(self) -> int:
        return len(self.cell)

    def sums(self, weights: np.ndarray) -> PerCell:
        """Sum of the weights of every cell's entries."""
        return np.bincount(self.cell, weights, minlength=self.grid.rows * self.grid.cols)

    @property
    def patch(self) -> np.ndarray:
        """The patch of every entry, counted along the rows of patches."""
        row, col = np.divmod(self.cell, self.grid.cols)
        return row // PATCH * self.patches[1] + col // PATCH

    @property
    def patches(self) -> tuple[int, int]:
        """Rows and columns of patches."""
        return -(-self.grid.rows // PATCH), -(-self.grid.cols // PATCH)

    def patch_means(self) -> Raster:
        """Mean height of the entries of every patch; NaN where there are none."""
        size = self.patches[0] * self.patches[1]
        patch = self.patch
        with np.errstate(invalid="ignore"):
            mean = np.bincount(patch, self.height, size) / np.bincount(patch, minlength=size)
        return mean.reshape(self.patches).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Variances:
    """Variance of the elevation of every entry, square metres."""

    own: PerEntry
    """Variance by matching and by the roughness of the ground."""
    pose: PerEntry
    """Variance by the pose of the view, and by the common error of its parallaxes."""


def variances(
    entries: Entries, views: Sequence[TerrainView], gradient: Gradients, params: FusionParams
) -> Variances:
    """Variances of every entry, on ground whose patches have this gradient."""
    own, pose = (np.empty(len(entries), dtype=np.float32) for _ in range(2))
    for (rows, ground), view in zip(_grounds(entries, views, gradient), views, strict=True):
        own[rows], shared = _own_variance(entries, rows, ground, view, params)
        pose[rows] = _pose_variance(ground, view.covariance) + shared
    return Variances(own, pose)


@dataclass(frozen=True, slots=True, eq=False)
class _Ground:
    """Position and slope of the ground in the cells of a view's entries."""

    P: Float32[np.ndarray, "3 entries"]
    """East, north and up from the camera, metres."""
    g: Float32[np.ndarray, "2 entries"]

    @property
    def leaving(self) -> PerEntry:
        """The component of P away from the ground, metres; negative where it is seen from above."""
        return self.P[2] - self.g[0] * self.P[0] - self.g[1] * self.P[1]


def _grounds(
    entries: Entries, views: Sequence[TerrainView], gradient: Gradients
) -> Iterator[tuple[slice, _Ground]]:
    """The ground of every view's entries."""
    grid, inclined = entries.grid, gradient.reshape(2, -1)[:, entries.patch]
    for rows, view in zip(entries.view, views, strict=True):
        camera = camera_on_map(view.lsl_from_pair)
        east, north = (place - camera[k] for k, place in enumerate(grid.centres()))
        cell = entries.cell[rows]
        row, col = np.divmod(cell, grid.cols)
        P = np.empty((3, len(cell)), dtype=np.float32)
        P[0], P[1] = east.astype(np.float32)[col], north.astype(np.float32)[row]
        P[2] = entries.height[rows] - camera[2]
        yield rows, _Ground(P, inclined[:, rows])


def _own_variance(
    entries: Entries, rows: slice, ground: _Ground, view: TerrainView, params: FusionParams
) -> tuple[PerEntry, PerEntry]:
    """Variances of a view's entries: independent ones, and common ones (see `stop_dtm`)."""
    focal, base = np.float32(view.geometry.focal_px), np.float32(view.geometry.base_m)
    cell_m, P = np.float32(entries.grid.cell_m), ground.P
    forward = map_from_pair_rotation(view.lsl_from_pair)[:, 2].astype(np.float32)
    Z = np.maximum(forward @ P, cell_m)
    points, leaving = entries.points[rows], ground.leaving
    along = np.square(leaving * Z / (focal * base))
    shared = np.square(_shared_px(view, focal * base / Z))
    own = np.maximum(np.square(entries.sigma_px[rows]) - shared, np.float32(0))
    across = np.square(np.float32(params.sigma_image_px) / focal * Z)
    across *= 1 + np.square(ground.g[0]) + np.square(ground.g[1])
    matches = np.maximum(np.float32(1), points / np.float32(params.correlation_px**2))
    grazing = np.clip(1 + leaving / np.maximum(np.abs(P[2]), cell_m), 0, 1)
    unresolved = np.float32(params.correlation_px) / focal * Z * grazing
    alone = (
        (along * own + across) / matches
        + np.square(entries.scatter[rows]) / np.maximum(np.float32(1), points)
        + np.square(np.float32(params.roughness) * entries.sag[rows])
        + np.square(unresolved) / np.float32(12)
    )
    return alone, along * shared


def _shared_px(view: TerrainView, parallax_px: PerEntry) -> PerEntry:
    """Standard deviation common to the parallax of every entry and all others of its view."""
    shared = view.shared or SharedSigma()
    return np.hypot(np.float32(shared.offset_px), np.float32(shared.stretch) * parallax_px)


def _pose_variance(ground: _Ground, covariance: PoseCovariance | None) -> PerEntry:
    """Variance by the pose, a' C a, of every entry; 0 where the pose is treated as exact."""
    if covariance is None:
        return np.zeros(ground.P.shape[1], dtype=np.float32)
    turned = np.kron(np.eye(2), MAP_FROM_LSL)
    values, vectors = np.linalg.eigh(turned @ covariance @ turned.T)
    root = (vectors * np.sqrt(np.maximum(values, 0))).T.astype(np.float32)  # a'Ca = |root a|^2
    (x, y, z), (g, h) = ground.P, ground.g
    a = np.stack([y + z * h, -z * g - x, y * g - x * h, -g, -h, np.ones_like(g)])
    return np.einsum("ij,ij->j", moved := root @ a, moved)


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Elevation of every cell and its accuracy; NaN where there is no entry."""

    level: Float32[np.ndarray, " cells"]
    sigma_m: Float32[np.ndarray, " cells"]
    pose_sigma_m: Float32[np.ndarray, " cells"]


def fuse(entries: Entries, known: Variances) -> Levels:
    """The weighted mean of every cell's entries."""
    variance = np.maximum(known.own + known.pose, np.float32(TINY_M2)).astype(np.float64)
    weight = 1 / variance
    several = (np.bincount(entries.cell) > 1)[entries.cell]
    cells, above = np.empty(0, np.int64), np.empty(0)
    if several.any():
        weight[several], cells, above = _huber_weights(
            entries.cell[several], entries.height[several], variance[several]
        )
    total = entries.sums(weight)
    with np.errstate(invalid="ignore", divide="ignore"):
        pose = _divide(entries.sums(weight * np.sqrt(known.pose)), total)
        level = _divide(entries.sums(weight * entries.height), total).astype(np.float32)
        own = _divide(entries.sums(weight**2 * known.own), np.square(total, out=total))
        own[cells] *= np.maximum(1.0, above)
        own += np.square(pose)
        sigma_m = np.sqrt(own, out=own).astype(np.float32)
        return Levels(level, sigma_m, pose.astype(np.float32))


def _divide(sums: PerCell, by: PerCell) -> PerCell:
    """The quotient, in place of the sums: a grid of cells is large."""
    return np.divide(sums, by, out=sums)


def _huber_weights(
    cell: np.ndarray, height: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights of entries that have common cells, these cells, and the scatter there.

    The scatter is the variance of unit weight: 1 where standard deviations are true.
    """
    cells, at = np.unique(cell, return_inverse=True)
    reweighting, deviation = np.ones_like(variance), np.sqrt(variance)
    for _ in range(ROUNDS):
        weight = reweighting / variance
        level = np.bincount(at, weight * height) / np.bincount(at, weight)
        off = np.abs(height - level[at]) / deviation
        reweighting = HUBER / np.maximum(HUBER, off)
    return weight, cells, np.bincount(at, off**2 * reweighting) / (np.bincount(at) - 1)
