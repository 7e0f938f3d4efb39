"""Orientations to map with: a stop is mapped again only when its pairs really moved.

Every adjustment moves what it may: new ties weigh the pointing of old stops afresh, mostly by
millimetres. Maps are not made anew for that. The orientations that a mission's stops are mapped
with are a product of their own, one a network: made from the network and from the orientations
before, and from nothing else, so whatever was interrupted, repeated or published in between, the
same networks lead to the same maps.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from photogrammetry.adjustment.movement import ReissueParams, ground_shift_m
from photogrammetry.adjustment.records import AdjustedPair
from products.model import ProductKind, ProductRef, Recipe
from products.store import ProductStore
from tasks.adjust import read_network
from tasks.stage import stage
from tasks.views import Orientation


@dataclass(frozen=True, slots=True)
class MappedStop:
    """What a stop is mapped with, and why."""

    stop: str
    orientations: tuple[Orientation, ...]
    moved_m: float | None
    """By how much the adjustment moved ground at most, against the maps there were; None: new."""
    is_new: bool
    """Whether it is mapped with other orientations than by the network before."""


@stage(task_run_name="orientations-{network.scope}")
def choose_orientations(
    network: ProductRef, previous: ProductRef | None, params: ReissueParams, store: ProductStore
) -> ProductRef:
    """Take the network's orientations of the stops that moved; those of the others stay."""

    def write(path: Path) -> None:
        before = read_orientations(previous, store) if previous else {}
        by_stop: dict[str, list[AdjustedPair]] = {}
        for pair in read_network(network, store).adjusted.pairs:
            by_stop.setdefault(str(pair.stop), []).append(pair)
        kept = {stop: _kept(mapped) for stop, mapped in before.items()}
        chosen = {
            stop: choose(stop, pairs, before.get(stop), params) for stop, pairs in by_stop.items()
        }
        path.write_text(json.dumps([asdict(mapped) for mapped in (kept | chosen).values()]))

    inputs = (network, *((previous,) if previous else ()))
    return store.make(Recipe(ProductKind.ORIENTATIONS, network.scope, inputs, params), write)


def choose(
    stop: str, pairs: list[AdjustedPair], before: MappedStop | None, params: ReissueParams
) -> MappedStop:
    """What a stop is to be mapped with: all of its adjusted pairs, or all as they were mapped."""
    adjusted = tuple(Orientation.of(pair) for pair in sorted(pairs, key=lambda p: p.pair_id))
    old = {o.pair_id: o for o in before.orientations} if before else {}
    if before is None or old.keys() != {o.pair_id for o in adjusted}:
        return MappedStop(stop, adjusted, None, is_new=True)
    moved_m = max(
        ground_shift_m(
            old[pair.pair_id].lsl_from(pair.lsl_from_pair.source),
            pair.lsl_from_pair,
            params.range_m,
        )
        for pair in pairs
    )
    moves = moved_m > params.shift_m
    return MappedStop(stop, adjusted if moves else before.orientations, moved_m, is_new=moves)


def read_orientations(ref: ProductRef, store: ProductStore) -> dict[str, MappedStop]:
    """What the stops of a mission are mapped with, by their names."""
    rows = json.loads(store.path(ref).read_text())
    return {row["stop"]: _mapped_of(row) for row in rows}


def _mapped_of(row: dict[str, Any]) -> MappedStop:
    orientations = tuple(
        Orientation(
            o["pair_id"],
            tuple(o["rotation"]),
            tuple(o["translation_m"]),
            tuple(o.get("covariance", ())),
        )
        for o in row["orientations"]
    )
    return MappedStop(row["stop"], orientations, row["moved_m"], row["is_new"])


def _kept(before: MappedStop) -> MappedStop:
    """A stop that the network does not reach any more."""
    return MappedStop(before.stop, before.orientations, 0.0, is_new=False)
