"""Manual ties: edit requests, stored unchanged and applied to the automatic ties of a network.

A file of manual ties is an input product. The version delivered last under a name is used; an empty
file withdraws all its requests. A network depends not on the file but on the requests for its
images, so that a new row affects only the networks of its images.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.manual.editing import (
    EditedTies,
    EditRequest,
    ManualImage,
    apply_edits,
)
from solmap.photogrammetry.matching.records import Ties
from solmap.products.catalogue.edits import EditKind, EditLog
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.archives import (
    StoredParallax,
    read_matches,
    read_right_turn,
)
from solmap.products.formats.documents.edit_requests import parse_edit_requests
from solmap.products.model import ProductKind, ProductRef
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.files import keep_file
from solmap.tasks.images.pairs import PairProducts, read_pair, turn_right_camera
from solmap.tasks.scopes import file_scope

log = logging.getLogger(__name__)
EDITS_FILE = "map-edits.ties.geojson"
"""File name of the manual ties from edits on the map."""


def take_manual_ties(name: str, data: bytes, store: ProductStore) -> ProductRef:
    """Ingest a file of manual ties into the store.

    Raises:
        MatchingError: it cannot be read; the message names the place and the reason.
    """
    read_edit_requests(data, name)  # raises an error for broken files
    return keep_file(ProductKind.MANUAL_TIES, name, data, store)


def read_edit_requests(data: bytes, name: str) -> tuple[EditRequest, ...]:
    """The rows of a file of manual ties."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise MatchingError(f"{name}: manual ties should be UTF-8 text, but {error}") from error
    return parse_edit_requests(text, name)


def take_edits(workspace: Workspace) -> None:
    """Store the edits of ties made on the map as a file of manual ties.

    Undone edits are not included; if all were undone, the file is empty and has no requests.
    """
    edits = EditLog.of(workspace.store.root).effective(EditKind.TIE)
    digest = workspace.catalogue.latest(file_scope(EDITS_FILE).name, ProductKind.MANUAL_TIES)
    if not edits and digest is None:
        return
    rows = [{"properties": {**edit.document, "note": edit.note}} for edit in edits]
    document = {"type": "FeatureCollection", "features": rows}
    ref = take_manual_ties(EDITS_FILE, json.dumps(document).encode(), workspace.store)
    workspace.catalogue.publish(pointers=[ref])


def all_edit_requests(workspace: Workspace) -> tuple[EditRequest, ...]:
    """The rows of all files of manual ties, file by file."""
    found: list[EditRequest] = []
    for ref in workspace.catalogue.pointers(ProductKind.MANUAL_TIES):
        data = workspace.store.path(ref).read_bytes()
        try:
            found += read_edit_requests(data, ref.scope.name)
        except MatchingError as error:  # stored by an earlier version
            log.warning("%s is left out: %s", ref.scope, error)
    return tuple(found)


def named_in(requests: Iterable[EditRequest]) -> set[str]:
    """The images and stops named in requests."""
    points = (point for request in requests for point in (request.first, request.second))
    return {point.image for point in points if point.image}


def requests_within(
    requests: Iterable[EditRequest], known: Collection[str]
) -> tuple[EditRequest, ...]:
    """The requests whose images and stops are all `known`."""
    return tuple(request for request in requests if named_in([request]) <= set(known))


def without_rows(requests: Iterable[EditRequest]) -> tuple[EditRequest, ...]:
    """Requests without their source rows, for recipes: the row number changes nothing."""
    return tuple(replace(request, row="") for request in requests)


def edit_ties(
    requests: Sequence[EditRequest],
    ties: Sequence[Ties],
    pairs: Sequence[PairProducts],
    store: ProductStore,
) -> EditedTies:
    """Automatic ties between pairs with edit requests applied."""
    named = named_in(requests)
    bodies = {pair.files.id: _body(pair, store) for pair in pairs if pair.files.id in named}
    return apply_edits(ties, requests, bodies, {p.files.id: str(p.files.stop) for p in pairs})


def _body(pair: PairProducts, store: ProductStore) -> ManualImage:
    """A pair with the cameras of its original images."""
    path = store.path(pair.matches)
    geometry: EpipolarPair = read_matches(path)[0]
    left, right = read_pair(pair.files, store)
    turned = turn_right_camera(right, read_right_turn(path))
    parallax_px = StoredParallax.read(store.path(pair.parallax)).parallax_px()
    return ManualImage(pair.files.id, geometry, left.image.camera, turned.image.camera, parallax_px)
