"""What no sol gives any more is withdrawn; all else stays."""

from dataclasses import replace

import pytest

from solmap.flows.finished import withdraw_leftovers
from solmap.flows.runtime.sol_report import SolReport
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.tasks.scopes import pair_scope, sol_scope
from tests.unit.products.catalogue.test_catalogue import MISSION, STOP, a_layer, an_image

RECIPES = [
    *(Recipe(kind, STOP) for kind in (ProductKind.FAR_DTM, ProductKind.DTM, ProductKind.DIPS)),
    Recipe(ProductKind.REGION_DTM, Scope(ScopeLevel.REGION, "mer2-region")),
]
FAR, NEAR, DIPS, REGION = LAYERS = [recipe.ref for recipe in RECIPES]
OLD_PAIR = ProductRef(ProductKind.MATCHES, pair_scope("2N1"), "5" * 16)
PAIR = ProductRef(ProductKind.MATCHES, pair_scope("2N2"), "6" * 16)
ANOTHER = ProductRef(ProductKind.MATCHES, pair_scope("1N1"), "7" * 16)
"""A pair of another mission."""
NETWORK = ProductRef(ProductKind.NETWORK, sol_scope("MER2", 155), "8" * 16)
OVERALL = ProductRef(ProductKind.NETWORK, Scope(ScopeLevel.SOL, "mer2-sol0155-overall"), "9" * 16)
SOL = SolReport("MER2", 155, None, 1, published=(NEAR,), pointed=(PAIR, NETWORK))


@pytest.fixture
def workspace(tmp_path):
    opened = Workspace.open(tmp_path)
    for recipe in RECIPES:
        opened.store.make(recipe, lambda path: path.touch())
    opened.catalogue.publish(
        missions=[MISSION],
        images=[an_image("2N1"), an_image("2N2")],
        layers=[replace(a_layer(), ref=ref, type="vector", cell_m=None) for ref in LAYERS],
        pointers=[OLD_PAIR, PAIR, ANOTHER, NETWORK, OVERALL],
    )
    return opened


def shown(workspace):
    return {layer.ref for layer in workspace.catalogue.layers("MER2")}


def pointed(workspace):
    kinds = ProductKind.MATCHES, ProductKind.NETWORK
    return {ref for kind in kinds for ref in workspace.catalogue.pointers(kind)}


def test_what_no_sol_gives_is_withdrawn_and_what_people_or_regions_made_stays(workspace):
    seen = workspace.catalogue.version()
    withdraw_leftovers("MER2", [SOL], workspace)
    assert shown(workspace) == {NEAR, DIPS, REGION}
    assert pointed(workspace) == {PAIR, ANOTHER, NETWORK}
    (told,) = workspace.catalogue.events_since(seen)
    assert len(told.document["layers"]) == 1  # browsers take it from the map
    assert workspace.catalogue.layer(STOP.name, ProductKind.FAR_DTM, FAR.digest).ref == FAR


def test_another_sol_of_the_run_gives_it(workspace):
    other = SolReport("MER2", 156, None, 1, published=(FAR,), pointed=(OLD_PAIR, OVERALL))
    withdraw_leftovers("MER2", [SOL, other], workspace)
    assert shown(workspace) == {FAR, NEAR, DIPS, REGION}
    assert pointed(workspace) == {OLD_PAIR, PAIR, ANOTHER, NETWORK, OVERALL}


def test_nothing_is_withdrawn_while_a_sol_may_give_more_at_the_next_try(workspace):
    failed = replace(SOL, failures=["map far ground 1: OSError: [Errno 5] Input/output error"])
    withdraw_leftovers("MER2", [failed], workspace)
    assert shown(workspace) == {FAR, NEAR, DIPS, REGION}
    lasting = replace(SOL, failures=["match 2N1: MatchingError: no interest point"])
    withdraw_leftovers("MER2", [lasting], workspace)
    assert shown(workspace) == {NEAR, DIPS, REGION}
