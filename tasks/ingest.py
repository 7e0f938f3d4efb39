"""Ingest: take over the files of a downlink, say what each is, and find the stereo partners.

An image product is the file as it came, byte for byte, under the digest of its content; whoever
needs its label or pixels reads them from there. Where the label is a file of its own (.lbl beside
the image), it stands in the product before the image, both unchanged. A file that cannot be read is
an outcome with one clear line, and stops nothing else.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from prefect import task
from prefect.cache_policies import NO_CACHE

from photogrammetry.arrays import GreyImage, Mask, Picture
from photogrammetry.errors import PhotogrammetryError
from photogrammetry.imagery import RoverImage
from photogrammetry.pds3.detached import with_attached_label
from photogrammetry.pds3.label import MAX_LABEL_BYTES
from photogrammetry.pds3.partners import find_stereo_pairs
from photogrammetry.pds3.reading import has_attached_label, read_image, read_image_record
from photogrammetry.pds3.vector_files import parse_vector_file
from products.catalogue import ImageEntry, Outcome
from products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from products.workspace import Workspace
from tasks.scopes import image_scope

IMAGE_SUFFIXES = {".img"}
VECTOR_SUFFIXES = {".svf", ".rvf"}
LABEL_SUFFIXES = (".lbl", ".LBL")
MAX_FILE_BYTES = 256 << 20
"""Far above any frame of these cameras; a larger file is not read into memory."""


@dataclass(frozen=True, slots=True)
class ContentDigest:
    """What an ingested file is made from: its content."""

    sha256: str


@dataclass(frozen=True, slots=True)
class BrowseParams:
    """How a browse image is stretched."""

    low_percent: float = 1.0
    high_percent: float = 99.0
    """Share of pixels below black and white: keeps specular pixels from darkening the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class Delivery:
    """What a downlink brought."""

    images: tuple[RoverImage, ...]
    outcomes: tuple[Outcome, ...]
    files: int

    @property
    def first_sols(self) -> dict[str, int]:
        """The earliest sol that each mission's images are from."""
        sols: dict[str, int] = {}
        for image in self.images:
            mission = image.stop.mission
            sols[mission] = min(sols.get(mission, image.sol), image.sol)
        return sols


