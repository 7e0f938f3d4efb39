"""What pruning removes, and what it never does."""

from datetime import timedelta
from pathlib import Path

import pytest
import sqlalchemy as sa

from solmap.products.catalogue.database import LABELS, write_transaction
from solmap.products.catalogue.maintenance.pruning import (
    PruningParams,
    prune,
    unreferenced_products,
)
from solmap.products.catalogue.runs import FinishedSolRecords
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError
from solmap.products.model import Layer, ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.locks import shared_run_lock

STOP = Scope(ScopeLevel.STOP, "mer2-site0010-drive0000")
PAIR = Scope(ScopeLevel.PAIR, "2n1")
NOW = PruningParams(versions=1, youngest=timedelta(0))


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    return Workspace.open(tmp_path / "store")


def made(workspace: Workspace, kind: ProductKind, scope: Scope, *inputs: ProductRef, n: int = 0):
    recipe = Recipe(kind, scope, inputs, (n,))
    return workspace.store.make(recipe, lambda path: path.write_text(f"{kind} {n}"))


def publish(workspace: Workspace, *refs: ProductRef) -> None:
    layers = [
        Layer(ref, "MER2", "A map", "raster", (0, 0, 1, 1), 1.0, None, None, (155,), "2026")
        for ref in refs
    ]
    workspace.catalogue.publish(layers=layers)


def gone(workspace: Workspace, params: PruningParams = NOW) -> set[ProductRef]:
    reported = [one.ref for one in unreferenced_products(workspace, params)]
    removed = [one.ref for one in prune(workspace, params)]
    assert removed == reported
    assert not any(workspace.store.has(ref) for ref in removed)
    return set(removed)


@pytest.fixture
def mapped(workspace: Workspace) -> dict[str, ProductRef]:
    """A map that was made again from other parameters, and what both were made from."""
    matches = made(workspace, ProductKind.MATCHES, PAIR)
    old = made(workspace, ProductKind.DTM, STOP, matches, n=1)
    old_slope = made(workspace, ProductKind.SLOPE, STOP, old)
    publish(workspace, old, old_slope)
    dtm = made(workspace, ProductKind.DTM, STOP, matches, n=2)
    slope = made(workspace, ProductKind.SLOPE, STOP, dtm)
    publish(workspace, dtm, slope)
    return {
        "matches": matches,
        "old": old,
        "old_slope": old_slope,
        "dtm": dtm,
        "slope": slope,
    }


def test_superseded_versions_are_removed_and_inputs_of_published_ones_kept(workspace, mapped):
    assert gone(workspace) == {mapped["old"], mapped["old_slope"]}
    published = [layer.ref for layer in workspace.catalogue.layers()]
    assert set(published) == {mapped["dtm"], mapped["slope"]}
    assert all(workspace.store.path(ref).is_file() for ref in published)
    assert workspace.store.has(mapped["matches"])
    with pytest.raises(ProductError, match="has been published"):
        workspace.catalogue.layer(STOP.name, ProductKind.DTM, mapped["old"].digest)
    assert gone(workspace) == set()


def test_the_requested_number_of_versions_is_kept(workspace, mapped):
    assert gone(workspace, PruningParams(versions=2, youngest=timedelta(0))) == set()
    assert mapped["old"].digest != mapped["dtm"].digest


@pytest.mark.usefixtures("mapped")
def test_recent_products_are_kept_with_their_inputs(workspace):
    assert gone(workspace, PruningParams(versions=1, youngest=timedelta(days=1))) == set()


def test_figures_are_kept_or_removed_with_their_products(workspace, mapped):
    stale = made(workspace, ProductKind.QUICKLOOK, STOP, mapped["old"])
    fresh = made(workspace, ProductKind.QUICKLOOK, STOP, mapped["dtm"])
    removed = gone(workspace)
    assert stale in removed
    assert fresh not in removed


def test_a_product_named_by_a_parameter_is_kept(workspace):
    ties = made(workspace, ProductKind.CONTROL_FILE, Scope(ScopeLevel.REGION, "file"))
    recipe = Recipe(ProductKind.NETWORK, Scope(ScopeLevel.SOL, "mer2-sol0155"), (), (ties,))
    network = workspace.store.make(recipe, lambda path: path.write_text("network"))
    workspace.catalogue.publish(pointers=[network])
    assert gone(workspace) == set()


def test_products_of_a_finished_sol_are_kept_after_a_later_one_mapped_it_again(workspace, mapped):
    standing = [f"{ref.kind}/stop/{ref.scope}/{ref.digest}" for ref in (mapped["matches"],)]
    layers = [f"{mapped['old'].kind}/stop/{STOP}/{mapped['old'].digest}"]
    book = FinishedSolRecords(workspace.catalogue.engine)
    book.note("mer2-sol0155", "key", {"standing": standing, "layers": layers})
    assert gone(workspace) == {mapped["old_slope"]}


def test_the_label_of_a_superseded_edition_is_removed_with_it(workspace):
    of_image = Scope(ScopeLevel.IMAGE, "2n1l")
    old, new = (made(workspace, ProductKind.IMAGE, of_image, n=number) for number in (1, 2))
    publish(workspace, old)
    publish(workspace, new)
    with write_transaction(workspace.catalogue.engine) as connection:
        for ref in (old, new):
            connection.execute(LABELS.insert().values(digest=f"{ref.digest}/3", document="{}"))
    assert gone(workspace) == {old}
    with workspace.catalogue.engine.connect() as connection:
        kept = connection.execute(sa.select(LABELS.c.digest)).scalars().all()
    assert kept == [f"{new.digest}/3"]


def test_nothing_is_pruned_during_a_run(workspace, mapped):
    root = workspace.store.root
    with (
        shared_run_lock(root),
        shared_run_lock(root),
        pytest.raises(ProductError, match="prune when it has ended"),
    ):
        prune(workspace, NOW)
    assert workspace.store.has(mapped["old"])
    assert mapped["old"] in gone(workspace)


def test_a_killed_pruning_is_completed_by_the_next(workspace, mapped, monkeypatch):
    removed: list[ProductRef] = []

    def killed(_store: object, ref: ProductRef) -> None:
        removed.append(ref)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(type(workspace.store), "remove", killed)
        with pytest.raises(KeyboardInterrupt):
            prune(workspace, NOW)
    for layer in workspace.catalogue.layers():
        assert workspace.store.path(layer.ref).is_file()
    assert gone(workspace) == {mapped["old"], mapped["old_slope"]}


def test_impossible_parameters_are_refused():
    with pytest.raises(ProductError, match="at least one version"):
        PruningParams(versions=0)
