"""Sols that nothing changed for are passed over; whatever they depend on has them made again."""

import pytest

from solmap.flows.finished import ReusableSols
from solmap.flows.runtime.sol_report import SolReport
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore
from solmap.tasks.network.orientations import Standing
from tests.unit.products.catalogue.test_catalogue import STOP, an_image

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
    kinds = ProductKind.NETWORK, ProductKind.ORIENTATIONS
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


def test_a_finished_sol_is_told_as_it_went(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    key, report = finished.key(155, None), a_report(workspace)
    assert finished.report(SCOPES[155], 155, key) is None
    finished.note(SCOPES[155], key, report)
    told = ReusableSols.of("MER2", workspace, "default").report(SCOPES[155], 155, key)
    assert told == report


def test_a_late_image_changes_its_sol_and_those_after_it(workspace):
    before = keys(workspace)
    workspace.catalogue.publish(images=[an_image("3", sol=156)])
    first, second = keys(workspace)
    assert first == before[0]
    assert second != before[1]
    workspace.catalogue.publish(images=[an_image("0", sol=155)])
    assert keys(workspace)[0] != first


def test_another_adjustment_before_and_other_settings_change_every_sol(workspace):
    before = keys(workspace)
    standing = a_report(workspace).standing
    for other in (keys(workspace, standing), keys(workspace, pipeline="quicklook")):
        assert not set(other) & set(before)
    ties = ProductRef(ProductKind.MANUAL_TIES, Scope(ScopeLevel.REGION, "by-hand"), "a" * 16)
    workspace.catalogue.publish(pointers=[ties])
    assert not set(keys(workspace)) & set(before)


@pytest.mark.parametrize("part", ["published", "pointed"])
def test_a_sol_whose_map_or_report_is_gone_is_processed_again(workspace, part):
    finished = ReusableSols.of("MER2", workspace, "default")
    key, report = finished.key(155, None), a_report(workspace)
    finished.note(SCOPES[155], key, report)
    workspace.store.remove(getattr(report, part)[0])
    assert finished.report(SCOPES[155], 155, key) is None


def test_a_sol_whose_stops_cannot_be_placed_is_passed_over_too(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    key, report = finished.key(155, None), SolReport("MER2", 155, notes=["site 9 is unknown"])
    finished.note(SCOPES[155], key, report)
    assert finished.report(SCOPES[155], 155, key) == report


def test_what_an_earlier_version_noted_less_of_is_processed_again(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    key, report = finished.key(155, None), a_report(workspace)
    finished.note(SCOPES[155], key, report)
    noted = finished.book.find(SCOPES[155].name, key)
    del noted["pointers"]
    finished.book.note(SCOPES[155].name, key, noted)
    assert finished.report(SCOPES[155], 155, key) is None


def test_what_failed_is_tried_again_unless_its_images_are_at_fault(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    key = finished.key(155, None)
    finished.note(SCOPES[155], key, a_report(workspace, failures=["map dtm: OSError: [Errno 5]"]))
    assert finished.report(SCOPES[155], 155, key) is None
    lasting = ["match 2N1: MatchingError: no interest point"]
    finished.note(SCOPES[155], key, a_report(workspace, failures=lasting))
    assert finished.report(SCOPES[155], 155, key).failures == lasting


def test_sols_from_the_first_that_is_processed_on_are_forgotten(workspace):
    finished = ReusableSols.of("MER2", workspace, "default")
    report = a_report(workspace)
    for sol, scope in SCOPES.items():
        finished.note(scope, finished.key(sol, None), report)
    finished.forget(SCOPES[156])
    assert finished.report(SCOPES[155], 155, finished.key(155, None)) is not None
    assert finished.report(SCOPES[156], 156, finished.key(156, None)) is None
