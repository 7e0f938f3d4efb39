"""Orthophotos of a stop: from its pairs' images with the source of each cell, and in colour.

Colour requires left images with three bands or a Bayer mosaic (Mastcam-Z, Navcam of Perseverance),
or Pancam frames of one pointing through three filters.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from solmap.photogrammetry.archive.images.pixels import Colours
from solmap.photogrammetry.archive.images.reading import read_colour
from solmap.photogrammetry.archive.missions import MER
from solmap.photogrammetry.arrays import Classes, GreyImage, Mask
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.imagery import Eye, RoverImage
from solmap.photogrammetry.matching.resampling import resample
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.orthophoto.colour import (
    Triple,
    colour_filters,
    has_same_view,
)
from solmap.photogrammetry.terrain.orthophoto.mosaic import NO_SOURCE
from solmap.photogrammetry.terrain.orthophoto.rendering import (
    OrthophotoParams,
    OrthophotoRendering,
    prepare_orthophoto,
)
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.images import ImageFile, image_file, image_record, read_product_image
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.orthophoto import (
    BrightnessBlock,
    write_brightness_blocks,
    write_sources,
)
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.maps.dtms import read_stop_dtm
from solmap.tasks.maps.tags import raster_tags
from solmap.tasks.network.orientations import OrientedPair, inputs_of, read_views
from solmap.tasks.stage import stage

CAMERA = "PANCAM"


@stage(task_run_name="orthophoto-{dtm.scope}")
def render_orthophoto(
    dtm: ProductRef,
    pairs: tuple[OrientedPair, ...],
    params: OrthophotoParams,
    landing: LandingPoint,
    store: ProductStore,
) -> tuple[ProductRef, ProductRef]:
    """Render the orthophoto of a terrain model from its images, and the source of each cell."""
    orientations = tuple(pair.orientation for pair in pairs)
    orthophoto, sources = (
        Recipe(kind, dtm.scope, (dtm, *inputs_of(pairs)), (params, landing, orientations))
        for kind in (ProductKind.ORTHOPHOTO, ProductKind.SOURCES)
    )

    @cache
    def prepare() -> tuple[OrthophotoRendering, Classes]:
        views = read_views(pairs, store, sigmas=False)
        made = prepare_orthophoto(read_stop_dtm(dtm, store), views, params)
        return made, np.zeros(made.source_grid.shape, np.uint8)

    def write_orthophoto(path: Path) -> None:
        write_rendering(path, *prepare(), landing, raster_tags(orthophoto, store))

    def write_codes(path: Path) -> None:
        made, codes = prepare()
        if not codes.any():  # the orthophoto existed already
            deque(_pieces(made, codes), maxlen=0)
        tags = raster_tags(sources, store)
        write_sources(path, made.source_grid, codes, made.pair_ids, local_crs(landing), tags=tags)

    return store.make(orthophoto, write_orthophoto), store.make(sources, write_codes)


def write_rendering(
    path: Path,
    made: OrthophotoRendering,
    codes: Classes,
    landing: LandingPoint,
    tags: dict[str, str],
) -> None:
    """Render block by block into a file, and record the source view of each cell in `codes`."""
    pieces, crs = _pieces(made, codes), local_crs(landing)
    write_brightness_blocks(path, made.grid, pieces, crs, stretches=made.stretch, tags=tags)


def _pieces(made: OrthophotoRendering, codes: Classes) -> Iterator[BrightnessBlock]:
    """The blocks of an orthophoto; `codes` is set to 1 for the first view, 0 for none."""
    for block in made.blocks():
        numbers = np.where(block.sources == NO_SOURCE, 0, block.sources + 1).astype(np.uint8)
        row, col = block.row // made.ratio, block.col // made.ratio
        codes[row : row + numbers.shape[0], col : col + numbers.shape[1]] = numbers
        yield block.row, block.col, block.brightness


@dataclass(frozen=True, slots=True)
class ColourFrame:
    """A mapped pair, and its left images in colour."""

    pair: OrientedPair
    filters: Triple | None
    """Filters of the bands; None for a left image that is in colour itself."""
    images: tuple[ImageFile, ...]
    """Red, green and blue, or the left image."""

    @property
    def inputs(self) -> tuple[ProductRef, ...]:
        """Its input products."""
        return (*self.pair.inputs, *(ref for image in self.images for ref in image.inputs))


def colour_frames(
    pairs: Iterable[OrientedPair], entries: Sequence[ImageEntry], workspace: Workspace
) -> tuple[ColourFrame, ...]:
    """The pairs of a stop with colour, all through the same filters or none."""
    records = {e.id: image_record(e, workspace) for e in entries if e.instrument == CAMERA}
    known = {entry.id: entry for entry in entries}
    frames = []
    for pair in pairs:
        files = pair.products.files
        left = records.get(files.id)
        if left is not None:
            frame = _frame(pair, left, records, known)
        elif files.stop.mission in MER.hosts or _colours(files.left, workspace.store) is None:
            frame = None  # their detectors have no colour filters
        else:
            frame = ColourFrame(pair, None, (files.left,))
        if frame is not None:
            frames.append(frame)
    usual = Counter(frame.filters for frame in frames).most_common(1)
    return tuple(frame for frame in frames if frame.filters == usual[0][0])


def _frame(
    pair: OrientedPair,
    left: RoverImage,
    records: dict[str, RoverImage],
    known: dict[str, ImageEntry],
) -> ColourFrame | None:
    """The pair in colour; None where its left camera used too few filters."""
    by_filter: dict[int, RoverImage] = {}
    for image in sorted(records.values(), key=lambda image: _preference(image, left)):
        if image.filter_number and has_same_view(left, image):
            by_filter[image.filter_number] = image
    filters = colour_filters(by_filter)
    if filters is None:
        return None
    red, green, blue = (image_file(known[by_filter[number].id]) for number in filters)
    return ColourFrame(pair, filters, (red, green, blue))


def _preference(image: RoverImage, left: RoverImage) -> tuple[bool, int, str]:
    """Order of preference: the same kind of product, then large frames; the best comes last."""
    return image.product_type == left.product_type, image.samples * image.lines, image.id


@stage(task_run_name="colour-{dtm.scope}")
def render_colour(
    dtm: ProductRef,
    frames: tuple[ColourFrame, ...],
    params: OrthophotoParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Render the orthophoto of a terrain model in colour, if there are images for it."""
    orientations = tuple(frame.pair.orientation for frame in frames)
    inputs = (dtm, *(ref for frame in frames for ref in frame.inputs))
    recipe = Recipe(ProductKind.COLOUR, dtm.scope, inputs, (params, landing, orientations))
    numbers = frames[0].filters
    filters = "RGB" if numbers is None else ", ".join(f"L{number}" for number in numbers)

    def write(path: Path) -> None:
        coloured = [_read(frame, store) for frame in frames]
        views, bands = [view for view, _ in coloured], [images for _, images in coloured]
        made = prepare_orthophoto(read_stop_dtm(dtm, store), views, params, bands)
        tags = {"FILTERS": filters, **raster_tags(recipe, store)}
        write_rendering(path, made, np.zeros(made.source_grid.shape, np.uint8), landing, tags)

    return store.make(recipe, write)


def _read(frame: ColourFrame, store: ProductStore) -> tuple[TerrainView, list[GreyImage]]:
    """The pair's view, usable where all three bands are, and the bands in its geometry."""
    (view,) = read_views([frame.pair], store, sigmas=False)
    bands, mask = [], view.mask
    for camera, pixels, seen in _bands(frame, store):
        image, usable = resample(pixels, seen, camera, view.geometry, Eye.LEFT)
        bands.append(image)
        mask = mask & usable
    return replace(view, mask=mask), bands


def _bands(
    frame: ColourFrame, store: ProductStore
) -> Iterator[tuple[CameraModel, GreyImage, Mask]]:
    """Camera, pixels and mask of red, green and blue."""
    found = _colours(frame.images[0], store) if frame.filters is None else None
    for file in frame.images:
        read = read_product_image(file, store)
        if found is None:
            yield read.image.camera, read.pixels, read.mask
            continue
        for band in found[0]:
            yield read.image.camera, band, found[1] & read.mask


def _colours(file: ImageFile, store: ProductStore) -> tuple[Colours, Mask] | None:
    return read_colour(store.path(file.image).read_bytes(), f"{file.image.scope.name}.img")
