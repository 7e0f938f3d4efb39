"""Terrain models as the stages of a stop read them: one after the other, from memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Condition

import numpy as np
from cachetools import LRUCache, cached

from solmap.photogrammetry.arrays import Int32
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.parts import Terrain
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.products.formats.raster.raster import open_dtm
from solmap.products.model import ProductKind, ProductRef
from solmap.products.store.product_store import ProductStore

MODELS_KEPT = 2
"""Terrain models of stops that are kept, 60 MB each: the window of a sol maps no more at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class KeptDtm:
    """The terrain model of a stop in memory, in the parts of its file; its arrays are read only."""

    model: Dtm
    steps: Int32[np.ndarray, "block_rows block_cols"]

    @property
    def grid(self) -> MapGrid:
        """Grid of the whole model."""
        return self.model.grid

    def block_steps(self) -> Int32[np.ndarray, "block_rows block_cols"]:
        """1 for the blocks that its file holds, 0 for others."""
        return self.steps

    def part(self, rows: slice, cols: slice) -> Dtm:
        """A window of the model."""
        return self.model.part(rows, cols)


@cached(LRUCache(MODELS_KEPT), condition=Condition())  # two stages that start at once read it once
def _read(dtm: ProductRef, store: ProductStore) -> KeptDtm:
    with open_dtm(store.path(dtm)) as stored:
        rows, cols = stored.grid.shape
        model = stored.part(slice(0, rows), slice(0, cols))
        kept = KeptDtm(model, stored.block_steps())
    for array in (model.elevation, model.sigma_m, model.observations, model.ground):
        array.setflags(write=False)
    if model.pose_sigma_m is not None:
        model.pose_sigma_m.setflags(write=False)
    return kept


def read_stop_dtm(dtm: ProductRef, store: ProductStore) -> Dtm:
    """The terrain model of a stop; its arrays are read only."""
    return _read(dtm, store).model


@contextmanager
def terrain_of(dtm: ProductRef, store: ProductStore) -> Iterator[Terrain]:
    """A terrain model to be read in parts; a merged one is too large to be kept."""
    if dtm.kind is ProductKind.DTM:
        yield _read(dtm, store)
        return
    with open_dtm(store.path(dtm)) as terrain:
        yield terrain


def clear_dtms() -> None:
    """Free the memory of the terrain models that are kept."""
    _read.cache_clear()
