"""Ingest the files of a downlink: store them, catalogue images, and find the stereo partners.

An image product is the delivered file, byte for byte, under the digest of its content; label and
pixels are read from it. A detached label (.lbl, .xml or .json beside the image) is joined to the
image in the product, both unchanged. For a file that cannot be read, an outcome
with the reason in one line is stored, and the other files are ingested; outcomes also contain notes
on the pixels of readable files.

The radiometric tables that are required by the label of an image are stored as a small product,
which is an input of the products of that image. A changed table therefore affects only images that
need it; recipes of images without tables contain none.
"""

from __future__ import annotations

import logging
import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2

from solmap.photogrammetry.archive.images.radiometry import PixelState, Radiometry
from solmap.photogrammetry.archive.images.reading import (
    DescribedImage,
    ReadImage,
    describe_image,
    read_described_image,
)
from solmap.photogrammetry.archive.missions import mission_id
from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.archive.tables.vector_files import parse_vector_file
from solmap.photogrammetry.errors import LabelError, PhotogrammetryError, PixelError
from solmap.photogrammetry.imagery import RoverImage
from solmap.photogrammetry.stretching import stretch
from solmap.products.catalogue.catalogue import ImageEntry, Outcome
from solmap.products.catalogue.images import ImageFile, image_record
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import (
    ProductError,
    ProductNotFoundError,
    StoreAwayError,
    StoreFullError,
    cause_of,
    one_line,
)
from solmap.products.formats.documents.archives import radiometry_digest, write_radiometry
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.faults import is_disk_full, is_transient, retry_transient
from solmap.products.store.product_store import ProductStore
from solmap.products.store.user_files import MAX_ROWS_BYTES, plain_name, read_user_file, reason_of
from solmap.tasks.images.files import (
    ContentDigest,
    image_bytes,
    is_settled,
    keep_vector_file,
    remedy,
    write_bytes,
)
from solmap.tasks.images.folders import VECTOR_SUFFIXES, files_of, is_manual_tie_file
from solmap.tasks.images.manual_ties import take_manual_ties
from solmap.tasks.images.poses import PoseSources
from solmap.tasks.images.rigs import RigImages, rig_image_bytes, rig_images
from solmap.tasks.images.telemetry import read_vector_file
from solmap.tasks.scopes import image_scope, region_scope
from solmap.tasks.stage import stage

log = logging.getLogger(__name__)

LAST = "~"
"""Sorts after every digest: a file to which the attitude was added has precedence."""
LARGE_BYTES = 32 << 20
LARGE_PIXELS = 1 << 23
"""Files and images above these sizes are read one at a time: each may take about 600 MB."""
_LARGE = threading.RLock()


def _in_turn(is_large: bool) -> AbstractContextManager[object]:  # noqa: FBT001 - the only parameter
    return _LARGE if is_large else nullcontext()


@dataclass(frozen=True, slots=True)
class BrowseParams:
    """Parameters of browse images."""

    low_percent: float = 1.0
    high_percent: float = 99.0
    """Percentiles drawn black and white, so that specular pixels do not darken the rest."""


@dataclass(frozen=True, slots=True, eq=False)
class TakenImage:
    """An image in the store."""

    file_name: str
    record: RoverImage
    entry: ImageEntry


