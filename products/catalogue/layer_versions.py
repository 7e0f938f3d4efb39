"""The versions of a layer, and the network solution that each is made from.

Published versions are kept, so earlier ones can be viewed and compared. The recipe of a map
contains the orientations of its pairs and no network: the map belongs to the solutions with equal
orientations of those pairs. A product of several maps belongs to the solutions common to all of
them; a product of a network names it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import sqlalchemy as sa

from solmap.products.catalogue.catalogue import Catalogue, layer_of, published_networks
from solmap.products.catalogue.database import LAYERS
from solmap.products.formats.documents.network import References, references_of_document
from solmap.products.model import Layer, ProductKind, ProductRef, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from solmap.products.store.provenance import orientation_records

PairOrientations = frozenset[tuple[str, tuple[float, ...], tuple[float, ...]]]
"""Pairs with rotation and translation."""


@dataclass(frozen=True, slots=True)
class _Origin:
    """Networks, orientations and maps in the recipe of a product."""

    networks: tuple[ProductRef, ...]
    oriented: PairOrientations
    maps: tuple[ProductRef, ...]


@dataclass(frozen=True, slots=True)
class Solution:
    """A network, and the orientations with which stops were mapped since."""

    network: ProductRef
    made_at: str
    oriented: tuple[PairOrientations, ...]
    """Orientations by stop, for the first of the network's stops."""

    def has(self, orientations: PairOrientations) -> bool:
        """Whether stops were mapped with all of these orientations."""
        missing = set(orientations)
        for of_stop in self.oriented:
            if not of_stop.isdisjoint(missing):
                missing -= of_stop
            if not missing:
                return True
        return False


def versions_of(scope: str, kind: ProductKind, catalogue: Catalogue) -> list[Layer]:
    """All published versions of a layer, newest first; empty if never published."""
    query = sa.select(LAYERS.c.document).where(LAYERS.c.scope == scope, LAYERS.c.kind == str(kind))
    with catalogue.engine.connect() as connection:
        layers = [layer_of(row[0]) for row in connection.execute(query)]
    latest = catalogue.latest(scope, kind)
    layers.sort(key=lambda one: (one.made_at, one.ref.digest == latest), reverse=True)
    return layers


def solutions_of_mission(mission: str, catalogue: Catalogue, store: ProductStore) -> list[Solution]:
    """All solutions of a mission with maps or figures made from them, oldest first."""
    found = [
        _solution(ref, tuple(store.versions(ProductKind.ORIENTATIONS, ref.scope)), store)
        for published in published_networks(mission, catalogue)
        for ref in store.versions(ProductKind.NETWORK, published.scope)
    ]
    return sorted(found, key=lambda one: (one.made_at, one.network))


def solutions_behind(
    ref: ProductRef, solutions: list[Solution], store: ProductStore
) -> list[ProductRef]:
    """The networks for which a product is valid, its own first; empty if unknown."""
    origin = _origin(ref, store)
    if origin.networks:
        return list(origin.networks)
    if origin.oriented:
        return [one.network for one in solutions if one.has(origin.oriented)]
    behind = [solutions_behind(one, solutions, store) for one in origin.maps if store.has(one)]
    if not behind:
        return []
    return [ref for ref in behind[0] if all(ref in others for others in behind)]


@lru_cache(maxsize=1024)
def _solution(
    network: ProductRef, orientations: tuple[ProductRef, ...], store: ProductStore
) -> Solution:
    oriented: list[PairOrientations] = []
    for ref in orientations:
        if network in _inputs(store.provenance(ref)["recipe"]):
            own, holders = _orientations_by_stop(ref, store)
            oriented += own.values()
            oriented += [
                _orientations_by_stop(holder, store)[0][stop] for stop, holder in holders.items()
            ]
    return Solution(network, store.made_at(network), tuple(oriented))


@lru_cache(maxsize=2048)
def _orientations_by_stop(
    ref: ProductRef, store: ProductStore
) -> tuple[dict[str, PairOrientations], References]:
    """What `tasks.orientations` chose, by stop, and the products that hold the other stops."""
    document = json.loads(store.path(ref).read_text())
    # as written by earlier versions
    rows = document["mapped"] if isinstance(document, dict) else document
    holders = references_of_document(document["holders"]) if isinstance(document, dict) else {}
    own = {row["stop"]: frozenset(_pose(one) for one in row["orientations"]) for row in rows}
    return own, holders


@lru_cache(maxsize=4096)
def _origin(ref: ProductRef, store: ProductStore) -> _Origin:
    recipe = store.provenance(ref)["recipe"]
    inputs = _inputs(recipe)
    maps = (ProductKind.DTM, ProductKind.FAR_DTM, ProductKind.REGION_DTM)
    return _Origin(
        tuple(one for one in inputs if one.kind is ProductKind.NETWORK),
        frozenset(_pose(one) for one in orientation_records(recipe["params"])),
        tuple(one for one in inputs if one.kind in maps),
    )


def _inputs(recipe: dict[str, Any]) -> list[ProductRef]:
    """The inputs of a recipe; a map's stop has the right level, which paths do not need."""
    split = (text.split("/") for text in recipe["inputs"])
    return [
        ProductRef(kind, Scope(kind.level or ScopeLevel.STOP, scope), digest)
        for kind, scope, digest in ((ProductKind(k), s, d) for k, s, d in split)
    ]


def _pose(record: dict[str, Any]) -> tuple[str, tuple[float, ...], tuple[float, ...]]:
    return record["pair_id"], tuple(record["rotation"]), tuple(record["translation_m"])
