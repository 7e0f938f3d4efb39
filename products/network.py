"""The adjusted network of a mission as a product, read back."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from photogrammetry.adjustment.documents import network_of_document
from photogrammetry.adjustment.records import AdjustedNetwork
from photogrammetry.body_fixed import map_from_lsl
from photogrammetry.frames import Pose
from photogrammetry.imagery import StopId
from photogrammetry.traverse.records import Traverse
from products.arrays import pose_of_document
from products.catalogue import Catalogue
from products.errors import ProductNotFoundError
from products.model import ProductKind, ProductRef
from products.store import ProductStore

_NETWORKS = 4
"""Networks that are remembered; a large one takes seconds to read."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkProduct:
    """The network of a mission after a sol, as the store keeps it."""

    mission: str
    sol: int
    telemetry: dict[StopId, Pose]
    sols: dict[StopId, tuple[int, ...]]
    adjusted: AdjustedNetwork
    reports: tuple[str, ...]
    """One line for every sol's adjustment."""
    links: tuple[dict[str, Any], ...]
    """What came of every pair of stops that was tried, this sol."""
    report: dict[str, Any]
    """The report of this network's own adjustment."""
    by_hand: tuple[str, ...] = ()
    """What became of the hand ties, line by line."""


def read_network(ref: ProductRef, store: ProductStore) -> NetworkProduct:
    """The network of a sol."""
    document = json.loads(store.path(ref).read_text())
    stops = {_stop_of(row): row for row in document["stops"]}
    return NetworkProduct(
        mission=document["mission"],
        sol=document["sol"],
        telemetry={stop: pose_of_document(row["telemetry"]) for stop, row in stops.items()},
        sols={stop: tuple(row["sols"]) for stop, row in stops.items()},
        adjusted=network_of_document(document["network"]),
        reports=tuple(document["reports"]),
        links=tuple(document["links"]),
        report=document["network"]["reports"][-1],
        by_hand=tuple(document.get("by_hand", ())),
    )


@lru_cache(maxsize=_NETWORKS)
def network_of(ref: ProductRef, store: ProductStore) -> NetworkProduct:
    """A network, remembered: a product never changes."""
    return read_network(ref, store)


def published_networks(mission: str, catalogue: Catalogue) -> list[ProductRef]:
    """The published networks of a mission, the latest last.

    Names sort by sol, an overall adjustment after that of its sol.
    """
    prefix = f"{mission.lower()}-sol"
    refs = [r for r in catalogue.pointers(ProductKind.NETWORK) if r.scope.name.startswith(prefix)]
    return sorted(refs, key=lambda ref: ref.scope.name)


def latest_network(mission: str, catalogue: Catalogue) -> ProductRef:
    """The network of a mission that was published last.

    Raises:
        ProductNotFoundError: there is none.
    """
    refs = published_networks(mission, catalogue)
    if not refs:
        raise ProductNotFoundError(
            f"no network of {mission} has been adjusted yet, so no image has a place; run a sol"
        )
    return refs[-1]


def traverses(product: NetworkProduct) -> tuple[Traverse, Traverse]:
    """The traverse of a network by telemetry, and as adjusted."""
    stops = product.adjusted.stops
    names = tuple(f"{stop.stop.site}/{stop.stop.drive}" for stop in stops)
    sols = np.array([min(product.sols[stop.stop]) for stop in stops], dtype=np.int32)
    told = np.array([product.telemetry[stop.stop].translation_m for stop in stops])
    true = np.array([stop.lsl_from_rover.translation_m for stop in stops])
    return (
        Traverse("telemetry", names, sols, map_from_lsl(told)),
        Traverse("adjusted", names, sols, map_from_lsl(true)),
    )


def _stop_of(row: dict[str, Any]) -> StopId:
    return StopId(row["mission"], row["site"], row["drive"])
