"""Taking one image into the store: the file as it came, its browse picture, its entry.

How its pixels are read belongs to the image: of all that is known of the mission's cameras the part
that its label calls for, kept as a small product. So a changed table makes anew what was made from
images coded by it and nothing else, and where no table is given, recipes know of none.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2

from solmap.photogrammetry.archive.images.radiometry import PixelState, Radiometry
from solmap.photogrammetry.archive.images.reading import ReadImage, describe_image, read_image
from solmap.photogrammetry.imagery import RoverImage
from solmap.photogrammetry.stretching import stretched
from solmap.products.catalogue.catalogue import ImageEntry, Outcome
from solmap.products.catalogue.images import ImageFile
from solmap.products.formats.documents.archives import radiometry_digest, write_radiometry
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.scopes import file_scope, image_scope, region_scope


@dataclass(frozen=True, slots=True)
class ContentDigest:
    """What an ingested file is made from: its content."""

    sha256: str

    @classmethod
    def of(cls, data: bytes) -> ContentDigest:
        """The digest of a file."""
        return cls(hashlib.sha256(data).hexdigest())


@dataclass(frozen=True, slots=True)
class BrowseParams:
    """How a browse image is stretched."""

    low_percent: float = 1.0
    high_percent: float = 99.0
    """Share of pixels below black and white: keeps specular pixels from darkening the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class TakenImage:
    """An image that is in the store."""

    file_name: str
    record: RoverImage
    entry: ImageEntry


@dataclass(frozen=True, slots=True, eq=False)
class Intake:
    """What images are taken into, and with."""

    store: ProductStore
    radiometry: Mapping[str, Radiometry]
    """What is known of the cameras of each spacecraft."""
    known: Mapping[str, ImageEntry]
    """The images that were taken before, by identifier."""
    _tables: dict[tuple[str, PixelState], ProductRef | None] = field(default_factory=dict)

    def take(self, name: str, data: bytes) -> TakenImage | Outcome:
        """Take an image; what is in the store already is looked up.

        Of two files of one image the one made later on Earth counts, whichever comes first: the
        other is left aside, with an outcome that says so.

        Raises:
            LabelError: the file holds no mapping image.
            PixelError: its pixels are broken; nothing of it is kept.
        """
        described = describe_image(data, name)
        record = described.image
        scope = image_scope(record.id)
        recipe = Recipe(ProductKind.IMAGE, scope, params=ContentDigest.of(data))
        file = ImageFile(recipe.ref, self.tables_for(record.stop.mission, described.state))
        browse = Recipe(ProductKind.BROWSE, scope, file.inputs, BrowseParams())
        before = self.known.get(record.id)
        if before is not None and _rank(before) > (record.created or "", recipe.ref.digest):
            return left_aside(name, record.id)
        if before is not None and before.browse == browse.ref and self.store.has(browse.ref):
            notes = before.notes
        else:
            image = self._read(name, data, record.stop.mission)
            self.store.make(recipe, lambda draft: write_bytes(draft, data))
            self.store.make(browse, lambda draft: _write_browse(draft, image))
            notes = image.notes
        return TakenImage(name, record, _entry(record, described.state, file, browse.ref, notes))

    def tables_for(self, mission: str, state: PixelState) -> ProductRef | None:
        """The product of what pixels in a state are read with; None where that is nothing."""
        if (mission, state) not in self._tables:
            needed = self._of(mission).needed_by(state)
            self._tables[mission, state] = (
                None if needed.changes_nothing else self._keep(mission, needed)
            )
        return self._tables[mission, state]

    def is_read_otherwise(self, entry: ImageEntry) -> bool:
        """Whether a known image is read with other tables now than when it was taken."""
        state = PixelState(entry.code, entry.darkened_by)
        return self.tables_for(entry.mission, state) != entry.radiometry

    def _read(self, name: str, data: bytes, mission: str) -> ReadImage:
        return read_image(data, name, radiometry=self._of(mission))

    def _of(self, mission: str) -> Radiometry:
        return self.radiometry.get(mission, Radiometry())

    def _keep(self, mission: str, needed: Radiometry) -> ProductRef:
        digest = ContentDigest(radiometry_digest(needed))
        recipe = Recipe(ProductKind.RADIOMETRY, region_scope(mission), params=digest)
        return self.store.make(recipe, lambda draft: write_radiometry(draft, needed))


def one_of_each(images: Sequence[TakenImage]) -> tuple[list[TakenImage], list[Outcome]]:
    """The files that count, one for each image, and an outcome for each of the others."""
    counts: dict[str, TakenImage] = {}
    for image in sorted(images, key=lambda one: _rank(one.entry)):
        counts[image.record.id] = image
    refs = {image.entry.ref for image in counts.values()}
    others = [image for image in images if image.entry.ref not in refs]
    return list(counts.values()), [left_aside(one.file_name, one.record.id) for one in others]


def left_aside(name: str, image_id: str) -> Outcome:
    """How it ended for a file of an image that another file shows as well."""
    why = f"{name}: another file of {image_id} was made later and counts; this one is left aside"
    return Outcome.now(name, (why,))


def _rank(entry: ImageEntry) -> tuple[str, str]:
    """By this the files of one image are told apart: when they were made, and else by content."""
    return entry.created or "", entry.ref.digest


def keep_file(kind: ProductKind, name: str, data: bytes, store: ProductStore) -> ProductRef:
    """Keep a file that is about more than one image, as it came, under its name and content."""
    recipe = Recipe(kind, file_scope(name), params=ContentDigest.of(data))
    return store.make(recipe, lambda draft: write_bytes(draft, data))


def write_bytes(draft: Path, data: bytes) -> None:
    """Write a file as it came."""
    draft.write_bytes(data)


def _write_browse(draft: Path, image: ReadImage) -> None:
    params = BrowseParams()
    picture = stretched(image.pixels, image.mask, params.low_percent, params.high_percent)
    encoded, png = cv2.imencode(".png", picture)
    if not encoded:
        raise OSError(f"{draft.name} could not be encoded as PNG")
    draft.write_bytes(png.tobytes())


def _entry(
    image: RoverImage,
    state: PixelState,
    file: ImageFile,
    browse: ProductRef,
    notes: tuple[str, ...],
) -> ImageEntry:
    return ImageEntry(
        id=image.id,
        mission=image.stop.mission,
        stop=str(image.stop),
        site=image.stop.site,
        drive=image.stop.drive,
        sol=image.sol,
        instrument=image.instrument,
        eye=str(image.eye),
        product_type=image.product_type,
        start_time=image.start_time,
        local_solar_time=image.local_solar_time,
        partner=None,
        unpaired_because=None,
        ref=file.image,
        browse=browse,
        code=state.code,
        darkened_by=state.darkened_by,
        radiometry=file.radiometry,
        notes=notes,
        created=image.created,
    )