@task(cache_policy=NO_CACHE, task_run_name="ingest-{downlink}")
def ingest_downlink(
    downlink: Path,
    workspace: Workspace,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Delivery:
    """Take every image and vector file below a folder into the store and catalogue."""
    files = files_of(downlink)
    images: list[RoverImage] = []
    entries: list[ImageEntry] = []
    outcomes: list[Outcome] = []
    vectors: list[ProductRef] = []
    with ThreadPoolExecutor(2) as pool:
        for done, taken in enumerate(pool.map(lambda file: _take(file, workspace), files), 1):
            progress(done, len(files))
            match taken:
                case Outcome():
                    outcomes.append(taken)
                case ProductRef():
                    vectors.append(taken)
                case (image, entry):
                    images.append(image)
                    entries.append(entry)
    entries = _paired(entries, images, workspace)
    workspace.catalogue.publish(images=entries, pointers=vectors, outcomes=outcomes)
    return Delivery(tuple(images), tuple(outcomes), len(files))


def files_of(downlink: Path) -> list[Path]:
    """Every image and vector file below a folder, whatever the case of its suffix, by name."""
    known = IMAGE_SUFFIXES | VECTOR_SUFFIXES
    found = (path for path in downlink.rglob("*") if path.suffix.lower() in known)
    return sorted(path for path in found if path.is_file())


def _take(path: Path, workspace: Workspace) -> Outcome | ProductRef | tuple[RoverImage, ImageEntry]:
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            return _fault(path, f"{path.name} is {size >> 20} MiB: no image of these cameras")
        data = path.read_bytes()
        if path.suffix.lower() in VECTOR_SUFFIXES:
            return _take_vectors(path, data, workspace)
        return _take_image(path.name, _labelled(path, data), workspace)
    except (PhotogrammetryError, OSError) as error:
        return _fault(path, str(error))


def _labelled(path: Path, data: bytes) -> bytes:
    """An image with its label: its own or, if it has none, that of the .lbl file beside it."""
    if has_attached_label(data):
        return data
    for suffix in LABEL_SUFFIXES:
        label = path.with_suffix(suffix)
        if label.is_file() and label.stat().st_size <= MAX_LABEL_BYTES:
            return with_attached_label(data, label.read_text("latin-1"), label.name)
    return data


def _fault(path: Path, reason: str) -> Outcome:
    reason = reason if path.name in reason else f"{path.name}: {reason}"
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return Outcome(path.name, is_failure=True, notes=(reason,), at=now)


def _take_vectors(path: Path, data: bytes, workspace: Workspace) -> ProductRef:
    parse_vector_file(data.decode("utf-8", "replace"), path.name)  # refuses what is broken
    scope = Scope(ScopeLevel.REGION, path.name.lower().replace(".", "-"))
    digest = ContentDigest(hashlib.sha256(data).hexdigest())
    recipe = Recipe(ProductKind.VECTORS, scope, params=digest)
    return workspace.store.make(recipe, lambda draft: _write(draft, data))


def _write(draft: Path, data: bytes) -> None:
    draft.write_bytes(data)


def _take_image(name: str, data: bytes, workspace: Workspace) -> tuple[RoverImage, ImageEntry]:
    record = read_image_record(data, name)
    scope = image_scope(record.id)
    digest = ContentDigest(hashlib.sha256(data).hexdigest())
    recipe = Recipe(ProductKind.IMAGE, scope, params=digest)
    browse_recipe = Recipe(ProductKind.BROWSE, scope, (recipe.ref,), BrowseParams())
    if not workspace.store.has(browse_recipe.ref):
        image = read_image(data, name)  # refuses broken pixels before anything is kept
        workspace.store.make(recipe, lambda draft: _write(draft, data))
        workspace.store.make(
            browse_recipe, lambda draft: _write_browse(draft, image.pixels, image.mask)
        )
    return record, _entry(record, recipe.ref, browse_recipe.ref)


def _write_browse(draft: Path, pixels: GreyImage, mask: Mask) -> None:
    encoded, png = cv2.imencode(".png", stretched(pixels, mask, BrowseParams()))
    if not encoded:
        raise OSError(f"{draft.name} could not be encoded as PNG")
    draft.write_bytes(png.tobytes())


def stretched(pixels: GreyImage, mask: Mask, params: BrowseParams) -> Picture:
    """An eight-bit picture of an image, stretched between percentiles of its usable pixels."""
    usable = pixels[mask] if mask.any() else pixels.ravel()
    low, high = np.percentile(usable, [params.low_percent, params.high_percent])
    scaled = (pixels - low) * (255.0 / max(high - low, 1e-6))
    return np.clip(scaled, 0, 255).astype(np.uint8)


def _entry(image: RoverImage, ref: ProductRef, browse: ProductRef) -> ImageEntry:
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
        ref=ref,
        browse=browse,
    )


def _paired(
    entries: Sequence[ImageEntry], images: Sequence[RoverImage], workspace: Workspace
) -> list[ImageEntry]:
    """The new entries and those already known at the same stops, with their partners filled in."""
    by_id = {entry.id: entry for entry in entries}
    records = {image.id: image for image in images}
    for stop in sorted({entry.stop for entry in entries}):
        for known in workspace.catalogue.images(stop=stop):
            if known.id not in by_id:
                by_id[known.id] = known
                records[known.id] = image_record(known, workspace)
    pairing = find_stereo_pairs(list(records.values()))
    partners = {pair.left.id: pair.right.id for pair in pairing.pairs}
    partners |= {right: left for left, right in partners.items()}
    return [
        replace(
            entry,
            partner=partners.get(entry.id),
            unpaired_because=pairing.unpaired.get(entry.id),
        )
        for entry in by_id.values()
    ]


def image_record(entry: ImageEntry, workspace: Workspace) -> RoverImage:
    """The label of an ingested image, read from its product."""
    data = workspace.store.path(entry.ref).read_bytes()
    return read_image_record(data, f"{entry.id}.IMG")


def image_records(entries: Iterable[ImageEntry], workspace: Workspace) -> list[RoverImage]:
    """The labels of several ingested images."""
    return [image_record(entry, workspace) for entry in entries]
