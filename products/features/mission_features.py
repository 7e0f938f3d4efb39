"""The features of a mission, collection by collection, in an index filled on demand.

    features = MissionFeatures.open(store, catalogue)
    keys = features.keys(BY_ID["tie-points"], "MER2")
    features.index.page(Selection(keys), limit=100)

Publishing fills the index in advance (`fill`); otherwise the first request does. Each feature has
the sols and times (UTC) of its images.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import sqlite3
import stat
import threading
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import gettempdir, mkdtemp
from typing import Any

import shapely
import shapely.geometry

from solmap.photogrammetry.archive.times import utc_of
from solmap.products.catalogue.catalogue import Catalogue, ImageEntry
from solmap.products.catalogue.edits import Edit, EditKind, EditLog
from solmap.products.errors import ProductError
from solmap.products.features.collections import COLLECTIONS, CollectionDefinition, image_properties
from solmap.products.features.index import FeatureIndex, IndexedFeature
from solmap.products.formats.vector.geojson import Feature, read_features
from solmap.products.model import Layer, ProductKind, ScopeLevel
from solmap.products.store.product_store import ProductStore

Sols = tuple[int, int]
Times = tuple[str, str]


class FeatureTimes:
    """The images of a mission, for the times of the features of a layer."""

    def __init__(self, images: Mapping[str, ImageEntry], layer: Layer) -> None:
        """Features without sol and image have the time of their layer."""
        self._images, self._layer = images, layer
        self._known: dict[tuple[Sols, str | None], Times | None] = {}

    def of(self, properties: Mapping[str, Any]) -> tuple[Sols | None, Times | None]:
        """First and last sol, and first and last exposure of the images of a feature."""
        named = [properties.get("image"), *(properties.get("pairs") or ())]
        behind = [self._images[name] for name in named if name in self._images]
        own = properties.get("sol", properties.get("sols"))
        listed = [own] if isinstance(own, int) else own
        known = listed or [image.sol for image in behind] or self._layer.sols
        if not known:
            return None, None
        sols = min(known), max(known)
        return sols, times_of(behind) if behind else self._of_stop(sols, properties.get("stop"))

    def _of_stop(self, sols: Sols, stop: str | None) -> Times | None:
        """The images of some sols, and of a stop where one is named."""
        key = sols, stop
        if key not in self._known:
            self._known[key] = times_of(
                image
                for image in self._images.values()
                if sols[0] <= image.sol <= sols[1] and stop in (None, image.stop)
            )
        return self._known[key]


def times_of(images: Iterable[ImageEntry]) -> Times | None:
    """First and last exposure of images; None where no label gives it."""
    starts = {image.start_time for image in images if utc_of(image.start_time)}
    known = sorted(moment(start) for start in starts if start)
    return (known[0], known[-1]) if known else None


@lru_cache(maxsize=65536)  # many features share an image
def moment(text: str) -> str:
    """A time in the format of the index: UTC with milliseconds.

    Raises:
        ValueError: it is not a time.
    """
    utc = utc_of(text)
    if utc is None:
        raise ValueError(f"{text[:40]!r} is not a time")
    return utc.isoformat(timespec="milliseconds").replace("+00:00", "Z")


log = logging.getLogger(__name__)
FOLDER = "index"


@dataclass(frozen=True, slots=True)
class Part:
    """The part of a collection from one layer."""

    key: str
    """Identifies its version in the index."""
    family: str
    layer: Layer | None
    """The layer; None: annotations."""


def temporary_folder(root: Path) -> Path:
    """A folder for files of a read-only store; no other user may write in it.

    It is the same each time, unless another user created one of that name first.
    """
    digest = hashlib.sha256(str(root).encode()).hexdigest()[:16]
    folder = Path(gettempdir()) / f"solmap-{digest}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    facts = folder.lstat()
    others = stat.S_IWGRP | stat.S_IWOTH
    is_own = facts.st_uid == os.getuid() and not facts.st_mode & others
    return folder if is_own and stat.S_ISDIR(facts.st_mode) else Path(mkdtemp(prefix="solmap-"))


@dataclass(frozen=True, slots=True, eq=False)
class MissionFeatures:
    """The index of a store, and the code that fills it."""

    store: ProductStore
    catalogue: Catalogue
    index: FeatureIndex
    _filling: threading.Lock = field(default_factory=threading.Lock)
    _known: dict[tuple[str, str], tuple[int, list[str]]] = field(default_factory=dict)
    """By collection and mission: a version of the catalogue, and the result of `keys` for it."""

    @classmethod
    def open(cls, store: ProductStore, catalogue: Catalogue) -> MissionFeatures:
        """Open the index of a store, in the store or, if that is read-only, beside it."""
        name = "features.sqlite"
        try:
            index = FeatureIndex.open(store.root / FOLDER / name)
        except (OSError, sqlite3.OperationalError):
            index = FeatureIndex.open(temporary_folder(store.root) / name)
        return cls(store, catalogue, index)

    def keys(self, collection: CollectionDefinition, mission: str) -> list[str]:
        """The layers of a collection in the index, which contains all of them on return."""
        key, version = (collection.id, mission), self.catalogue.version()
        if key not in self._known or self._known[key][0] != version:
            parts = list(self._parts(collection, mission))
            if collection.is_written:
                parts = [self._annotation_part(collection, mission)]
            if self.index.missing(part.key for part in parts):
                self._fill(collection, mission, parts)
            self._known[key] = version, [part.key for part in parts]
        return self._known[key][1]

    def fill(self, mission: str, kinds: Collection[ProductKind]) -> None:
        """Add published layers of some kinds to the index.

        Collections of other kinds may have changed, too: that of footprints lists every image ever
        taken. They are filled when they are published, or requested.
        """
        for collection in COLLECTIONS:
            if any(kind in kinds for kind in collection.kinds):
                self.keys(collection, mission)

    def _annotation_part(self, collection: CollectionDefinition, mission: str) -> Part:
        """The annotations so far."""
        edits = EditLog.of(self.store.root).edits(mission)
        family = f"{collection.id}/{mission}"
        return Part(f"{family}/{edits[-1].id if edits else 0}", family, None)

    def _fill(self, collection: CollectionDefinition, mission: str, parts: list[Part]) -> None:
        with self._filling:
            missing = set(self.index.missing(part.key for part in parts))
            images = {entry.id: entry for entry in self.catalogue.images(mission)}
            for part in parts:
                if part.key in missing:
                    rows = (
                        self._rows(collection, part.layer, images)
                        if part.layer
                        else self._annotations(mission)
                    )
                    self.index.put(part.key, part.family, rows)

    def _parts(self, collection: CollectionDefinition, mission: str) -> Iterator[Part]:
        images = f"/{self.catalogue.images_version(mission)}" if collection.all_images else ""
        for layer in self.catalogue.layers(mission, collection.kinds):
            family = f"{collection.id}/{layer.id}"
            sols = ",".join(map(str, layer.sols))
            yield Part(f"{family}/{layer.ref.digest}/{sols}{images}", family, layer)

    def _annotations(self, mission: str) -> Iterator[IndexedFeature]:
        """The annotations with effect except drafts. Their time is when they were written."""
        for edit in EditLog.of(self.store.root).effective(EditKind.ANNOTATION, mission):
            if edit.document.get("state") == "draft":
                continue
            try:
                yield _annotation(edit)
            except (ValueError, shapely.errors.ShapelyError) as error:
                log.warning("annotation %d has no shape and is left out: %s", edit.id, error)

    def _rows(
        self, collection: CollectionDefinition, layer: Layer, images: Mapping[str, ImageEntry]
    ) -> Iterator[IndexedFeature]:
        """The features of a layer; one that cannot be read is logged and counts as empty."""
        try:
            features = read_features(self.store.path(layer.ref)).features
        except ProductError as error:
            log.warning("%s", error)
            return
        of_mission = layer.ref.scope.name == layer.mission.lower()
        times, seen = FeatureTimes(images, layer), set()
        for number, one in enumerate(collection.draw(features, images), 1):
            own = one.id or str(number)
            name = own if of_mission else f"{layer.ref.scope.name}.{own}"
            seen.add(one.id)
            yield _row(name, one, layer, times)
        if collection.all_images:
            for entry in images.values():
                if entry.id not in seen:
                    yield _unplaced_image(entry)


def _annotation(edit: Edit) -> IndexedFeature:
    shape = _annotation_shape(edit.document["geometry"])
    document = edit.document
    annotation = {
        "text": document["text"],
        "category": document.get("category", "note"),
        "colour": document.get("colour"),
    }
    properties = {**annotation, "author": edit.author, "at": edit.at, "note": edit.note}
    at = moment(edit.at)
    text = json.dumps(properties, ensure_ascii=False)
    return IndexedFeature(str(edit.id), shapely.to_wkb(shape), text, None, (at, at))


def _annotation_shape(geometry: Mapping[str, Any]) -> shapely.Geometry:
    """The shape of an annotation, without elevations unless every point of it has one."""
    try:
        return shapely.geometry.shape(geometry)
    except ValueError:  # some points have one and others have none
        level = {**geometry, "coordinates": _without_elevation(geometry["coordinates"])}
        return shapely.geometry.shape(level)


def _without_elevation(part: Any) -> Any:  # noqa: ANN401 - places, or lists of them
    """Points as (east, north), without further coordinates."""
    if isinstance(part[0], int | float):
        return part[:2]
    return [_without_elevation(one) for one in part]


def _row(name: str, feature: Feature, layer: Layer, times: FeatureTimes) -> IndexedFeature:
    known = dict(feature.properties)
    if layer.ref.scope.level is ScopeLevel.STOP:
        known.setdefault("stop", layer.ref.scope.name)
    text = json.dumps(known, ensure_ascii=False)
    return IndexedFeature(name, shapely.to_wkb(feature.shape), text, *times.of(known))


def _unplaced_image(entry: ImageEntry) -> IndexedFeature:
    properties = json.dumps(image_properties(entry), ensure_ascii=False)
    return IndexedFeature(entry.id, None, properties, (entry.sol, entry.sol), times_of([entry]))
