"""A region's terrain model on disk: read and written tile by tile, at any size.

A tile and the margin that its cells depend on are read from the models of the stops that cover it,
fused, and written; the rest of the region is never in memory. Models with finer cells are averaged
down, those with coarser ones (far ground) are interpolated: before the fusion where a stop has
finer cells, after it elsewhere.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import rasterio
from pyproj import CRS
from rasterio.enums import Resampling
from rasterio.windows import Window

from solmap.photogrammetry.terrain.dtm.grid import BLOCK, MapGrid, overlap
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.dtm.region_dtm import (
    CELLS_ALONG_FAR,
    RegionBlock,
    RegionParams,
    Seam,
    SeamCounter,
    StopTerrain,
    finer_block,
    fuse_block,
)
from solmap.photogrammetry.terrain.dtm.resampling import coarser_dtm, finer_dtm
from solmap.products.crs import height_reference
from solmap.products.errors import ProductError
from solmap.products.formats.raster.cog import Band, RasterDescription, create_cog
from solmap.products.formats.raster.raster import BLOCK_LEVELS, band_names, grid_of, open_raster

TILE = 512
"""Cells along the side of a tile: two blocks of the file."""
SHRUNK = 16
"""Cells of a model along one of the overview that shows where it has ground."""
CACHE_MB = 64
"""Cache of GDAL for blocks; its default is a twentieth of the machine's memory."""
DTM_BANDS = (
    Band("elevation", "m"),
    Band("standard_deviation", "m"),
    Band("observations"),
    Band("class"),
    Band("pose_deviation", "m"),
    Band("nearest_stop"),
)
SEAM_BANDS = (Band("disagreement", "m"), Band("disagreement_in_sigmas"))


@dataclass(frozen=True, slots=True)
class RegionSource:
    """A stop's terrain model among those of a region."""

    name: str
    """The stop."""
    place: tuple[float, float]
    """East and north of its cameras, metres."""
    path: Path


@dataclass(frozen=True, slots=True)
class RegionFiles:
    """Output files of a region."""

    dtm: Path
    seams: Path


