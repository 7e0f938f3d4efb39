"""Ingest: take over the files of a downlink, say what each is, and find the stereo partners.

An image product is the file as it came, byte for byte, under the digest of its content; whoever
needs its label or pixels reads them from there. Where the label is a file of its own (.lbl, .xml or
.json beside the image), the product holds both, one after the other, each unchanged. A file that
cannot be read is an outcome with one clear line, and stops nothing else; what is peculiar about the
pixels of one that can is kept in its outcome, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from solmap.photogrammetry.archive.images.radiometry import Radiometry
from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.archive.tables.vector_files import parse_vector_file
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.imagery import RoverImage
from solmap.products.catalogue.catalogue import ImageEntry, Outcome
from solmap.products.catalogue.images import image_record
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef
from solmap.products.store.faults import retry_transient
from solmap.tasks.downlink_files import (
    VECTOR_SUFFIXES,
    file_bytes,
    files_of,
    image_bytes,
    is_settled,
)
from solmap.tasks.hand_ties import is_hand_ties, take_hand_ties
from solmap.tasks.intake import Intake, TakenImage, keep_file, one_of_each
from solmap.tasks.stage import stage

Taken = Outcome | ProductRef | TakenImage
"""What became of a file: a fault, a vector file or hand ties, or an image in the store."""


@dataclass(frozen=True, slots=True, eq=False)
class Delivery:
    """What a downlink brought."""

    images: tuple[RoverImage, ...]
    faults: tuple[Outcome, ...]
    """Files that could not be taken or do not count, and why."""
    files: int

    @property
    def missions(self) -> tuple[str, ...]:
        """The missions of its images, in the order they came."""
        return tuple(dict.fromkeys(image.stop.mission for image in self.images))


@stage(task_run_name="ingest-{downlink}")
def ingest_downlink(
    downlink: Path,
    workspace: Workspace,
    radiometry: Mapping[str, Radiometry] | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
    settle_s: float = 0.0,
) -> Delivery:
    """Take every image and vector file below a folder into the store and catalogue.

    Images of earlier downlinks are read again where `radiometry` (by spacecraft) has changed for
    them. Files that changed less than `settle_s` seconds ago are left: they may still be arriving.
    """
    files = [file for file in files_of(downlink) if is_settled(file, settle_s)]
    known = {entry.id: entry for entry in workspace.catalogue.images()}
    intake = Intake(workspace.store, radiometry or {}, known)
    taken: list[Taken] = []
    with ThreadPoolExecutor(2) as pool:
        for done, one in enumerate(pool.map(lambda file: _take(file, intake), files), 1):
            progress(done, len(files))
            taken.append(one)
    images, aside = one_of_each([one for one in taken if isinstance(one, TakenImage)])
    faults = [*(one for one in taken if isinstance(one, Outcome)), *aside]
    delivered = tuple(image.record for image in images)
    anew = list(_read_anew(intake, {image.id for image in delivered}))
    images += [one for one in anew if isinstance(one, TakenImage)]
    faults += [one for one in anew if isinstance(one, Outcome)]
    workspace.catalogue.publish(
        images=_paired(images, workspace),
        pointers=[one for one in taken if isinstance(one, ProductRef)],
        outcomes=[*faults, *_outcomes(images, workspace)],
    )
    return Delivery(delivered, tuple(faults), len(files))


def _take(path: Path, intake: Intake) -> Taken:
    try:
        return retry_transient(lambda: _taken(path, intake))
    except (PhotogrammetryError, OSError) as error:
        return _fault(path.name, str(error))


def _taken(path: Path, intake: Intake) -> Taken:
    if path.suffix.lower() in VECTOR_SUFFIXES:
        return _take_vectors(path, intake)
    if is_hand_ties(path.name):
        return take_hand_ties(path.name, file_bytes(path), intake.store)
    return intake.take(path.name, image_bytes(path))


def _read_anew(intake: Intake, delivered: set[str]) -> Iterator[Taken]:
    """The images of earlier downlinks that are read with other tables now."""
    for entry in intake.known.values():
        if entry.id in delivered or not intake.is_read_otherwise(entry):
            continue
        name = f"{entry.id}.IMG"
        try:
            yield intake.take(name, intake.store.path(entry.ref).read_bytes())
        except (PhotogrammetryError, OSError) as error:
            yield _fault(name, str(error))


def _fault(name: str, reason: str) -> Outcome:
    reason = reason if name in reason else f"{name}: {reason}"
    return Outcome.now(name, (reason,), is_failure=True)


def _outcomes(images: Sequence[TakenImage], workspace: Workspace) -> list[Outcome]:
    """Of images with peculiar pixels, and of those that could not be taken at an earlier time."""
    before = {outcome.subject for outcome in workspace.catalogue.outcomes()}
    return [
        Outcome.now(image.file_name, image.entry.notes)
        for image in images
        if image.entry.notes or image.file_name in before
    ]


def _take_vectors(path: Path, intake: Intake) -> ProductRef:
    data = file_bytes(path)
    parse_vector_file(data.decode("utf-8", "replace"), path.name)  # refuses what is broken
    return keep_file(ProductKind.VECTORS, path.name, data, intake.store)


def _paired(images: Sequence[TakenImage], workspace: Workspace) -> list[ImageEntry]:
    """The new entries and those already known at the same stops, with their partners filled in."""
    by_id = {image.record.id: image.entry for image in images}
    records = {image.record.id: image.record for image in images}
    for stop in sorted({entry.stop for entry in by_id.values()}):
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
