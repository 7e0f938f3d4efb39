"""Unchanged sols need no processing; layers that no sol makes any more are withdrawn."""

from dataclasses import replace

import pytest

from solmap.flows.runtime.sol_report import SolReport
from solmap.flows.sols import ReusableSols, withdraw_leftovers
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from solmap.tasks.network.orientations import Standing
from solmap.tasks.scopes import pair_scope, sol_scope
from tests.unit.products.catalogue.test_catalogue import MISSION, STOP, a_layer, an_image

SCOPES = {sol: Scope(ScopeLevel.SOL, f"mer2-sol0{sol}") for sol in (155, 156)}


@pytest.fixture
def workspace(tmp_path, catalogue_url):
    catalogue = Catalogue.open(tmp_path, catalogue_url)
    opened = Workspace(ProductStore.open(tmp_path), catalogue)
    catalogue.publish(images=[an_image("1", sol=155), an_image("2", sol=156)])
    return opened


def made(workspace, kind, scope=SCOPES[155], params=""):
    return workspace.store.make(Recipe(kind, scope, params=params), lambda path: path.touch())


def a_report(workspace, **changes):
    kinds = ProductKind.NETWORK, ProductKind.ORIENTATIONS, ProductKind.RIG
    standing = Standing(*(made(workspace, kind) for kind in kinds))
    report = SolReport("MER2", 155, standing, 1, ["converged"])
    report.published = (made(workspace, ProductKind.DTM, STOP),)
    report.pointed = (made(workspace, ProductKind.REPORT),)
    for name, value in changes.items():
        setattr(report, name, value)
    return report


def keys(workspace, before=None, pipeline="default"):
    finished = ReusableSols.of("MER2", workspace, pipeline)
    return [finished.key(sol, before) for sol in (155, 156)]