def write_region(
    files: RegionFiles,
    sources: Sequence[RegionSource],
    params: RegionParams,
    crs: CRS,
    tags: tuple[Mapping[str, str], Mapping[str, str]] = ({}, {}),
) -> tuple[Seam, ...]:
    """Fuse the models of stops into one of the region; returns the disagreement of any two.

    `tags` are written to the model and to the seams.

    Raises:
        ProductError: the cells of a model are not a power of two of the region's.
    """
    names = {"STOPS": json.dumps([source.name for source in sources])}
    height = {"VERTICAL": height_reference(crs)}
    of_model, of_seams = ({**names, **own} for own in tags)
    counter = SeamCounter()
    with contextlib.ExitStack() as held:
        held.enter_context(rasterio.Env(GDAL_CACHEMAX=CACHE_MB))
        opened = [
            _Source(k, one, held.enter_context(open_raster(one.path)), params.cell_m)
            for k, one in enumerate(sources)
        ]
        grid = _grid_around([one.grid for one in opened], params.cell_m)
        dtm = held.enter_context(
            create_cog(
                files.dtm,
                grid,
                crs,
                RasterDescription("float32", DTM_BANDS, tags={**of_model, **height}),
            )
        )
        seams = held.enter_context(
            create_cog(
                files.seams, grid, crs, RasterDescription("float32", SEAM_BANDS, tags=of_seams)
            )
        )
        levels = np.zeros([-(-count // BLOCK) for count in grid.shape], np.uint8)
        for row, col in _tiles(grid):
            factor = _fuse_tile((row, col), grid, opened, params, (dtm, seams), counter)
            tile = (slice(start // BLOCK, (start + TILE) // BLOCK) for start in (row, col))
            levels[*tile] = max(factor // CELLS_ALONG_FAR, 1).bit_length() - 1
        dtm.update_tags(**{BLOCK_LEVELS: " ".join("".join(map(str, row)) for row in levels)})
        found = counter.seams()
        seams.update_tags(SEAMS=json.dumps([asdict(seam) for seam in found]))
    return found


def read_seams(path: Path) -> tuple[tuple[str, ...], tuple[Seam, ...]]:
    """The stops of a region, and the disagreement of any two of them."""
    with open_raster(path) as dataset:
        tags = dataset.tags()
    rows = json.loads(tags["SEAMS"])
    stops = tuple(json.loads(tags["STOPS"]))
    return stops, tuple(Seam(**{**row, "stops": tuple(row["stops"])}) for row in rows)


def _grid_around(grids: Sequence[MapGrid], cell_m: float) -> MapGrid:
    bounds = np.array([grid.bounds for grid in grids])
    (west, south), (east, north) = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
    return MapGrid.covering((float(west), float(south), float(east), float(north)), cell_m)


def _tiles(grid: MapGrid) -> Iterator[tuple[int, int]]:
    for row in range(0, grid.rows, TILE):
        for col in range(0, grid.cols, TILE):
            yield row, col


def _fuse_tile(
    corner: tuple[int, int],
    grid: MapGrid,
    sources: Sequence[_Source],
    params: RegionParams,
    out: tuple[rasterio.io.DatasetWriter, rasterio.io.DatasetWriter],
    counter: SeamCounter,
) -> int:
    """Read, fuse and write one tile; does nothing where no stop has ground in it.

    Returns the side of the cells in which it was fused, in cells of the region: those of the finest
    model with ground in it.
    """
    row, col = corner
    rows, cols = min(TILE, grid.rows - row), min(TILE, grid.cols - col)
    tile = grid.part(row, col, rows, cols).bounds
    reached = [one for one in sources if overlap(one.grid.bounds, tile)]
    for factor in sorted({one.finer for one in reached}):
        own = params.wider(factor)
        halo = own.halo
        margin = halo * factor
        around = grid.window(
            slice(row - margin, row + rows + margin, factor),
            slice(col - margin, col + cols + margin, factor),
        )
        stops = _read(around, [one for one in reached if one.finer == factor])
        if not stops:
            continue
        stops += _read(around, [one for one in reached if one.finer > factor])
        inside = (
            slice(halo, halo + rows // factor),
            slice(halo, halo + cols // factor),
        )
        counter.add(stops, inside, times=factor**2)
        block = finer_block(fuse_block(stops, own), factor)
        for dataset, layers in zip(out, _layers(block), strict=True):
            there = np.stack(layers)[:, margin : margin + rows, margin : margin + cols]
            _write_blocks(dataset, there, (row, col))
        return factor
    return 1


def _read(around: MapGrid, sources: Iterable[_Source]) -> list[StopTerrain]:
    """The models with ground on a grid."""
    read = ((one, one.read(around)) for one in sources)
    return [StopTerrain(one.number, one.source.place, dtm) for one, dtm in read if dtm]


def _write_blocks(
    dataset: rasterio.io.DatasetWriter, layers: np.ndarray, corner: tuple[int, int]
) -> None:
    """Write the blocks of a tile in which anything is known: neither NaN nor zero."""
    for row in range(0, layers.shape[1], BLOCK):
        for col in range(0, layers.shape[2], BLOCK):
            part = layers[:, row : row + BLOCK, col : col + BLOCK]
            if (np.abs(part) > 0).any():
                window = Window(corner[1] + col, corner[0] + row, part.shape[2], part.shape[1])
                dataset.write(part, window=window)


def _layers(block: RegionBlock) -> tuple[list[np.ndarray], list[np.ndarray]]:
    dtm = block.dtm
    assert dtm.pose_sigma_m is not None  # noqa: S101 - fusion gives it
    return (
        [
            dtm.elevation,
            dtm.sigma_m,
            dtm.observations,
            dtm.ground.astype(np.float32),
            dtm.pose_sigma_m,
            block.nearest,
        ],
        [block.seam_m, block.seam_sigmas],
    )


class _Source:
    """An open model of a stop, read in the cells of the region."""

    def __init__(
        self, number: int, source: RegionSource, dataset: rasterio.DatasetReader, cell_m: float
    ) -> None:
        self.number, self.source, self._dataset = number, source, dataset
        self.grid = grid_of(dataset)
        self._bands = band_names(dataset)
        self._ground = dataset.read(
            self._bands.index("class") + 1,
            out_shape=tuple(-(-count // SHRUNK) for count in self.grid.shape),
            resampling=Resampling.average,
        )
        ratio = np.log2(cell_m / self.grid.cell_m)
        if abs(ratio - round(ratio)) > 1e-6:  # noqa: PLR2004 - rounding of a decimal fraction
            raise ProductError(
                f"the model of {source.name} has cells of {self.grid.cell_m} m, the region's of "
                f"{cell_m} m: one must be the other times a power of two"
            )
        self.finer = 2 ** max(0, round(-ratio))
        """Side of its cells, in cells of the region if these are smaller."""

    def read(self, around: MapGrid) -> Dtm | None:
        """The model on a grid of the region's cells or larger; None where it has no ground."""
        finer = round(self.grid.cell_m / around.cell_m)
        if finer <= 1:
            coarser = round(around.cell_m / self.grid.cell_m)
            dtm = self._window(around.divided(coarser))
            return coarser_dtm(dtm, coarser) if dtm else None
        row = round((self.grid.north - around.north) / around.cell_m)
        col = round((around.west - self.grid.west) / around.cell_m)
        first_row, first_col = row // finer - 1, col // finer - 1
        last_row = (row + around.rows) // finer + 2
        last_col = (col + around.cols) // finer + 2
        wide = self.grid.part(first_row, first_col, last_row - first_row, last_col - first_col)
        dtm = self._window(wide)
        if dtm is None:
            return None
        top, left = row - first_row * finer, col - first_col * finer
        rows, cols = slice(top, top + around.rows), slice(left, left + around.cols)
        return replace(finer_dtm(dtm, finer).part(rows, cols), grid=around)

    def _window(self, grid: MapGrid) -> Dtm | None:
        """The model on a grid of its own cells that may extend beyond it; None without ground."""
        row = round((self.grid.north - grid.north) / grid.cell_m)
        col = round((grid.west - self.grid.west) / grid.cell_m)
        top, left = max(0, row), max(0, col)
        bottom = max(top, min(self.grid.rows, row + grid.rows))
        right = max(left, min(self.grid.cols, col + grid.cols))
        shrunk = (slice(a // SHRUNK, -(-b // SHRUNK)) for a, b in ((top, bottom), (left, right)))
        if not (self._ground[*shrunk] > 0).any():
            return None
        stack = np.full((len(self._bands), *grid.shape), np.nan, dtype=np.float32)
        if bottom > top and right > left:
            there = (slice(None), slice(top - row, bottom - row), slice(left - col, right - col))
            stack[there] = self._dataset.read(window=Window(left, top, right - left, bottom - top))
        bands = dict(zip(self._bands, stack, strict=True))
        ground = np.nan_to_num(bands["class"], copy=False).astype(np.uint8)
        if not ground.any():
            return None
        return Dtm(
            grid,
            bands["elevation"],
            bands["standard_deviation"],
            np.nan_to_num(bands["observations"], copy=False),
            ground,
            bands.get("pose_deviation"),
        )