@dataclass(frozen=True, slots=True, eq=False)
class Intake:
    """Store and settings for ingesting images."""

    store: ProductStore
    radiometry: Mapping[str, Radiometry]
    """Tables of the cameras of each spacecraft."""
    known: Mapping[str, ImageEntry]
    """The images ingested before, by identifier."""
    rigs: RigImages = field(default_factory=RigImages)
    """Images of own stereo rigs among the files."""
    poses: PoseSources = field(default_factory=PoseSources)
    """Poses of rovers for images whose labels lack the attitude."""
    _tables: dict[tuple[str, PixelState], ProductRef | None] = field(default_factory=dict)

    def take(self, name: str, data: bytes) -> TakenImage | Outcome:
        """Ingest an image, unless it is already in the store.

        Of two files of one image the one produced later is used, in any order of delivery; an
        outcome with the reason is returned for the other.

        Raises:
            LabelError: the file is not an image for mapping.
            PixelError: its pixels cannot be read; nothing is stored.
        """
        delivered, data = data, self.poses.with_attitude(data, name)
        described = describe_image(data, name)
        record = described.image
        scope = image_scope(record.id)
        recipe = Recipe(ProductKind.IMAGE, scope, params=ContentDigest.of(data))
        file = ImageFile(recipe.ref, self.tables_for(record.stop.mission, described.state))
        browse = Recipe(ProductKind.BROWSE, scope, file.inputs, BrowseParams())
        before = self.known.get(record.id)
        rank = record.created or "", recipe.ref.digest if data is delivered else LAST
        if before is not None and _rank(before) > rank:
            return superseded_outcome(name, record.id)
        if before is not None and before.browse == browse.ref and self.store.has(browse.ref):
            notes = before.notes
        else:
            with _in_turn(record.lines * record.samples > LARGE_PIXELS):
                image = self._read(name, described)
            self.store.make(recipe, lambda draft: write_bytes(draft, data))
            self.store.make(browse, lambda draft: _write_browse(draft, image))
            notes = image.notes
        entry = _entry(record, described.state, file, browse.ref, notes)
        if before is not None and before.stop == entry.stop:
            entry = replace(entry, mission=before.mission)  # stays on the map of its stop
        return TakenImage(name, record, entry)

    def take_rig_image(self, path: Path, name: str, data: bytes) -> TakenImage | Outcome:
        """Ingest an image of an own stereo rig.

        Raises:
            LabelError: its size is not that of the calibration of its camera.
            PixelError: it cannot be read.
        """
        shot, created = self.rigs.shots[path]
        before = self.known.get(shot.image_id)
        kept = self.store.path(before.ref).read_bytes() if before else None
        return self.take(name, rig_image_bytes(shot, created, data, name, kept))

    def tables_for(self, mission: str, state: PixelState) -> ProductRef | None:
        """The product of the tables for pixels in a state; None if none are needed."""
        if (mission, state) not in self._tables:
            needed = self._of(mission).needed_by(state)
            self._tables[mission, state] = (
                None if needed.changes_nothing else self._keep(mission, needed)
            )
        return self._tables[mission, state]

    def is_read_otherwise(self, entry: ImageEntry) -> bool:
        """Whether the tables of a known image have changed since it was ingested."""
        state = PixelState(entry.code, entry.darkened_by)
        return self.tables_for(entry.stop_id.mission, state) != entry.radiometry

    def _read(self, name: str, described: DescribedImage) -> ReadImage:
        radiometry = self._of(described.image.stop.mission)
        image = read_described_image(described, name, radiometry=radiometry)
        if not image.mask.any():
            raise PixelError(f"{name}: none of its pixels was measured")
        return image

    def _of(self, mission: str) -> Radiometry:
        return self.radiometry.get(mission, Radiometry())

    def _keep(self, mission: str, needed: Radiometry) -> ProductRef:
        digest = ContentDigest(radiometry_digest(needed))
        recipe = Recipe(ProductKind.RADIOMETRY, region_scope(mission), params=digest)
        return self.store.make(recipe, lambda draft: write_radiometry(draft, needed))


def newest_of_each(images: Sequence[TakenImage]) -> tuple[list[TakenImage], list[Outcome]]:
    """The files to use, one for each image, and an outcome for each of the others."""
    counts: dict[str, TakenImage] = {}
    for image in sorted(images, key=lambda one: _rank(one.entry)):
        counts[image.record.id] = image
    refs = {image.entry.ref for image in counts.values()}
    others = [image for image in images if image.entry.ref not in refs]
    return list(counts.values()), [
        superseded_outcome(one.file_name, one.record.id) for one in others
    ]


def superseded_outcome(name: str, image_id: str) -> Outcome:
    """The outcome of a file whose image has a newer file."""
    why = f"{name}: another file of {image_id} was made later and is used instead"
    return Outcome.now(name, (why,))


def _rank(entry: ImageEntry) -> tuple[str, str]:
    """Order of the files of one image: by time of production, else by content."""
    return entry.created or "", entry.ref.digest


def _write_browse(draft: Path, image: ReadImage) -> None:
    params = BrowseParams()
    stretched = stretch(image.pixels, image.mask, params.low_percent, params.high_percent)
    encoded, png = cv2.imencode(".png", stretched)
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


Taken = Outcome | ProductRef | TakenImage
"""Result of a file: an error, a vector file or manual ties, or an image in the store."""


