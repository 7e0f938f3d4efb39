import errno
import os
import socket
from dataclasses import dataclass, replace

import pytest

from solmap.products.errors import ProductNotFoundError, StoreFullError
from solmap.products.model import ProductKind, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore

SCOPE = Scope(ScopeLevel.STOP, "mer2-site0010-drive0064")


@dataclass(frozen=True, slots=True)
class Params:
    cell_m: float = 0.04


def recipe(cell_m: float = 0.04) -> Recipe:
    return Recipe(ProductKind.DTM, SCOPE, (), Params(cell_m))


def write_text(path):
    path.write_text("terrain")


def test_a_product_is_made_once(tmp_path):
    store = ProductStore.open(tmp_path)
    made = []
    for _ in range(2):
        ref = store.make(recipe(), lambda path: (made.append(path), write_text(path)))
    assert len(made) == 1
    assert store.path(ref).read_text() == "terrain"


def test_another_parameter_makes_another_product():
    assert recipe(0.04).ref != recipe(0.02).ref


def test_the_digest_of_a_recipe_is_constant():
    assert replace(recipe(), science=1).ref.digest == "c90fbbdfdfa74011"


def test_inputs_are_part_of_the_recipe():
    of_dtm = Recipe(ProductKind.SLOPE, SCOPE, (recipe(0.04).ref,))
    of_other = Recipe(ProductKind.SLOPE, SCOPE, (recipe(0.02).ref,))
    assert of_dtm.ref != of_other.ref


def test_a_failed_draft_leaves_nothing_behind(tmp_path):
    store = ProductStore.open(tmp_path)

    def fail(path):
        path.write_text("half")
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError):
        store.make(recipe(), fail)
    assert not store.has(recipe().ref)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_full_disk_is_reported_plainly(tmp_path):
    store = ProductStore.open(tmp_path)

    def full(_path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(StoreFullError, match="the disk is full while making dtm of mer2-site0010"):
        store.make(recipe(), full)


def test_drafts_of_ended_processes_are_removed(tmp_path):
    store = ProductStore.open(tmp_path)
    dead = tmp_path / "drafts" / f"{socket.gethostname()}-999999999-abc"
    dead.mkdir()
    mine = tmp_path / "drafts" / f"{socket.gethostname()}-{os.getpid()}-abc"
    mine.mkdir()
    ProductStore.open(store.root)
    assert mine.exists()
    assert not dead.exists()


def test_provenance_has_recipe_size_and_checksum(tmp_path):
    store = ProductStore.open(tmp_path)
    notes = store.provenance(store.make(recipe(), write_text))
    assert notes["recipe"]["params"] == {"": "Params", "cell_m": 0.04}
    assert notes["bytes"] == 7
    assert notes["software"].startswith("solmap ")


def test_a_product_that_was_not_made_is_named(tmp_path):
    with pytest.raises(ProductNotFoundError, match="dtm of mer2-site0010-drive0064 with digest"):
        ProductStore.open(tmp_path).path(recipe().ref)


def test_all_versions_of_a_product_are_found(tmp_path):
    store = ProductStore.open(tmp_path)
    made = {store.make(recipe(cell_m), write_text) for cell_m in (0.04, 0.02)}
    assert set(store.versions(ProductKind.DTM, SCOPE)) == made
    assert store.versions(ProductKind.SLOPE, SCOPE) == []
    network = Recipe(ProductKind.NETWORK, SCOPE)  # its file and its provenance both end in .json
    assert store.versions(ProductKind.NETWORK, SCOPE) == []
    assert [store.make(network, write_text)] == store.versions(ProductKind.NETWORK, SCOPE)


def test_every_product_is_listed_with_its_recipe(tmp_path):
    store = ProductStore.open(tmp_path)
    region = Scope(ScopeLevel.REGION, "mer2")
    recipes = [
        recipe(),
        recipe(0.02),
        Recipe(ProductKind.NETWORK, Scope(ScopeLevel.SOL, "mer2-sol0156")),
        Recipe(ProductKind.REGION_DTM, region),
    ]
    made = {store.make(each, write_text) for each in recipes}
    assert set(store.refs()) == made
    assert len(list(store.refs())) == len(made)


def test_a_product_is_removed_with_its_provenance(tmp_path):
    store = ProductStore.open(tmp_path)
    gone, kept = (store.make(recipe(cell_m), write_text) for cell_m in (0.04, 0.02))
    for _ in range(2):
        store.remove(gone)
    assert list(store.refs()) == [kept]
    assert len([path for path in tmp_path.rglob("*") if path.is_file()]) == 2
