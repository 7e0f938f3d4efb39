"""The orthophoto: a vertical view of the ground, each cell from its best view.

Every cell is projected onto the terrain model (bilinear) and from there into the images. The
quality of a view (`view_sampling`) determines its weight, with seamless transitions between views
(`mosaic`). Brightness is balanced first (`brightness`). Cells without a view are NaN.

The map covers the part of the terrain model that a view may show. It is rendered block by block, so
that memory does not grow with its size. The source image is recorded for each cell of the terrain
model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float32, Float64, GreyImage, Raster, Vector3
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.ranges import CellSize, WholePixels
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, Bounds, MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, TerrainView
from solmap.photogrammetry.terrain.orthophoto.brightness import sample_brightness
from solmap.photogrammetry.terrain.orthophoto.mosaic import (
    Sources,
    TerrainPatch,
    blend,
    view_shares,
)
from solmap.photogrammetry.terrain.orthophoto.view_sampling import ViewSampler
from solmap.photogrammetry.threads import stream_in_threads

Stretch = tuple[float, float]
"""Brightness shown as black and as white."""


@dataclass(frozen=True, slots=True)
class OrthophotoParams:
    """Parameters of orthophotos."""

    cell_m: CellSize = 0.01
    """Side of a cell: as in `marsortho`, and in the paper's orthophotos (section 5)."""
    block_cells: WholePixels = 512
    """Side of the blocks: a megabyte per layer fits the processor's cache."""

    def __post_init__(self) -> None:
        if self.block_cells < 1 or not self.cell_m > 0:
            raise TerrainError(
                f"an orthophoto needs cells and blocks above zero, not {self.cell_m} m x "
                f"{self.block_cells}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class OrthophotoBlock:
    """A piece of an orthophoto; its first cell is at (row, col) of the whole."""

    row: int
    col: int
    brightness: Float32[np.ndarray, "bands rows cols"]
    """Brightness in the units of the images, balanced; NaN where no view shows the ground."""
    sources: Sources
    """Sources at the cells of the terrain model, `ratio` times coarser."""


@dataclass(frozen=True, slots=True, eq=False)
class OrthophotoRendering:
    """An orthophoto prepared for rendering."""

    dtm: Dtm
    samplers: tuple[ViewSampler, ...]
    """Balanced."""
    params: OrthophotoParams
    grid: MapGrid
    ratio: int
    """Orthophoto cells along the side of a terrain cell."""
    pair_ids: tuple[str, ...]
    stretch: tuple[Stretch, ...]
    """Stretch of each band."""
    balance: Float64[np.ndarray, "views bands 2"]
    """(gain, offset) of every view and band."""

    @property
    def source_grid(self) -> MapGrid:
        """Grid of the sources."""
        grid, ratio = self.grid, self.ratio
        rows, cols = grid.rows // ratio, grid.cols // ratio
        return MapGrid(grid.west, grid.north, self.dtm.grid.cell_m, rows, cols)

    def blocks(self) -> Iterator[OrthophotoBlock]:
        """The blocks in which any view shows ground, row by row."""
        side = max(1, self.params.block_cells // self.ratio)
        rendered = stream_in_threads(self._block, windows(self.source_grid, side))
        return (block for block in rendered if block is not None)

    def _block(self, window: tuple[int, int, int, int]) -> OrthophotoBlock | None:
        """The block of some cells of the sources; None if no view shows ground there."""
        row, col, rows, cols = window
        params, cell_m = self.params, self.dtm.grid.cell_m
        patch = TerrainPatch.of(self.dtm, self.source_grid.part(row, col, rows, cols))
        if not patch.seen.any():
            return None
        shared = view_shares(self.samplers, patch, cell_m)
        if not shared.views:
            return None
        return OrthophotoBlock(
            row * self.ratio,
            col * self.ratio,
            blend(self.samplers, patch, shared, params.cell_m, self.ratio),
            shared.sources(patch.seen),
        )


def prepare_orthophoto(
    dtm: Dtm,
    views: Sequence[TerrainView],
    params: OrthophotoParams,
    bands: Sequence[Sequence[GreyImage]] = (),
) -> OrthophotoRendering:
    """Prepare the orthophoto of all known cells of a terrain model, to be rendered block by block.

    Args:
        dtm: The ground.
        views: Its views.
        params: How to render.
        bands: For every view, images through several filters to use instead of its own.

    Raises:
        TerrainError: the terrain model is empty, no view shows it, or its cells are not a multiple
            of the orthophoto's.
    """
    ratio = _ratio(dtm, params)
    chosen = bands or [(view.image,) for view in views]
    samplers = [ViewSampler.of(view, images) for view, images in zip(views, chosen, strict=True)]
    grid = MapGrid.covering(bounds_to_show(dtm, samplers), params.cell_m)
    taken = sample_brightness(dtm, samplers, params.cell_m)
    gains = taken.balance()
    return OrthophotoRendering(
        dtm=dtm,
        samplers=tuple(
            sampler.with_gains(own) for sampler, own in zip(samplers, gains, strict=True)
        ),
        params=params,
        grid=grid,
        ratio=ratio,
        pair_ids=tuple(view.pair_id for view in views),
        stretch=taken.stretch(gains),
        balance=gains,
    )


def _ratio(dtm: Dtm, params: OrthophotoParams) -> int:
    ratio = dtm.grid.cell_m / params.cell_m
    if abs(ratio - round(ratio)) > 1e-6 or ratio < 1 - 1e-6:  # noqa: PLR2004 - decimal fractions
        raise TerrainError(
            f"the terrain model's cells of {dtm.grid.cell_m} m are not a whole multiple of the "
            f"orthophoto's of {params.cell_m} m: use finer orthophoto cells"
        )
    return round(ratio)


def bounds_to_show(dtm: Dtm, samplers: Sequence[ViewSampler]) -> Bounds:
    """Bounds of the known cells near which any view may show ground.

    Raises:
        TerrainError: the terrain model is empty, or no view shows it.
    """
    seen = np.isfinite(dtm.elevation)
    if not seen.any():
        raise TerrainError("the terrain model has no known cell, so there is nothing to show")
    near = np.zeros_like(seen)
    for row, col, rows, cols in windows(dtm.grid, BLOCK):
        window = (slice(row, row + rows), slice(col, col + cols))
        if seen[window].any():
            sphere = _sphere(dtm.grid.part(row, col, rows, cols), dtm.elevation[window])
            near[window] = any(sampler.may_show(*sphere) for sampler in samplers)
    near &= seen
    if not near.any():
        raise TerrainError(
            f"none of the {len(samplers)} views shows known cells of the terrain model"
        )
    (top, bottom), (left, right) = (_extent(near.any(axis=axis)) for axis in (1, 0))
    return dtm.grid.part(top, left, bottom - top, right - left).bounds


def _extent(marked: Flags) -> tuple[int, int]:
    """First and one after the last marked one."""
    where = np.flatnonzero(marked)
    return int(where[0]), int(where[-1]) + 1


def _sphere(grid: MapGrid, elevation: Raster) -> tuple[Vector3, float]:
    """Middle and radius of a sphere around a piece of ground."""
    west, south, east, north = grid.bounds
    first = np.array([west, south, float(np.nanmin(elevation))])
    last = np.array([east, north, float(np.nanmax(elevation))])
    return (first + last) / 2, float(np.linalg.norm(last - first)) / 2


def windows(grid: MapGrid, side: int) -> Iterator[tuple[int, int, int, int]]:
    """(row, col, rows, cols) of windows that cover the grid."""
    for row in range(0, grid.rows, side):
        for col in range(0, grid.cols, side):
            yield row, col, min(side, grid.rows - row), min(side, grid.cols - col)