@dataclass(frozen=True, slots=True, eq=False)
class Delivery:
    """Content of a downlink after ingestion."""

    images: tuple[RoverImage, ...]
    faults: tuple[Outcome, ...]
    """Files that could not be ingested or are not used, with the reason."""
    files: int
    missions: tuple[str, ...]
    """Missions of its images, in the order of ingestion, then those of its vector files."""


@stage(task_run_name="ingest-{downlink}", makes_products=False)
def ingest_downlink(
    downlink: Path,
    workspace: Workspace,
    radiometry: Mapping[str, Radiometry] | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
    settle_s: float = 0.0,
    poses: PoseSources | None = None,
) -> Delivery:
    """Ingest every image and vector file below a folder into the store and catalogue.

    Images of earlier downlinks are read again where `radiometry` (by spacecraft) has changed for
    them. Files that changed less than `settle_s` seconds ago are skipped: they may still be
    arriving. Images whose labels lack the attitude of the rover get it from `poses` and vector
    files.
    """
    files = [file for file in files_of(downlink) if is_settled(file, settle_s)]
    rigs = rig_images(files, downlink)
    files = [file for file in files if file not in rigs.unusable]
    known = {entry.id: entry for entry in workspace.catalogue.images()}
    poses = poses or PoseSources()
    intake = Intake(workspace.store, radiometry or {}, known, rigs, poses)
    subjects = _subjects([*files, *(file for file in rigs.faults if file not in files)], downlink)
    taken: list[Taken] = [
        _fault(subjects[file], LabelError(why)) for file, why in rigs.faults.items()
    ]
    files = [file for file in files if file not in rigs.faults]
    vectors = [file for file in files if file.suffix.lower() in VECTOR_SUFFIXES]
    images_of = [file for file in files if file not in vectors]
    with ThreadPoolExecutor(2) as pool:
        for some in (vectors, images_of):
            taking = pool.map(partial(_take, subjects, downlink, intake), some)
            for one in taking:
                taken.append(one)
                progress(len(taken), len(files))
            brought = [one for one in taken if isinstance(one, ProductRef)]
            intake = replace(intake, poses=poses.beside(brought, workspace))
    images, aside = newest_of_each([one for one in taken if isinstance(one, TakenImage)])
    faults = [*(one for one in taken if isinstance(one, Outcome)), *aside]
    reread = list(_reread(intake, {image.record.id for image in images}))
    delivered = list(images)
    images += [one for one in reread if isinstance(one, TakenImage)]
    faults += [one for one in reread if isinstance(one, Outcome)]
    kept = [one for one in taken if isinstance(one, ProductRef)]
    refused = _publish(images, kept, faults, workspace)
    records = tuple(one.record for one in delivered if one.file_name not in refused)
    missions = [record.stop.mission for record in records]
    missions += [
        mission_id(read_vector_file(ref, workspace).mission)
        for ref in kept
        if ref.kind is ProductKind.VECTORS
    ]
    return Delivery(
        records, (*faults, *refused.values()), len(files), tuple(dict.fromkeys(missions))
    )


def _subjects(files: Sequence[Path], downlink: Path) -> dict[Path, str]:
    """Subjects of the files' outcomes: file names, with folders if several files have one name."""
    times = Counter(file.name for file in files)
    return {
        file: plain_name(str(file.relative_to(downlink)) if times[file.name] > 1 else file.name)
        for file in files
    }


def _take(subjects: Mapping[Path, str], downlink: Path, intake: Intake, path: Path) -> Taken:
    """Ingest a file; an error is returned as its outcome, unless it concerns the store.

    Raises:
        StoreFullError, StoreAwayError: the store is full or does not respond.
    """
    name, subject = plain_name(path.name), subjects[path]
    try:
        taken = retry_transient(lambda: _take_file(path, name, downlink, intake))
    except (StoreFullError, StoreAwayError):
        raise
    except Exception as error:
        if is_disk_full(intake.store.root, error):
            raise StoreFullError(
                f"the disk is full while ingesting {subject}; free some space and run again"
            ) from error
        return _fault(subject, error)
    return replace(taken, file_name=subject) if isinstance(taken, TakenImage) else taken


