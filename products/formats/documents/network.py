"""The adjusted network of a mission as a product, read back.

The network of a sol contains the stops that its step changed. All others are in earlier products:
one for each marginalised stop, or an overall adjustment. The network of the sol refers to these
products, stop by stop, so it does not grow with the traverse.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedMast, AdjustedNetwork
from solmap.photogrammetry.adjustment.model.assembly import assemble, part_at
from solmap.photogrammetry.adjustment.model.variance_components import VarianceComponents
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.mars import map_from_lsl
from solmap.photogrammetry.traverse.records import Traverse
from solmap.products.formats.documents.adjusted_network import (
    network_document,
    network_of_document,
)
from solmap.products.formats.documents.archives import pose_document, pose_of_document
from solmap.products.model import ProductRef
from solmap.products.store.product_store import ProductStore

References = dict[str, ProductRef]
"""The product that contains a stop, by the name of the stop."""


def references_document(references: Mapping[str, ProductRef]) -> dict[str, str]:
    """References as plain JSON, in the order of the stops."""
    return {name: ref.text for name, ref in sorted(references.items())}


def references_of_document(document: Mapping[str, str]) -> References:
    """The inverse of `references_document`."""
    return {name: ProductRef.of_text(text) for name, text in document.items()}


_NETWORKS = 4
"""Whole networks kept in memory; a large one takes seconds to read."""
_PARTS = 2
"""Networks of sols kept in memory: that of a sol, and the previous one."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkPart:
    """Some stops of a network, with their poses and times by telemetry."""

    telemetry: dict[StopId, Pose]
    sols: dict[StopId, tuple[int, ...]]
    adjusted: AdjustedNetwork

    def at(self, stops: Collection[StopId]) -> NetworkPart:
        """The part at some stops, with all ties that their pairs see."""
        adjusted = part_at(self.adjusted, frozenset(stops))
        inside = [stop.stop for stop in adjusted.stops]
        return NetworkPart(
            {stop: self.telemetry[stop] for stop in inside},
            {stop: self.sols[stop] for stop in inside},
            adjusted,
        )

    @property
    def settled(self) -> NetworkPart:
        """The document without what steps pass on: marginal, control, sigmas."""
        alone = replace(self.adjusted, memory=None, control=(), frames=())
        alone = replace(alone, components=VarianceComponents(), mast=AdjustedMast())
        return replace(self, adjusted=alone)


@dataclass(frozen=True, slots=True, eq=False)
class NetworkProduct:
    """The network of a mission after a sol: the stops that its step changed, or all of them."""

    mission: str
    sol: int
    telemetry: dict[StopId, Pose]
    sols: dict[StopId, tuple[int, ...]]
    adjusted: AdjustedNetwork
    links: tuple[dict[str, Any], ...]
    """Result of every pair of stops that was tried on this sol."""
    report: dict[str, Any]
    """The report of this network's own adjustment."""
    manual_tie_notes: tuple[str, ...] = ()
    """Results of the manual ties, line by line."""
    references: References = field(default_factory=dict)
    """The products that contain the other stops."""

    @property
    def part(self) -> NetworkPart:
        """The stops in it."""
        return NetworkPart(self.telemetry, self.sols, self.adjusted)

    def with_stops(self, names: Collection[str], store: ProductStore) -> NetworkProduct:
        """The network with the named stops added from other products."""
        needed = {name: self.references[name] for name in names if name in self.references}
        if not needed:
            return self
        parts = [*_parts(needed, store), self.part]
        return replace(
            self,
            telemetry={stop: pose for part in parts for stop, pose in part.telemetry.items()},
            sols={stop: sols for part in parts for stop, sols in part.sols.items()},
            adjusted=assemble([part.adjusted for part in parts]),
            references={name: at for name, at in self.references.items() if name not in needed},
        )


@lru_cache(maxsize=_PARTS)
def read_network(ref: ProductRef, store: ProductStore) -> NetworkProduct:
    """The network of a sol, at the stops that its step changed; kept in memory for later sols."""
    document = json.loads(store.path(ref).read_text())
    part = _part(document)
    return NetworkProduct(
        mission=document["mission"],
        sol=document["sol"],
        telemetry=part.telemetry,
        sols=part.sols,
        adjusted=part.adjusted,
        links=tuple(document["links"]),
        report=document["network"]["reports"][-1],
        manual_tie_notes=tuple(document.get("by_hand", ())),
        references=references_of_document(document.get("holders", {})),
    )


def whole_network(ref: ProductRef, store: ProductStore) -> NetworkProduct:
    """The network of a mission after a sol, with all stops up to it."""
    network = read_network(ref, store)
    return network.with_stops(network.references, store)


@lru_cache(maxsize=_NETWORKS)
def cached_whole_network(ref: ProductRef, store: ProductStore) -> NetworkProduct:
    """A whole network, kept in memory: a product never changes."""
    return whole_network(ref, store)


def part_document(part: NetworkPart) -> dict[str, Any]:
    """Some stops of a network for JSON."""
    return {
        "stops": [
            {
                "mission": stop.mission,
                "site": stop.site,
                "drive": stop.drive,
                "sols": list(part.sols[stop]),
                "telemetry": pose_document(pose),
            }
            for stop, pose in part.telemetry.items()
        ],
        "network": network_document(part.adjusted),
    }


def product_document(network: NetworkProduct) -> dict[str, Any]:
    """The network of a sol for JSON, as `read_network` reads it."""
    document = part_document(network.part)
    document["network"]["reports"] = [network.report]
    return {
        "mission": network.mission,
        "sol": network.sol,
        **document,
        "links": list(network.links),
        "by_hand": list(network.manual_tie_notes),
        "holders": references_document(network.references),
    }


def _part(document: dict[str, Any]) -> NetworkPart:
    """The inverse of `part_document`."""
    stops = {_stop_of(row): row for row in document["stops"]}
    return NetworkPart(
        {stop: pose_of_document(row["telemetry"]) for stop, row in stops.items()},
        {stop: tuple(row["sols"]) for stop, row in stops.items()},
        network_of_document(document["network"]),
    )


def _parts(needed: Mapping[str, ProductRef], store: ProductStore) -> list[NetworkPart]:
    """The parts that contain some stops, one for each product to be read."""
    by_product: dict[ProductRef, set[str]] = {}
    for name, ref in needed.items():
        by_product.setdefault(ref, set()).add(name)
    parts = []
    for ref, names in by_product.items():
        part = _part(json.loads(store.path(ref).read_text()))
        parts.append(part.at([stop for stop in part.telemetry if str(stop) in names]))
    return parts


def traverses(product: NetworkProduct) -> tuple[Traverse, Traverse]:
    """The traverse of a network by telemetry, and as adjusted."""
    stops = product.adjusted.stops
    names = tuple(f"{stop.stop.site}/{stop.stop.drive}" for stop in stops)
    sols = np.array([min(product.sols[stop.stop]) for stop in stops], dtype=np.int32)
    telemetry = np.array([product.telemetry[stop.stop].translation_m for stop in stops])
    adjusted = np.array([stop.lsl_from_rover.translation_m for stop in stops])
    return (
        Traverse("telemetry", names, sols, map_from_lsl(telemetry)),
        Traverse("adjusted", names, sols, map_from_lsl(adjusted)),
    )


def _stop_of(row: dict[str, Any]) -> StopId:
    return StopId(row["mission"], row["site"], row["drive"])
