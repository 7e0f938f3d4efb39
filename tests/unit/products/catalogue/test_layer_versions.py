"""A map belongs to every solution whose orientations it was made with."""

from __future__ import annotations

import json
from dataclasses import dataclass

import pytest

from solmap.products.catalogue.layer_versions import solutions_behind, solutions_of_mission
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.network import References, references_document
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel

FIRST, SECOND = "mer2-site0010-drive0000", "mer2-site0010-drive0064"


@dataclass(frozen=True, slots=True)
class Orientation:
    """As recipes of maps hold it."""

    pair_id: str
    rotation: tuple[float, ...]
    translation_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Looked:
    """Parameters of a map."""

    orientations: tuple[Orientation, ...]


@pytest.fixture
def workspace(tmp_path) -> Workspace:
    return Workspace.open(tmp_path / "store")


def looked(stop: str, east_m: float) -> Orientation:
    return Orientation(f"{stop}-pair", (1.0, 0.0, 0.0), (0.0, east_m, 0.0))


def solved(
    workspace: Workspace, sol: int, touched: dict[str, float], holders: References
) -> tuple[ProductRef, ProductRef]:
    """A network of a sol and the orientations chosen from it, of the stops that it touched."""
    scope = Scope(ScopeLevel.SOL, f"mer2-sol{sol:04d}")
    network = workspace.store.make(
        Recipe(ProductKind.NETWORK, scope), lambda path: path.write_text("{}")
    )
    workspace.catalogue.publish(pointers=[network])
    rows = [
        {"stop": stop, "orientations": [vars_of(looked(stop, east))]}
        for stop, east in touched.items()
    ]
    document = {"mapped": rows, "holders": references_document(holders)}
    chosen = workspace.store.make(
        Recipe(ProductKind.ORIENTATIONS, scope, (network,)),
        lambda path: path.write_text(json.dumps(document)),
    )
    return network, chosen


def vars_of(one: Orientation) -> dict:
    return {
        "pair_id": one.pair_id,
        "rotation": one.rotation,
        "translation_m": one.translation_m,
    }


def map_of(workspace: Workspace, *orientations: Orientation) -> ProductRef:
    scope = Scope(ScopeLevel.STOP, FIRST)
    recipe = Recipe(ProductKind.DTM, scope, (), Looked(orientations))
    return workspace.store.make(recipe, lambda path: path.write_bytes(b"a map"))


def test_a_stop_unchanged_by_later_sols_belongs_to_their_solutions_too(workspace):
    one, chosen = solved(workspace, 155, {FIRST: 0.0}, {})
    other, chosen = solved(workspace, 156, {SECOND: 9.0}, {FIRST: chosen})
    last, _ = solved(workspace, 157, {FIRST: 0.5}, {SECOND: chosen})
    known = solutions_of_mission("MER2", workspace.catalogue, workspace.store)
    behind = [
        set(solutions_behind(map_of(workspace, *of), known, workspace.store))
        for of in (
            [looked(FIRST, 0.0)],
            [looked(FIRST, 0.5)],
            [looked(SECOND, 9.0)],
            [looked(FIRST, 0.0), looked(SECOND, 9.0)],  # pairs of two stops
            [looked(FIRST, 0.1)],
        )
    ]
    assert behind == [{one, other}, {last}, {other, last}, {other}, set()]
