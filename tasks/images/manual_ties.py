"""Manual ties: edit requests, kept as they came and applied to the automatic ties of a network.

A file of manual ties is an input product. The version delivered last under a name counts; an
emptied file takes all its requests back. What a network depends on is not the file but the requests
in it that concern its images, so that a new row remakes what it touches and nothing else.
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
    read_matches,
    read_parallax,
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
"""The file of manual ties that the edits on the map become."""


def take_manual_ties(name: str, data: bytes, store: ProductStore) -> ProductRef:
    """Take a file of manual ties into the store.

    Raises:
        MatchingError: it cannot be read; one line says where and why.
    """
    read_edit_requests(data, name)  # refuses what is broken
    return keep_file(ProductKind.MANUAL_TIES, name, data, store)


def read_edit_requests(data: bytes, name: str) -> tuple[EditRequest, ...]:
    """The rows of a file of manual ties."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise MatchingError(f"{name}: manual ties are text in UTF-8, but {error}") from error
    return parse_edit_requests(text, name)


def take_edits(workspace: Workspace) -> None:
    """Take the edits of ties that people made on the map into the store, as a file of manual ties.

    Edits that were taken back are not in it; where all were, it is empty and asks for nothing.
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
        except MatchingError as error:  # an earlier version took it
            log.warning("%s is left out: %s", ref.scope, error)
    return tuple(found)


def named_in(requests: Iterable[EditRequest]) -> set[str]:
    """The images and stops that requests name."""
    points = (point for request in requests for point in (request.first, request.second))
    return {point.image for point in points if point.image}


def requests_within(
    requests: Iterable[EditRequest], known: Collection[str]
) -> tuple[EditRequest, ...]:
    """The requests whose images and stops are all `known`."""
    return tuple(request for request in requests if named_in([request]) <= set(known))


def without_rows(requests: Iterable[EditRequest]) -> tuple[EditRequest, ...]:
    """Requests without where they stand, for recipes: the row of a file changes nothing."""
    return tuple(replace(request, row="") for request in requests)


def edit_ties(
    requests: Sequence[EditRequest],
    ties: Sequence[Ties],
    pairs: Sequence[PairProducts],
    store: ProductStore,
) -> EditedTies:
    """Automatic ties between pairs with the requests of a person carried out."""
    named = named_in(requests)
    bodies = {pair.files.id: _body(pair, store) for pair in pairs if pair.files.id in named}
    return apply_edits(ties, requests, bodies, {p.files.id: str(p.files.stop) for p in pairs})


def _body(pair: PairProducts, store: ProductStore) -> ManualImage:
    """A pair with the cameras of its original images."""
    path = store.path(pair.matches)
    geometry: EpipolarPair = read_matches(path)[0]
    left, right = read_pair(pair.files, store)
    turned = turn_right_camera(right, read_right_turn(path))
    parallax = read_parallax(store.path(pair.parallax))
    return ManualImage(pair.files.id, geometry, left.image.camera, turned.image.camera, parallax)
