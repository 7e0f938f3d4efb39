"""The adjusted network of a mission as a product, read back."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from photogrammetry.adjustment.documents import network_of_document
from photogrammetry.adjustment.records import AdjustedNetwork
from photogrammetry.body_fixed import map_from_lsl
from photogrammetry.frames import Pose
from photogrammetry.imagery import StopId
from photogrammetry.traverse.records import Traverse
from products.arrays import pose_of_document
from products.model import ProductRef
from products.store import ProductStore


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