def _take_file(path: Path, name: str, downlink: Path, intake: Intake) -> Taken:
    if path.is_dir() and not path.is_symlink():
        os.scandir(path).close()  # raises an error if the folder cannot be read
    if path.suffix.lower() in VECTOR_SUFFIXES:
        data = read_user_file(path, downlink, most_bytes=MAX_ROWS_BYTES)
        # raises an error for broken files
        parse_vector_file(data.decode("utf-8", "replace"), name)
        return keep_vector_file(name, data, intake.store)
    if is_manual_tie_file(path.name):
        data = read_user_file(path, downlink, most_bytes=MAX_ROWS_BYTES)
        return take_manual_ties(name, data, intake.store)
    with _in_turn(path.stat().st_size > LARGE_BYTES):
        if path in intake.rigs.shots:
            return intake.take_rig_image(path, name, read_user_file(path, downlink))
        return intake.take(name, image_bytes(path, downlink))


def _reread(intake: Intake, delivered: set[str]) -> Iterator[Taken]:
    """Ingest the images of earlier downlinks again whose tables have changed."""
    for entry in intake.known.values():
        if entry.id in delivered or not intake.is_read_otherwise(entry):
            continue
        name = f"{entry.id}.IMG"
        try:
            yield intake.take(name, intake.store.path(entry.ref).read_bytes())
        except (PhotogrammetryError, OSError) as error:
            yield _fault(name, error)


def _fault(name: str, error: Exception) -> Outcome:
    """Outcome of a file that could not be ingested: name and error in one line."""
    reason = reason_of(error) if isinstance(error, OSError) else cause_of(error)
    if not isinstance(error, PhotogrammetryError | ProductError | OSError):
        log.debug("%s could not be ingested", name, exc_info=error)
    line = one_line(reason if name in reason else f"{name}: {reason}")
    help_with = remedy(name) if isinstance(error, LabelError | PixelError) else ""
    if help_with and "`solmap " not in line:
        line = f"{line}; {help_with}"
    return Outcome.now(name, (line,), is_failure=True)


def _publish(
    images: Sequence[TakenImage],
    pointers: Sequence[ProductRef],
    faults: Sequence[Outcome],
    workspace: Workspace,
) -> dict[str, Outcome]:
    """Publish all images, or, if that fails, those that the catalogue accepts.

    Returns:
        Outcomes of the rejected files, by name.
    """
    catalogue, refused = workspace.catalogue, dict[str, Outcome]()
    entries = _pair_entries(images, workspace)
    outcomes = [*faults, *_outcomes(images, workspace)]
    try:
        catalogue.publish(images=entries, pointers=pointers, outcomes=outcomes)
    except Exception as error:
        if is_transient(error) or isinstance(error, ProductError):
            raise
    else:
        return refused
    for image in images:
        try:
            catalogue.publish(images=[image.entry])
        except Exception as error:
            if is_transient(error):
                raise
            refused[image.file_name] = _fault(image.file_name, error)
    kept = [image for image in images if image.file_name not in refused]
    catalogue.publish(
        images=_pair_entries(kept, workspace),
        pointers=pointers,
        outcomes=[*faults, *_outcomes(kept, workspace), *refused.values()],
    )
    return refused


def _outcomes(images: Sequence[TakenImage], workspace: Workspace) -> list[Outcome]:
    """Outcomes of images with notes, and of those that could not be ingested before."""
    before = {outcome.subject for outcome in workspace.catalogue.outcomes()}
    return [
        Outcome.now(image.file_name, image.entry.notes)
        for image in images
        if image.entry.notes or image.file_name in before
    ]


def _pair_entries(images: Sequence[TakenImage], workspace: Workspace) -> list[ImageEntry]:
    """The new entries and the known ones at the same stops, with their partners set."""
    by_id = {image.record.id: image.entry for image in images}
    records = {image.record.id: image.record for image in images}
    for stop in sorted({entry.stop for entry in by_id.values()}):
        others = [e for e in workspace.catalogue.images(stop=stop) if e.id not in by_id]
        for known in others:
            try:
                records[known.id] = image_record(known, workspace)
            except (PhotogrammetryError, ProductNotFoundError) as error:
                log.warning("%s is unchanged: %s", known.id, error)
            else:
                by_id[known.id] = known
    pairing = find_stereo_pairs(list(records.values()))
    partners = {pair.left.id: pair.right.id for pair in pairing.pairs}
    partners |= {right: left for left, right in partners.items()}
    return [
        replace(
            entry,
            partner=partners.get(entry.id),
            unpaired_because=pairing.unpaired.get(entry.id),
            repeats=pairing.repeats.get(entry.id),
        )
        for entry in by_id.values()
    ]
