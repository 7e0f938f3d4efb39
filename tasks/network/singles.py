"""Tie images that have no stereo partner: with one another, and with the pairs of their stop.

The product contains the ties and, in its header, the geometry to which every single image was
resampled, so that the adjustment treats each like a pair: its pointing is estimated too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from solmap.photogrammetry.adjustment.model.network import PairGeometry
from solmap.photogrammetry.cameras.epipolar import single_image
from solmap.photogrammetry.imagery import Eye, RoverImage, StopId
from solmap.photogrammetry.matching.conjugates import View
from solmap.photogrammetry.matching.records import MatchedPair, Ties
from solmap.photogrammetry.matching.resampling import resample
from solmap.photogrammetry.matching.single.search import MonoParams, SingleView
from solmap.photogrammetry.matching.single.tying import MonoTies, tie_single_images
from solmap.photogrammetry.terrain.orthophoto.colour import has_same_view
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.images import ImageFile, image_file, image_record, read_product_image
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.archives import (
    finite,
    geometry_document,
    geometry_of_document,
    read_ties,
    write_ties,
)
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.reports.matching_figures import FigureImage
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import PairProducts, pair_frame, read_matched_pair
from solmap.tasks.network.previews import write_sheet
from solmap.tasks.stage import stage

ON_THE_MAST = frozenset({"NAVCAM", "PANCAM", "MASTCAM"})
"""Cameras whose pointing is given by the mast's motors and corrected by ties."""


@dataclass(frozen=True, slots=True)
class SingleFile:
    """An image without a stereo partner, as a product."""

    id: str
    stop: StopId
    file: ImageFile


@dataclass(frozen=True, slots=True, eq=False)
class SingleTies:
    """Content of a product of `tie_singles`: tied single images, their ties, and the figures."""

    bodies: tuple[PairGeometry, ...]
    ties: Ties
    links: tuple[dict[str, Any], ...]


def singles_of(entries: Iterable[ImageEntry]) -> dict[StopId, tuple[SingleFile, ...]]:
    """The unpaired images of cameras on the mast, by stop."""
    found: dict[StopId, list[SingleFile]] = {}
    for entry in sorted(entries, key=lambda entry: entry.id):
        if entry.partner is None and entry.instrument in ON_THE_MAST:
            single = SingleFile(entry.id, entry.stop_id, image_file(entry))
            found.setdefault(single.stop, []).append(single)
    return {stop: tuple(files) for stop, files in found.items()}


def drop_repeats(entries: Iterable[ImageEntry], workspace: Workspace) -> list[ImageEntry]:
    """The images without those unpaired ones that repeat an exposure, or a view by another filter.

    Frames of one pointing share the mast's error, which is determined by the pair among them, and
    have no baseline: their ties would add no information. Of several unpaired ones only one is
    kept.
    """
    kept: list[ImageEntry] = []
    once = (entry for entry in entries if entry.repeats is None)
    for entry in sorted(once, key=lambda entry: (entry.partner is None, entry.id)):
        image = image_record(entry, workspace)
        of_stop = (image_record(e, workspace) for e in kept if e.stop == entry.stop)
        if entry.partner is None and any(has_same_view(image, other) for other in of_stop):
            continue
        kept.append(entry)
    return kept


@stage(task_run_name="tie-singles-{stop}")
def tie_singles(
    stop: StopId,
    singles: Sequence[SingleFile],
    pairs: Sequence[PairProducts],
    params: MonoParams,
    store: ProductStore,
    *,
    previews: bool = False,
) -> ProductRef:
    """Tie the single images of a stop with one another and with its pairs."""

    @cache
    def tie() -> tuple[list[tuple[RoverImage, SingleView]], list[MatchedPair], MonoTies]:
        read = [_single(file, store) for file in singles]
        matched = [read_matched_pair(pair, store) for pair in pairs]
        return read, matched, tie_single_images(stop, [v for _, v in read], params, matched)

    def write(path: Path) -> None:
        read, _, found = tie()
        write_ties(path, found.ties, _header(found, read))

    def write_preview(path: Path) -> None:
        read, matched, found = tie()
        alone = [FigureImage(view.image_id, view.view.image, view.view.mask) for _, view in read]
        write_sheet(path, [*map(FigureImage.of, matched), *alone], found.ties, found.misfit)

    images = (ref for file in singles for ref in file.file.inputs)
    seen = (ref for pair in pairs for ref in pair.made)
    scope = Scope(ScopeLevel.STOP, f"{stop}-singles")
    ties = store.make(Recipe(ProductKind.TIES, scope, (*images, *seen), params), write)
    if previews:
        store.make(Recipe(ProductKind.QUICKLOOK, scope, (ties,)), write_preview)
    return ties


def read_singles(ref: ProductRef, store: ProductStore) -> SingleTies:
    """The inverse of `tie_singles`."""
    ties, header = read_ties(store.path(ref))
    stop = StopId(*header["stop"])
    bodies = tuple(
        PairGeometry(body["id"], stop, geometry_of_document(body["geometry"]))
        for body in header["singles"]
    )
    return SingleTies(bodies, ties, tuple(header["links"]))


def singles_notes(stop: StopId, singles: SingleTies) -> list[str]:
    """Notes on the single images of a stop."""
    linked = [link for link in singles.links if link["ties"]]
    if not linked:
        return []
    apart = sorted(abs(link["label_px"]) for link in linked)
    return [
        f"{len(singles.bodies)} images of {stop} without a stereo pair are tied: "
        f"{len(singles.ties)} ties in {len(linked)} overlaps, by their labels up to "
        f"{apart[-1]:.1f} px off the epipolar line"
    ]


def _single(file: SingleFile, store: ProductStore) -> tuple[RoverImage, SingleView]:
    """An image with its label, resampled to square pixels without distortion."""
    read = read_product_image(file.file, store)
    image = read.image
    size = (image.samples, image.lines)
    geometry = single_image(image.camera, size, image.stop.frame, pair_frame(image))
    geometry = dataclasses.replace(geometry, mast_in_rover=image.mast_in_rover)
    grey, mask = resample(read.pixels, read.mask, image.camera, geometry, Eye.LEFT)
    return image, SingleView(image.id, geometry, View.of(grey, mask))


def _header(found: MonoTies, read: Sequence[tuple[RoverImage, SingleView]]) -> dict[str, Any]:
    """Figures of the links, and the geometry of the images that ties were found in."""
    tied = {name for link in found.links if link.ties for name in (link.first_id, link.second_id)}
    links = [dataclasses.asdict(link) for link in found.links]
    return {
        "stop": [found.stop.mission, found.stop.site, found.stop.drive],
        "singles": [
            {"id": view.image_id, "geometry": geometry_document(view.geometry)}
            for _, view in read
            if view.image_id in tied
        ],
        "links": [{name: finite(value) for name, value in link.items()} for link in links],
    }