def test_a_finished_sol_is_recorded_with_its_outcome(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    key, report = finished.key(155, None), a_report(workspace)
    assert finished.report(SCOPES[155], 155, key) is None
    finished.note(SCOPES[155], key, report)
    reported = ReusableSols.of("MER2", workspace, "default").report(SCOPES[155], 155, key)
    assert reported == report


def test_a_late_image_changes_its_sol_and_those_after_it(workspace):
    before = keys(workspace)
    workspace.catalogue.publish(images=[an_image("3", sol=156)])
    first, second = keys(workspace)
    assert first == before[0]
    assert second != before[1]
    workspace.catalogue.publish(images=[an_image("0", sol=155)])
    assert keys(workspace)[0] != first


def test_an_earlier_adjustment_or_other_settings_change_every_sol(workspace):
    before = keys(workspace)
    standing = a_report(workspace).standing
    for other in (keys(workspace, standing), keys(workspace, pipeline="quicklook")):
        assert not set(other) & set(before)
    ties = ProductRef(ProductKind.MANUAL_TIES, Scope(ScopeLevel.REGION, "by-hand"), "a" * 16)
    workspace.catalogue.publish(pointers=[ties])
    assert not set(keys(workspace)) & set(before)


@pytest.mark.parametrize("part", ["published", "pointed"])
def test_a_sol_whose_map_or_report_is_missing_is_processed_again(workspace, part):
    finished = ReusableSols.of("MER2", workspace, "default")
    key, report = finished.key(155, None), a_report(workspace)
    finished.note(SCOPES[155], key, report)
    workspace.store.remove(getattr(report, part)[0])
    assert finished.report(SCOPES[155], 155, key) is None


def test_a_finished_sol_without_placed_stops_is_skipped_too(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    key, report = finished.key(155, None), SolReport("MER2", 155, notes=["site 9 is unknown"])
    finished.note(SCOPES[155], key, report)
    assert finished.report(SCOPES[155], 155, key) == report


def test_a_sol_with_an_older_incomplete_record_is_processed_again(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    key, report = finished.key(155, None), a_report(workspace)
    finished.note(SCOPES[155], key, report)
    noted = finished.book.find(SCOPES[155].name, key)
    del noted["pointers"]
    finished.book.note(SCOPES[155].name, key, noted)
    assert finished.report(SCOPES[155], 155, key) is None


def test_failures_are_retried_unless_images_cause_them(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    key = finished.key(155, None)
    finished.note(SCOPES[155], key, a_report(workspace, failures=["map dtm: OSError: [Errno 5]"]))
    assert finished.report(SCOPES[155], 155, key) is None
    lasting = ["match 2N1: MatchingError: no interest point"]
    finished.note(SCOPES[155], key, a_report(workspace, failures=lasting))
    assert finished.report(SCOPES[155], 155, key).failures == lasting


def test_records_from_the_first_processed_sol_on_are_removed(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    report = a_report(workspace)
    for sol, scope in SCOPES.items():
        finished.note(scope, finished.key(sol, None), report)
    finished.forget(SCOPES[156])
    assert finished.report(SCOPES[155], 155, finished.key(155, None)) is not None
    assert finished.report(SCOPES[156], 156, finished.key(156, None)) is None


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
def published(tmp_path):
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


def shown(published):
    return {layer.ref for layer in published.catalogue.layers("MER2")}


def pointed(published):
    kinds = ProductKind.MATCHES, ProductKind.NETWORK
    return {ref for kind in kinds for ref in published.catalogue.pointers(kind)}


def test_layers_that_no_sol_makes_are_withdrawn_except_those_of_people_and_regions(published):
    seen = published.catalogue.version()
    withdraw_leftovers("MER2", ["MER2"], [SOL], published)
    assert shown(published) == {NEAR, DIPS, REGION}
    assert pointed(published) == {PAIR, ANOTHER, NETWORK}
    (reported,) = published.catalogue.events_since(seen)
    assert len(reported.document["layers"]) == 1  # browsers take it from the map
    assert published.catalogue.layer(STOP.name, ProductKind.FAR_DTM, FAR.digest).ref == FAR


def test_a_layer_made_by_another_sol_of_the_run_stays(published):
    other = SolReport("MER2", 156, None, 1, published=(FAR,), pointed=(OLD_PAIR, OVERALL))
    withdraw_leftovers("MER2", ["MER2"], [SOL, other], published)
    assert shown(published) == {FAR, NEAR, DIPS, REGION}
    assert pointed(published) == {OLD_PAIR, PAIR, ANOTHER, NETWORK, OVERALL}


def test_nothing_is_withdrawn_while_a_sol_may_make_more_on_retry(published):
    failed = replace(SOL, failures=["map far ground 1: OSError: [Errno 5] Input/output error"])
    withdraw_leftovers("MER2", ["MER2"], [failed], published)
    assert shown(published) == {FAR, NEAR, DIPS, REGION}
    lasting = replace(SOL, failures=["match 2N1: MatchingError: no interest point"])
    withdraw_leftovers("MER2", ["MER2"], [lasting], published)
    assert shown(published) == {NEAR, DIPS, REGION}


def test_maps_of_a_stop_that_the_run_did_not_remake_stay_and_are_named(published):
    """Unless newer files of its images have left it no pair."""
    other = SolReport("MER2", 156, None, 0)
    pair = [replace(an_image(name), stop=STOP.name, partner="2N9") for name in ("2N1", "2N2")]
    published.catalogue.publish(images=pair)
    (line,) = withdraw_leftovers("MER2", ["MER2"], [other], published)
    assert line.startswith(f"{STOP.name}: its maps are unchanged")
    assert shown(published) == {FAR, NEAR, DIPS, REGION}
    published.catalogue.publish(images=[replace(one, partner=None) for one in pair])
    assert withdraw_leftovers("MER2", ["MER2"], [other], published) == []
    assert shown(published) == {DIPS, REGION}


def test_an_abandoned_map_is_removed(published):
    untied = replace(MISSION, mission="MER2-ORIGIN10")
    region = replace(a_layer(), ref=REGION, mission=untied.mission, type="vector", cell_m=None)
    book = ReusableSols.of("MER2", published, "default").book
    book.note("mer2-origin10-sol0155", "key", {})
    published.catalogue.publish(missions=[untied], layers=[region])
    withdraw_leftovers("MER2", ["MER2"], [SOL], published)
    assert [entry.mission for entry in published.catalogue.missions()] == ["MER2"]
    assert book.find("mer2-origin10-sol0155", "key") is None
    assert REGION not in {layer.ref for layer in published.catalogue.layers("MER2-ORIGIN10")}
