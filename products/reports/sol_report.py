"""What is known of a sol, gathered for its report: images, pairs, links, adjustment, layers, times.

Everything is read from the catalogue and from provenance; nothing is computed anew, so a report can
be asked for at any time.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.catalogue_records import Outcome
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.formats.documents.archives import read_matches
from solmap.products.model import Layer, ProductKind, ProductRef

THUMBNAIL_PX = 128
MOST_THUMBNAILS = 150
_STAGES = (ProductKind.MATCHES, ProductKind.PARALLAX)
_OF_NETWORK = (ProductKind.NETWORK, ProductKind.QUALITY, ProductKind.REPORT)


@dataclass(frozen=True, slots=True)
class SolPair:
    """A stereo pair that was matched."""

    left: str
    right: str
    points: int
    ref: ProductRef


@dataclass(frozen=True, slots=True)
class Timing:
    """What the products of a kind took, all together; of some the processor's time is not known."""

    kind: str
    count: int
    seconds: float
    cpu_s: float | None
    peak_rss_mb: float | None


@dataclass(frozen=True, slots=True)
class SolFacts:
    """A sol as its report shows it."""

    mission: str
    sol: int
    images: list[ImageEntry]
    pairs: list[SolPair]
    links: list[dict[str, Any]]
    quality: dict[str, Any] | None
    report: ProductRef | None
    network: dict[str, Any] | None
    """Provenance of the network."""
    layers: list[Layer]
    outcomes: list[Outcome]
    timings: list[Timing]

    @property
    def unpaired(self) -> list[ImageEntry]:
        """Images without a partner."""
        return [image for image in self.images if image.partner is None]

    @property
    def failures(self) -> list[str]:
        """What went wrong."""
        failed = (outcome for outcome in self.outcomes if outcome.is_failure)
        return [f"{one.subject}: {note}" for one in failed for note in one.notes]

    @property
    def notes(self) -> list[str]:
        """What was said without anything being wrong."""
        well = (outcome for outcome in self.outcomes if not outcome.is_failure)
        return [f"{one.subject}: {note}" for one in well for note in one.notes]


def sol_facts(mission: str, sol: int, workspace: Workspace) -> SolFacts:
    """Gather what the store knows of a sol.

    Raises:
        ProductNotFoundError: it has no image of that sol.
    """
    catalogue = workspace.catalogue
    name = catalogue.mission(mission).mission
    images = catalogue.images(name, sol=sol)
    if not images:
        known = sorted({image.sol for image in catalogue.images(name)})
        few = ", ".join(map(str, known[-5:])) or "none"
        raise ProductNotFoundError(f"{name} has no image of sol {sol}; the last sols are {few}")
    subject = f"{name.lower()}-sol{sol:04d}"
    adjusted = {kind: _latest(kind, subject, workspace) for kind in _OF_NETWORK}
    stops = {image.stop for image in images}
    layers = [layer for layer in catalogue.layers(name) if sol in layer.sols]
    made = list(_made(images, layers, workspace))
    made += [ref for ref in adjusted.values() if ref is not None]
    names = {image.id.lower() for image in images}
    return SolFacts(
        mission=name,
        sol=sol,
        images=images,
        pairs=list(_pairs(images, workspace)),
        links=_links(adjusted[ProductKind.NETWORK], stops, workspace),
        quality=_document(adjusted[ProductKind.QUALITY], workspace),
        report=adjusted[ProductKind.REPORT],
        network=_provenance(adjusted[ProductKind.NETWORK], workspace),
        layers=layers,
        outcomes=[one for one in catalogue.outcomes() if _concerns(one.subject, subject, names)],
        timings=timings(made, workspace),
    )


def timings(refs: list[ProductRef], workspace: Workspace) -> list[Timing]:
    """What some products took, kind by kind, the longest first."""
    found: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for ref in dict.fromkeys(refs):
        document = _provenance(ref, workspace)
        if document is not None:
            found[str(ref.kind)].append(document)
    rows = [_timing(kind, documents) for kind, documents in found.items()]
    return sorted(rows, key=lambda row: -row.seconds)


def thumbnail(image: ImageEntry, workspace: Workspace) -> bytes | None:
    """A small JPEG of an image, or None where its picture is gone."""
    try:
        picture = cv2.imread(str(workspace.store.path(image.browse)), cv2.IMREAD_GRAYSCALE)
    except ProductError:
        return None
    if picture is None:
        return None
    scale = THUMBNAIL_PX / max(picture.shape)
    size = tuple(int(max(1, round(side * scale))) for side in picture.shape[::-1])
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])[1])


def _timing(kind: str, documents: list[dict[str, Any]]) -> Timing:
    known = [document for document in documents if "cpu_s" in document]
    whole = len(known) == len(documents)
    return Timing(
        kind,
        len(documents),
        float(np.sum([document["seconds"] for document in documents])),
        float(np.sum([document["cpu_s"] for document in known])) if whole else None,
        max((document["peak_rss_mb"] for document in known), default=None),
    )


def _made(
    images: list[ImageEntry], layers: list[Layer], workspace: Workspace
) -> Iterator[ProductRef]:
    for image in images:
        yield from (image.ref, image.browse)
    names = {image.id.lower() for image in images}
    for kind in _STAGES:
        yield from (ref for ref in workspace.catalogue.pointers(kind) if ref.scope.name in names)
    yield from (layer.ref for layer in layers)


def _pairs(images: list[ImageEntry], workspace: Workspace) -> Iterator[SolPair]:
    matches = {ref.scope.name: ref for ref in workspace.catalogue.pointers(ProductKind.MATCHES)}
    for image in images:
        ref = matches.get(image.id.lower())
        if ref is None or image.partner is None:
            continue
        try:
            _, points = read_matches(workspace.store.path(ref))
        except ProductError:
            continue
        yield SolPair(image.id, image.partner, len(points), ref)


def _links(
    network: ProductRef | None, stops: set[str], workspace: Workspace
) -> list[dict[str, Any]]:
    document = _document(network, workspace) or {}
    links = document.get("links", ())
    return [link for link in links if {link["earlier"], link["later"]} & stops]


def _latest(kind: ProductKind, subject: str, workspace: Workspace) -> ProductRef | None:
    digest = workspace.catalogue.latest(subject, kind)
    found = (ref for ref in workspace.catalogue.pointers(kind) if ref.scope.name == subject)
    return next(found, None) if digest else None


def _document(ref: ProductRef | None, workspace: Workspace) -> dict[str, Any] | None:
    if ref is None:
        return None
    try:
        return json.loads(workspace.store.path(ref).read_text(encoding="utf-8"))
    except ProductError:
        return None


def _provenance(ref: ProductRef | None, workspace: Workspace) -> dict[str, Any] | None:
    if ref is None:
        return None
    try:
        return workspace.store.provenance(ref)
    except ProductError:
        return None


def _concerns(subject: str, of_sol: str, names: set[str]) -> bool:
    """Outcomes of the sol, of its overall adjustment, and of its files."""
    plain = subject.rpartition("/")[2].lower().partition(".")[0]
    return subject in {of_sol, f"{of_sol}-overall"} or plain in names


def why_unpaired(images: list[ImageEntry]) -> list[tuple[str, int]]:
    """Reasons, and of how many images."""
    return Counter(image.unpaired_because or "no reason is known" for image in images).most_common()
