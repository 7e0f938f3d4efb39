"""Orthophotos as a whole, put together from the blocks that production writes one by one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, TerrainView
from solmap.photogrammetry.terrain.orthophoto.brightness import Balance
from solmap.photogrammetry.terrain.orthophoto.mosaic import NO_SOURCE, Sources
from solmap.photogrammetry.terrain.orthophoto.rendering import (
    OrthophotoParams,
    Stretch,
    prepare_orthophoto,
)


@dataclass(frozen=True, slots=True, eq=False)
class Orthophoto:
    """An image of the ground from straight above."""

    grid: MapGrid
    brightness: Raster
    """In the units of the images, balanced; NaN where no view shows the ground."""
    source_grid: MapGrid
    source: Sources
    """Index into `pair_ids` of the view that counts most; `NO_SOURCE` where there is none."""
    pair_ids: tuple[str, ...]
    stretch: Stretch
    balance: Balance


def render_orthophoto(
    dtm: Dtm, views: Sequence[TerrainView], params: OrthophotoParams
) -> Orthophoto:
    """The orthophoto of all seen cells of a terrain model, as a whole.

    Raises:
        TerrainError: the terrain model is empty, or its cells are not a multiple of the
        orthophoto's.
    """
    made = prepare_orthophoto(dtm, views, params)
    brightness = np.full(made.grid.shape, np.nan, dtype=np.float32)
    source = np.full(made.source_grid.shape, NO_SOURCE, dtype=np.uint16)
    for block in made.blocks():
        put(brightness, block.brightness[0], block.row, block.col)
        put(source, block.sources, block.row // made.ratio, block.col // made.ratio)
    return Orthophoto(
        made.grid,
        brightness,
        made.source_grid,
        source,
        made.pair_ids,
        made.stretch[0],
        made.balance[:, 0],
    )


def put(whole: np.ndarray, part: np.ndarray, row: int, col: int) -> None:
    """Lay a part into the whole."""
    whole[row : row + part.shape[0], col : col + part.shape[1]] = part
