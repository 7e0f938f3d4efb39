"""The orthophoto: the ground from straight above, each cell from its best view.

Every cell is carried onto the terrain model (bilinear) and from there into the images. The worth of
a view (see `looks`) decides: views are averaged with weights

    w = (worth / greatest worth)^k,    k large

so that one view alone speaks for almost every cell and two of equal worth change over within some
twenty pixels: no seam, and no room for ghosts. What no view shows stays NaN.

The map is made block by block. Inside a block, image coordinates and weights are found at the
cells of the terrain model and interpolated between them: across a terrain cell of 0.04 m at 2 m
distance the curvature of the perspective is 0.03 px.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt16

from photogrammetry.arrays import Float32, Raster
from photogrammetry.errors import TerrainError
from photogrammetry.terrain.balance import Balance, balance
from photogrammetry.terrain.grid import MapGrid
from photogrammetry.terrain.looks import Look, Sight
from photogrammetry.terrain.records import Dtm, GroundClass, TerrainView
from photogrammetry.terrain.surface import gradients

NO_SOURCE = np.iinfo(np.uint16).max
"""Source index of cells without brightness."""
MARGIN = 2
"""Terrain cells around a block that its interpolation reaches into."""
BALANCE_SIDE = 200
"""Root of the number of terrain cells at which the brightness of views is compared."""


@dataclass(frozen=True, slots=True)
class OrthophotoParams:
    """How to render an orthophoto."""

    cell_m: float = 0.01
    """Side of a cell: as `marsortho`, and as the paper's orthophotos (section 5)."""
    block_cells: int = 1024
    """Side of the blocks it is made in: four megabytes a layer."""
    sharpness: float = 8.0
    """Exponent k: a view worth a quarter less than the best counts for a tenth."""
    tolerance_px: float = 1.0
    """How far a matched parallax may exceed the expected one before the cell counts as hidden: four
    standard deviations of a dense parallax."""
    normal_baseline_m: float = 0.2
    """Baseline of the normals that decide on incidence: rocks count, noise does not."""
    stretch_percent: tuple[float, float] = (0.5, 99.5)
    """Percentiles of the brightness that become black and white."""

    def __post_init__(self) -> None:
        if self.block_cells < 1 or not self.cell_m > 0:
            raise TerrainError(
                f"an orthophoto needs cells and blocks, not {self.cell_m} m x {self.block_cells}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Orthophoto:
    """An image of the ground from straight above."""

    grid: MapGrid
    brightness: Raster
    """In the units of the images, balanced; NaN where no view shows the ground."""
    source: UInt16[np.ndarray, "rows cols"]
    """Index into `pair_ids` of the view that counts most; `NO_SOURCE` where there is none."""
    pair_ids: tuple[str, ...]
    stretch: tuple[float, float]
    """Brightness to show as black and as white."""
    balance: Balance


def render_orthophoto(
    dtm: Dtm, views: Sequence[TerrainView], params: OrthophotoParams
) -> Orthophoto:
    """The orthophoto of all seen cells of a terrain model.

    Raises:
        TerrainError: the terrain model is empty, or its cells are no multiple of the orthophoto's.
    """
    ratio = _ratio(dtm, params)
    grid = MapGrid.covering(_bounds_of_seen(dtm), params.cell_m)
    looks = [Look.of(view) for view in views]
    scene = _Scene(dtm, looks, params)
    gains = balance(scene.shared_brightness())
    brightness = np.full(grid.shape, np.nan, dtype=np.float32)
    source = np.full(grid.shape, NO_SOURCE, dtype=np.uint16)
    for row, col, rows, cols in _blocks(grid, max(ratio, params.block_cells // ratio * ratio)):
        part = (slice(row, row + rows), slice(col, col + cols))
        made = scene.block(grid.part(row, col, rows, cols), ratio, gains)
        if made is not None:
            brightness[part], source[part] = made
    pair_ids = tuple(view.pair_id for view in views)
    stretch = _stretch(brightness, params.stretch_percent)
    return Orthophoto(grid, brightness, source, pair_ids, stretch, gains)


def _ratio(dtm: Dtm, params: OrthophotoParams) -> int:
    ratio = dtm.grid.cell_m / params.cell_m
    if abs(ratio - round(ratio)) > 1e-6 or ratio < 1 - 1e-6:  # noqa: PLR2004 - decimal fractions
        raise TerrainError(
            f"the terrain model's cells of {dtm.grid.cell_m} m are no whole multiple of the "
            f"orthophoto's of {params.cell_m} m: take finer orthophoto cells"
        )
    return round(ratio)


def _bounds_of_seen(dtm: Dtm) -> tuple[float, float, float, float]:
    rows = np.flatnonzero((dtm.ground != GroundClass.UNSEEN).any(axis=1))
    cols = np.flatnonzero((dtm.ground != GroundClass.UNSEEN).any(axis=0))
    if not len(rows):
        raise TerrainError("the terrain model has no seen cell, so there is nothing to show")
    return dtm.grid.part(
        int(rows[0]), int(cols[0]), int(rows[-1] - rows[0]) + 1, int(cols[-1] - cols[0]) + 1
    ).bounds


def _blocks(grid: MapGrid, side: int) -> Iterator[tuple[int, int, int, int]]:
    """(row, col, rows, cols) of blocks that cover the grid."""
    for row in range(0, grid.rows, side):
        for col in range(0, grid.cols, side):
            yield row, col, min(side, grid.rows - row), min(side, grid.cols - col)


def _stretch(brightness: Raster, percent: tuple[float, float]) -> tuple[float, float]:
    """Percentiles of a sample of the brightness; (0, 1) where there is none."""
    step = max(1, int(np.sqrt(brightness.size / 1e6)))
    sample = brightness[::step, ::step]
    sample = sample[np.isfinite(sample)]
    if not len(sample):
        return 0.0, 1.0
    low, high = np.percentile(sample, percent)
    return float(low), float(max(high, low + 1e-6))


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """The terrain and all views of it."""

    dtm: Dtm
    looks: list[Look]
    params: OrthophotoParams

    def shared_brightness(self) -> Float32[np.ndarray, "views n"]:
        """Brightness of all views at the same sample of cells; NaN where not shown."""
        seen = np.flatnonzero(self.dtm.ground != GroundClass.UNSEEN)
        places = np.linspace(0, len(seen) - 1, BALANCE_SIDE**2).astype(np.int64)
        chosen = seen[np.unique(places)]
        chosen = np.resize(chosen, (-(-len(chosen) // BALANCE_SIDE), BALANCE_SIDE))
        row, col = np.divmod(chosen, self.dtm.grid.cols)
        east, north = self.dtm.grid.centres()
        ground = np.stack([east[col], north[row], self.dtm.elevation[row, col]])
        up = np.zeros(ground.shape, dtype=np.float32)
        up[2] = 1.0
        values = np.empty((len(self.looks), chosen.size), dtype=np.float32)
        for number, look in enumerate(self.looks):
            sight = self._sight(look, ground, up)
            level = np.full_like(sight.sample, 2.0)
            grey = look.brightness(sight.sample, sight.line, level)
            values[number] = np.where(sight.worth > 0, grey, np.nan).ravel()
        return values

    def _sight(self, look: Look, ground: np.ndarray, normal: np.ndarray) -> Sight:
        from_camera = (ground - look.camera[:, None, None]).astype(np.float32)
        return look.sight(from_camera, normal, self.params.tolerance_px, self.dtm.grid.cell_m)

    def block(
        self, grid: MapGrid, ratio: int, gains: Balance
    ) -> tuple[Raster, UInt16[np.ndarray, "rows cols"]] | None:
        """Brightness and source of a block; None where no view shows anything."""
        seen, ground, normal = self._terrain(grid, ratio)
        if not seen.any():
            return None
        sights = [self._sight(look, ground, normal) for look in self.looks]
        best = np.max([sight.worth for sight in sights], axis=0)
        if not (best > 0).any():
            return None
        total = np.zeros(grid.shape, dtype=np.float32)
        grey, greatest = np.zeros_like(total), np.zeros_like(total)
        source = np.full(grid.shape, NO_SOURCE, dtype=np.uint16)
        for number, (look, sight) in enumerate(zip(self.looks, sights, strict=True)):
            if not (sight.worth > 0).any():
                continue
            share = (sight.worth / np.where(best > 0, best, 1)) ** np.float32(self.params.sharpness)
            weight = _finer(share, ratio)
            level = np.log2(np.maximum(np.sqrt(sight.density) * np.float32(grid.cell_m), 1))
            value = look.brightness(*(_finer(v, ratio) for v in (sight.sample, sight.line, level)))
            gain, offset = gains[number].astype(np.float32)
            grey += weight * (gain * value + offset)
            total += weight
            source[weight > greatest] = number
            np.maximum(greatest, weight, out=greatest)
        shown = (_finer((best > 0).astype(np.float32), ratio) >= 0.5) & (total > 0)  # noqa: PLR2004 - more of the cell is shown than hidden
        shown &= np.repeat(np.repeat(seen, ratio, axis=0), ratio, axis=1)
        source[~shown] = NO_SOURCE
        return np.where(shown, grey / np.where(shown, total, 1), np.float32(np.nan)), source

    def _terrain(self, grid: MapGrid, ratio: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Seen cells of a block; its ground and normals (east, north, up) with a margin around."""
        dtm = self.dtm
        first_row = round((dtm.grid.north - grid.north) / dtm.grid.cell_m)
        first_col = round((grid.west - dtm.grid.west) / dtm.grid.cell_m)
        rows, cols = grid.rows // ratio, grid.cols // ratio
        seen = dtm.ground[first_row : first_row + rows, first_col : first_col + cols]
        place = dtm.grid.part(
            first_row - MARGIN, first_col - MARGIN, rows + 2 * MARGIN, cols + 2 * MARGIN
        )
        elevation = _widened(_window(dtm.elevation, first_row, first_col, place.shape))
        east, north = place.centres()
        ground = np.stack([*np.meshgrid(east, north), elevation])
        gradient = gradients(elevation, dtm.grid.cell_m, self.params.normal_baseline_m, 0.0)
        gradient = np.nan_to_num(gradient)
        normal = np.stack([-gradient[0], -gradient[1], np.ones(place.shape)])
        normal /= np.linalg.norm(normal, axis=0)
        return seen != GroundClass.UNSEEN, ground, normal.astype(np.float32)


def _window(
    raster: Raster, row: int, col: int, shape: tuple[int, int]
) -> Float32[np.ndarray, "window_rows window_cols"]:
    """A window that starts `MARGIN` before (row, col); NaN outside the raster."""
    window = np.full(shape, np.nan, dtype=np.float32)
    top, left = max(0, row - MARGIN), max(0, col - MARGIN)
    bottom = min(raster.shape[0], row - MARGIN + shape[0])
    right = min(raster.shape[1], col - MARGIN + shape[1])
    down, across = top - (row - MARGIN), left - (col - MARGIN)
    window[down : down + bottom - top, across : across + right - left] = raster[
        top:bottom, left:right
    ]
    return window


def _widened(elevation: Raster) -> Raster:
    """Elevations carried on by two cells, so that interpolation reaches the edge of seen cells."""
    for _ in range(MARGIN):
        known = np.isfinite(elevation)
        sums = cv2.boxFilter(np.where(known, elevation, 0), -1, (3, 3), normalize=False)
        count = cv2.boxFilter(known.astype(np.float32), -1, (3, 3), normalize=False)
        around = np.where(count > 0.5, sums / np.maximum(count, 1), np.nan)  # noqa: PLR2004 - counts
        elevation = np.where(known, elevation, around).astype(np.float32)
    return elevation


def _finer(raster: Raster, ratio: int) -> Float32[np.ndarray, "fine_rows fine_cols"]:
    """A raster with margin, interpolated to cells `ratio` times finer, without the margin."""
    size = (raster.shape[1] * ratio, raster.shape[0] * ratio)
    fine = cv2.resize(raster, size, interpolation=cv2.INTER_LINEAR)
    edge = MARGIN * ratio
    return fine[edge:-edge, edge:-edge]
