"""Orthophoto: a stop's images, seen from straight above, and which of them each cell came from."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from solmap.photogrammetry.arrays import Classes
from solmap.photogrammetry.terrain.orthophoto.mosaic import NO_SOURCE
from solmap.photogrammetry.terrain.orthophoto.rendering import (
    OrthophotoParams,
    Rendering,
    put,
    rendering,
)
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.orthophoto import (
    BrightnessBlock,
    write_brightness_blocks,
    write_sources,
)
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.products.store.provenance import provenance_tags
from solmap.tasks.stage import stage
from solmap.tasks.views import OrientedPair, inputs_of, read_views


@stage(task_run_name="orthophoto-{dtm.scope}")
def render_orthophoto(
    dtm: ProductRef,
    pairs: tuple[OrientedPair, ...],
    params: OrthophotoParams,
    landing: LandingPoint,
    store: ProductStore,
) -> tuple[ProductRef, ProductRef]:
    """Render the orthophoto of a terrain model from its images, and which each cell came from."""
    orientations = tuple(pair.orientation for pair in pairs)
    picture, sources = (
        Recipe(kind, dtm.scope, (dtm, *inputs_of(pairs)), (params, landing, orientations))
        for kind in (ProductKind.ORTHOPHOTO, ProductKind.SOURCES)
    )

    @cache
    def prepared() -> tuple[Rendering, Classes]:
        made = rendering(read_dtm(store.path(dtm)), read_views(pairs, store), params)
        return made, np.zeros(made.source_grid.shape, np.uint8)

    def write_picture(path: Path) -> None:
        write_rendering(path, *prepared(), landing, provenance_tags(picture))

    def write_codes(path: Path) -> None:
        made, codes = prepared()
        if not codes.any():  # the picture was there already
            deque(_pieces(made, codes), maxlen=0)
        tags = provenance_tags(sources)
        write_sources(path, made.source_grid, codes, made.pair_ids, local_crs(landing), tags=tags)

    return store.make(picture, write_picture), store.make(sources, write_codes)


def write_rendering(
    path: Path, made: Rendering, codes: Classes, landing: LandingPoint, tags: dict[str, str]
) -> None:
    """Render block by block into a file, and note in `codes` which view each cell came from."""
    pieces, crs = _pieces(made, codes), local_crs(landing)
    write_brightness_blocks(path, made.grid, pieces, crs, stretches=made.stretch, tags=tags)


def _pieces(made: Rendering, codes: Classes) -> Iterator[BrightnessBlock]:
    """The blocks of a picture; `codes` takes 1 for the first view, 0 for none."""
    for block in made.blocks():
        numbers = np.where(block.sources == NO_SOURCE, 0, block.sources + 1).astype(np.uint8)
        put(codes, numbers, block.row // made.ratio, block.col // made.ratio)
        yield block.row, block.col, block.brightness
